// SPDX-License-Identifier: Apache-2.0
// The panel's part for camera paths: a list of views with times, previewed, saved and loaded.
import {element} from "./controls";
import type {Hello, Keyframe, Paths} from "./protocol";
import {dragToReorder, grip} from "./reorder";
import {quoted, setMove, type State} from "./state";

const mostKeys = 256;
const usualSeconds = 2;
const [leastSeconds, mostSeconds] = [0.01, 600]; // between two views
const longest_s = 3600; // as the program's kMaxPath_s

/** A view, and how long it takes to get there from the one before. */
interface Key extends Omit<Keyframe, "time_s"> {
  seconds: number;
}

export class PathPart {
  private keys: Key[] = [];
  private fps = 24;
  private names: string[] = [];
  private overwrites = ""; // the name that the next click on Save overwrites
  private savedAs = ""; // empty: changed since
  private startedAt: number | null = null;  // start of the preview

  /** `changed` is called when the page has to ask for another image. */
  constructor(
    private readonly hello: Hello,
    private readonly state: State,
    private readonly send: (message: object) => void,
    private readonly changed: () => void,
  ) {
    element("path").hidden = !hello.method;
    element("path-add").addEventListener("click", () => this.add());
    element("path-play").addEventListener("click", () =>
      this.startedAt === null ? this.play() : this.stop());
    element("path-save").addEventListener("click", () => this.save());
    element("path-load").addEventListener("change", () => {
      const {value} = element<HTMLSelectElement>("path-load");
      if (value) this.send({type: "load_path", name: value});
    });
    element("path-copy").addEventListener("click", () => void this.copy());
    dragToReorder(element("path-keys"), (from, to) => this.move(from, to));
    for (const event of ["pointerdown", "wheel"])
      element("stage").addEventListener(event, () => this.stop());
    this.update();
  }

  /** Shows the command as the state has it. */
  showCommand(): void {
    element("path-command").textContent = this.command();
  }

  /** What replaces a part of the page's request while the preview plays. */
  request(): object {
    if (this.startedAt === null) return {};
    const middle = this.keys[Math.floor(this.keys.length / 2)];
    return {
      camera: this.keys[0].camera,
      frame: middle.frame_id, // gives the exposure
      novel: null,
      mount: null,
      reference: false,
      path_s: Math.round(performance.now() - this.startedAt) / 1000,
    };
  }

  tick(): void {
    if (this.startedAt === null) return;
    if (performance.now() - this.startedAt > 1000 * this.duration()) this.stop();
    else this.changed();
  }

  receive(message: Paths): void {
    this.names = message.names;
    let note = message.error ?? "";
    if (message.saved) {
      this.savedAs = message.saved;
      note = `Saved as paths/${message.saved}.json in the run.`;
    }
    if (message.loaded && message.name) {
      this.stop();
      this.fps = message.loaded.fps;
      this.keys = message.loaded.keyframes.map(({time_s, ...key}, i, all) => ({
        ...key,
        seconds: i === 0 ? usualSeconds : Math.round(1000 * (time_s - all[i - 1].time_s)) / 1000,
      }));
      this.savedAs = message.name;
      element<HTMLInputElement>("path-name").value = message.name;
    }
    this.update(note);
  }

  private duration(): number {
    return this.keys.slice(1).reduce((sum, {seconds}) => sum + seconds, 0);
  }

  /** Says where the path is longer than the program takes. */
  private tooLong(): boolean {
    if (Math.round(1000 * this.duration()) <= 1000 * longest_s) return false;
    this.update(`At most ${longest_s} s.`);
    return true;
  }

  private keyframes(): Keyframe[] {
    let time = 0;
    return this.keys.map(({seconds, ...key}, i) => {
      if (i > 0) time += seconds;
      return {...key, time_s: Math.round(1000 * time) / 1000};
    });
  }

  private add(): void {
    const {state} = this;
    if (state.novel) return this.update("Views with ground truth cannot be keys.");
    if (state.mount) return this.update("Views of a mount of your own cannot be keys.");
    if (this.keys.length === mostKeys) return this.update(`At most ${mostKeys} views.`);
    this.keys.push({
      camera: state.camera,
      frame_id: state.frame,
      shift_body_m: [state.forward, state.left, state.up],
      yaw_deg: state.yaw,
      pitch_deg: state.pitch,
      seconds: usualSeconds,
    });
    this.edited();
  }

  private edited(): void {
    this.savedAs = "";
    this.stop();
    this.update();
  }

  private move(from: number, to: number): void {
    this.keys.splice(to, 0, ...this.keys.splice(from, 1));
    this.edited();
  }

