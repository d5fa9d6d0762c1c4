// SPDX-License-Identifier: Apache-2.0
// The drive from above: where the view is, and a way to jump to any frame.
import type {Hello} from "./protocol";

const svg = "http://www.w3.org/2000/svg";
const width = 300;  // side of the drawing in its own units, which are near pixels
const [leastHeight, mostHeight] = [70, 220];
const margin = 18;

function node(name: string, attributes: Record<string, string | number>): SVGElement {
  const made = document.createElementNS(svg, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

/** The largest of 1, 2, 5, 10, ... that is at most `most`. */
function roundLength(most: number): number {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * (most >= 5 * power ? 5 : most >= 2 * power ? 2 : 1);
}

/** How far apart the places of the frames lie; 1 where they are one. */
export function extentOf(map: [number, number][]): number {
  const of = (k: number) => map.map((place) => place[k]);
  const span = (values: number[]) => values.reduce((a, b) => Math.max(a, b), -Infinity) -
    values.reduce((a, b) => Math.min(a, b), Infinity);
  return Math.hypot(span(of(0)), span(of(1))) || 1;
}

export class DriveMap {
  private readonly view = node("path", {class: "view", d: "M-6,-5L8,0L-6,5L-3,0Z"});
  private readonly frame = node("circle", {class: "frame", r: 4.5});
  private readonly least: [number, number];
  private readonly scale: number;
  private readonly height: number;

  /** `go` gets the frame whose place is nearest to the pointer. */
  constructor(place: HTMLElement, private readonly hello: Hello, go: (frame: number) => void) {
    const {map, metric} = hello;
    const least = (k: number) => map.reduce((all, at) => Math.min(all, at[k]), Infinity);
    const most = (k: number) => map.reduce((all, at) => Math.max(all, at[k]), -Infinity);
    const [w, h] = [most(0) - least(0), most(1) - least(1)];
    const unit = extentOf(map);
    this.scale = Math.min((width - 2 * margin) / Math.max(w, unit / 100),
      (mostHeight - 2 * margin) / Math.max(h, unit / 100));
    this.height = Math.max(leastHeight, h * this.scale + 2 * margin);
    this.least = [least(0) - (width / this.scale - w) / 2,
      least(1) - (this.height / this.scale - h) / 2];
    const drawing = node("svg", {
      id: "drive-map", viewBox: `0 0 ${width} ${this.height}`, role: "img",
      "aria-label": "The drive from above; a click goes to the frame there"}) as SVGSVGElement;
    const points = map.map((at) => this.inDrawing(at).map((x) => x.toFixed(1)).join(","));
    if (metric) drawing.append(node("polyline", {class: "drive", points: points.join(" ")}));
    else drawing.append(...map.map((at) => {
      const [cx, cy] = this.inDrawing(at);
      return node("circle", {class: "camera", cx, cy, r: 2});
    }));
    drawing.append(this.frame, this.view);
    if (metric) this.drawScale(drawing);
    place.replaceChildren(drawing);
    let held = false;
    const jump = (event: PointerEvent) => {
      const box = drawing.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * width;
      const y = ((event.clientY - box.top) / box.height) * this.height;
      let [nearest, distance] = [0, Infinity];
      map.forEach((at, i) => {
        const [u, v] = this.inDrawing(at);
        const away = Math.hypot(u - x, v - y);
        if (away < distance) [nearest, distance] = [i, away];
      });
      go(hello.frames[nearest].id);
    };
    drawing.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      held = true;
      drawing.setPointerCapture(event.pointerId);
      jump(event);
    });
    drawing.addEventListener("pointermove", (event) => {
      if (held) jump(event);
    });
    for (const end of ["pointerup", "pointercancel"] as const)
      drawing.addEventListener(end, () => (held = false));
  }

  /** Shows the frame, and the place and direction of the camera. */
  show(frame: number, at: [number, number, number, number] | null): void {
    const index = this.hello.frames.findIndex(({id}) => id === frame);
    const [cx, cy] = this.inDrawing(this.hello.map[Math.max(0, index)]);
    this.frame.setAttribute("cx", String(cx));
    this.frame.setAttribute("cy", String(cy));
    this.view.toggleAttribute("hidden", at === null);
    if (!at) return;
    const inside = (x: number, most: number) => Math.min(most - 6, Math.max(6, x));
    const [x, y] = this.inDrawing([at[0], at[1]]);
    const angle = (-Math.atan2(at[3], at[2]) * 180) / Math.PI;
    this.view.setAttribute("transform",
      `translate(${inside(x, width)},${inside(y, this.height)}) rotate(${angle.toFixed(1)})`);
  }

  private inDrawing([x, y]: [number, number]): [number, number] {
    return [(x - this.least[0]) * this.scale,
      this.height - (y - this.least[1]) * this.scale];
  }

  private drawScale(drawing: SVGElement): void {
    const length = roundLength((width / 3) / this.scale);
    const end = 6 + length * this.scale;
    const y = this.height - 6;
    drawing.append(node("path", {class: "scale", d: `M6,${y - 4}V${y}H${end}V${y - 4}`}));
    const label = node("text", {x: end + 4, y});
    label.textContent = `${length} m`;
    drawing.append(label);
  }
}
