// SPDX-License-Identifier: Apache-2.0
// The part of the panel that shows the progress of training and pauses it.
import type {Curve, Preparing, Training} from "./protocol";

const svg = "http://www.w3.org/2000/svg";
const [width, height] = [300, 100];

function progressOf({step, steps, trains, seconds}: Training): string {
  const of = trains && steps > 0 ? ` of ${steps}` : "";
  return `step ${step}${of}, ${seconds.toFixed(0)} s of training`;
}

/** Says over the image why there is none yet. */
export class WaitNote {
  connected = false;
  training: Training | null = null;
  preparing: Preparing | null = null;
  private readonly text = document.createElement("span");
  private readonly bar = document.createElement("progress");
  private since = performance.now();

  constructor(private readonly place: HTMLElement) {
    this.bar.hidden = true;
    place.replaceChildren(this.text, this.bar);
  }

  show(hasImage: boolean): void {
    this.place.hidden = hasImage;
    this.place.parentElement?.classList.toggle("waiting", !hasImage);
    if (hasImage) return;
    const waited = Math.floor((performance.now() - this.since) / 1000);
    const what = !this.connected ? "Connecting to redrive"
      : this.training?.trains ? `Training, ${progressOf(this.training)}: the first image is made`
      : this.preparing?.text ? `Preparing the run; ${this.preparing.text}`
      : "Preparing the run; its first image comes by itself";
    const text = waited > 1 ? `${what} (${waited} s)` : `${what} ...`;
    if (this.text.textContent !== text) this.text.textContent = text;
    const share = this.connected && !this.training ? this.preparing?.share ?? null : null;
    this.bar.hidden = share === null;
    this.bar.value = share ?? 0;
  }
}

export class TrainingPanel {
  private training: Training | null = null;
  private readonly chart = document.createElementNS(svg, "svg");
  private readonly label = document.createElement("p");
  private readonly curve = document.createElement("p");
  private readonly pause = document.createElement("button");

  /** `send` gets what the program is asked to do. */
  constructor(private readonly place: HTMLElement, send: (message: object) => void) {
    this.chart.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.chart.setAttribute("role", "img");
    this.label.id = "training-label";
    this.curve.id = "curve-label";
    this.pause.id = "pause";
    this.pause.hidden = true;
    this.pause.type = "button";
    this.pause.addEventListener("click", () => {
      if (this.training) send({type: "train", paused: !this.training.paused});
    });
    const buttons = document.createElement("div");
    buttons.className = "buttons";
    buttons.append(this.pause);
    place.append(this.chart, this.curve, this.label, buttons);
  }

  showTraining(training: Training): void {
    this.training = training;
    this.place.hidden = false;
    this.pause.hidden = !training.trains;
    this.pause.textContent = training.paused ? "Go on" : "Pause";
    const how = !training.trains ? ", finished" : training.paused ? ", paused" : "";
    this.label.textContent = progressOf(training) + how;
  }

  /** Draws PSNR over the steps, and the loss on a logarithmic scale. */
  showCurve({steps, psnr_db, loss}: Curve): void {
    if (steps.length < 2) return;
    this.place.hidden = false;
    const last = steps.length - 1;
    const line = (values: number[], name: string) => {
      const [least, most] = [Math.min(...values), Math.max(...values)];
      const points = values.map((value, i) => {
        const x = (width * (steps[i] - steps[0])) / Math.max(1, steps[last] - steps[0]);
        const y = height - 4 - ((height - 8) * (value - least)) / Math.max(1e-9, most - least);
        return `${x.toFixed(1)},${y.toFixed(1)}`;
      });
      const made = document.createElementNS(svg, "polyline");
      made.setAttribute("points", points.join(" "));
      made.setAttribute("class", name);
      return made;
    };
    this.chart.replaceChildren(
      line(loss.map((value) => Math.log(Math.max(value, 1e-9))), "loss"), line(psnr_db, "psnr"));
    const text =
      `PSNR of training rays ${psnr_db[0].toFixed(1)} to ${psnr_db[last].toFixed(1)} dB, ` +
      `loss ${loss[0].toPrecision(2)} to ${loss[last].toPrecision(2)}, to step ${steps[last]}`;
    this.chart.setAttribute("aria-label", text);
    this.curve.textContent = text;
  }
}