  private show(key: Key): void {
    this.stop();
    this.state.novel = null;
    this.state.mount = null;
    this.state.camera = key.camera;
    if (this.hello.frames.some(({id}) => id === key.frame_id)) this.state.frame = key.frame_id;
    const [forward, left, up] = key.shift_body_m;
    const moves = {forward, left, up, yaw: key.yaw_deg, pitch: key.pitch_deg};
    for (const [move, value] of Object.entries(moves))
      setMove(this.state, move as keyof typeof moves, value);
    this.changed();
  }

  private play(): void {
    if (this.keys.length < 2 || this.tooLong()) return;
    this.send({type: "path", fps: this.fps, keyframes: this.keyframes(), save: null});
    this.startedAt = performance.now();
    this.update();
    this.changed();
  }

  private stop(): void {
    if (this.startedAt === null) return;
    this.startedAt = null;
    this.update();
    this.changed();
  }

  private save(): void {
    const {value: name} = element<HTMLInputElement>("path-name");
    if (!/^[A-Za-z0-9_-]{1,64}$/.test(name))
      return this.update("The name needs 1 to 64 letters, digits, _ or -.");
    if (this.tooLong()) return;
    if (this.names.includes(name) && this.overwrites !== name) {
      this.overwrites = name;
      return this.update(`${name} exists; Save again to overwrite it.`);
    }
    const save = {name, overwrite: this.overwrites === name};
    this.overwrites = "";
    this.send({type: "path", fps: this.fps, keyframes: this.keyframes(), save});
  }

  private command(): string {
    if (!this.savedAs) return "";
    const file = `${this.hello.run.replace(/\/+$/, "")}/paths/${this.savedAs}.json`;
    const edit = this.state.edit ? ["--edit", this.state.edit] : [];
    return ["redrive", "render", "path", this.hello.run, file, ...edit,
      "--out", `${this.savedAs}.mp4`].map(quoted).join(" ");
  }

  private async copy(): Promise<void> {
    try {
      await navigator.clipboard.writeText(this.command());
      this.update("Copied.");
    } catch {
      this.update("Not allowed; select it above.");
    }
  }

  private update(note = ""): void {
    const enable = (id: string, on: boolean) =>
      (element<HTMLButtonElement>(id).disabled = !on);
    element("path-keys").replaceChildren(...this.keys.map((key, i) => this.row(key, i)));
    element("path-note").textContent = note ||
      (this.keys.length > 1 ? `${this.keys.length} views, ${this.duration().toFixed(2)} s` : "");
    element("path-play").textContent = this.startedAt === null ? "Preview" : "Stop";
    enable("path-play", this.keys.length > 1);
    enable("path-save", this.keys.length > 0);
    enable("path-copy", this.savedAs !== "");
    this.showCommand();
    const list = element<HTMLSelectElement>("path-load");
    const options = ["", ...this.names].map((name) => new Option(name || "load ...", name));
    list.replaceChildren(...options);
    list.value = this.names.includes(this.savedAs) ? this.savedAs : "";
    list.disabled = this.names.length === 0;
  }

  private row(key: Key, index: number): HTMLLIElement {
    const row = document.createElement("li");
    if (this.keys.length > 1) row.append(grip());
    const button = (text: string, label: string, action: () => void, on = true) => {
      const made = document.createElement("button");
      made.type = "button";
      made.textContent = text;
      made.ariaLabel = `${label} ${index + 1}`;
      made.title = label;
      made.disabled = !on;
      made.addEventListener("click", action);
      row.append(made);
    };
    const [forward, left, up] = key.shift_body_m;
    const moved = forward || left || up || key.yaw_deg || key.pitch_deg ? ", moved" : "";
    button(`${key.frame_id} ${key.camera}${moved}`, "Show view", () => this.show(key));
    if (index > 0) {
      const seconds = document.createElement("input");
      seconds.type = "number";
      seconds.min = String(leastSeconds);
      seconds.max = String(mostSeconds);
      seconds.step = "any";
      seconds.value = String(key.seconds);
      seconds.ariaLabel = `Seconds to view ${index + 1}`;
      seconds.addEventListener("change", () => {
        const value = Number(seconds.value);
        if (value >= leastSeconds && value <= mostSeconds)
          key.seconds = Math.round(1000 * value) / 1000;
        this.edited();
      });
      row.append(seconds, "s");
    }
    button("↑", "Earlier: view", () => this.move(index, index - 1), index > 0);
    button("↓", "Later: view", () => this.move(index, index + 1), index + 1 < this.keys.length);
    button("✕", "Delete view", () => {
      this.keys.splice(index, 1);
      this.edited();
    });
    return row;
  }
}
