// SPDX-License-Identifier: Apache-2.0
// A drawing of the car from above, x up and y to the left, in which the own mount is dragged.
import type {Mount} from "./mount";
import type {CameraInfo} from "./protocol";

const svg = "http://www.w3.org/2000/svg";
const size = 260;  // side of the drawing in its own units, which are near pixels
const middle_x = 1.25; // metres in front of the rear axle: the middle of the outline
const [rear_x, front_x, half_width] = [-1, 3.5, 0.9]; // outline of a usual car, metres
const leastReach = 3.25; // metres from the middle to the edge of the drawing
const arm = 36; // from the mount to the tip of its direction
const line = 11; // height of a label
const [letter, leastLetter] = [6, 4]; // widths of a label's letter, usual and squeezed

type Attributes = Record<string, string | number>;

function set(to: SVGElement, attributes: Attributes): SVGElement {
  for (const [key, value] of Object.entries(attributes)) to.setAttribute(key, String(value));
  return to;
}

function node(name: string, attributes: Attributes): SVGElement {
  return set(document.createElementNS(svg, name), attributes);
}

export class CarPlan {
  private readonly drawing = node("svg", {
    id: "car-plan", viewBox: `0 0 ${size} ${size}`, role: "img",
    "aria-label": "The car from above, its front up, with the mount; the fields below set the same",
  }) as SVGSVGElement;
  private readonly car = node("g", {});
  private readonly ray = node("line", {class: "mount"});
  private readonly dot = node("circle", {id: "mount-dot", class: "mount handle", r: 8});
  private readonly tip = node("circle", {id: "mount-tip", class: "mount handle", r: 5});
  private mount: Mount | null = null;
  private reach = 0; // metres from the middle to the edge
  private drawn = ""; // what the car was drawn from
  private dragged: SVGElement | null = null;

  /** `changed` gets every mount that a drag makes. */
  constructor(
    place: HTMLElement, private readonly cameras: () => CameraInfo[],
    changed: (mount: Mount) => void,
  ) {
    this.drawing.append(this.car, this.ray, this.dot, this.tip);
    place.append(this.drawing);
    this.drawing.addEventListener("pointerdown", (event) => {
      const target = event.target as SVGElement;
      if (event.button !== 0 || (target !== this.dot && target !== this.tip)) return;
      (document.activeElement as HTMLElement | null)?.blur(); // a field being edited keeps its text
      this.dragged = target;
      this.drawing.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    this.drawing.addEventListener("pointermove", (event) => {
      if (!this.dragged || !this.mount) return;
      const [x, y] = this.inBody(event);
      if (this.dragged === this.dot) {
        const [near_x, near_y] = [x, y].map((value) => Math.round(100 * value) / 100 || 0);
        changed({...this.mount, x: near_x, y: near_y});
      } else {
        const yaw = Math.atan2(y - this.mount.y, x - this.mount.x);
        changed({...this.mount, yaw: Math.round((yaw * 180) / Math.PI) || 0});
      }
    });
    const end = () => {
      this.dragged = null;
      if (this.mount) this.show(this.mount); // the scale may change now
    };
    this.drawing.addEventListener("pointerup", end);
    this.drawing.addEventListener("pointercancel", end);
  }

  show(mount: Mount): void {
    this.mount = mount;
    const cameras = this.cameras();
    const out = (x: number, y: number) => Math.max(Math.abs(x - middle_x), Math.abs(y));
    if (!this.dragged)
      this.reach = Math.max(leastReach, 1.5 * out(mount.x, mount.y), // the tip is inside, too
        ...cameras.map(({body_from_sensor: m}) => 1.2 * out(m[3], m[7])));
    this.drawCar(cameras);
    const [u, v] = this.inDrawing(mount.x, mount.y);
    const yaw = (mount.yaw * Math.PI) / 180;
    const [tu, tv] = [u - arm * Math.sin(yaw), v - arm * Math.cos(yaw)];
    set(this.ray, {x1: u, y1: v, x2: tu, y2: tv});
    set(this.dot, {cx: u, cy: v});
    set(this.tip, {cx: tu, cy: tv});
  }

  private inDrawing(x: number, y: number): [number, number] {
    const scale = size / 2 / this.reach;
    return [size / 2 - scale * y, size / 2 - scale * (x - middle_x)];
  }

  /** The body's x and y under the pointer, inside of the drawing. */
  private inBody({clientX, clientY}: PointerEvent): [number, number] {
    const {left, top, width, height} = this.drawing.getBoundingClientRect();
    const at = (share: number) => (1 - 2 * Math.min(1, Math.max(0, share))) * this.reach;
    return [at((clientY - top) / height) + middle_x, at((clientX - left) / width)];
  }

  /** Draws outline and cameras, where they have changed. */
  private drawCar(cameras: CameraInfo[]): void {
    const from = JSON.stringify([this.reach, cameras.map((camera) => camera.body_from_sensor)]);
    if (from === this.drawn) return;
    this.drawn = from;
    const scale = size / 2 / this.reach;
    const [u, v] = this.inDrawing(front_x, half_width);
    const [width, height] = [2 * half_width * scale, (front_x - rear_x) * scale];
    const [axle_u, axle_v] = this.inDrawing(0, half_width);
    const [glass_u, glass_v] = this.inDrawing(2.1, 0.7);
    const glass = 1.4 * scale;
    this.car.replaceChildren(
      node("rect", {class: "car", x: u, y: v, width, height, rx: 0.35 * scale}),
      node("path", {class: "car", d: `M${axle_u},${axle_v}h${width}`}), // through the origin
      node("path", {class: "car", // the windscreen
        d: `M${glass_u},${glass_v}q${glass / 2},${-0.3 * scale} ${glass},0`}));
    for (const onLeft of [true, false])
      this.drawCameras(cameras.filter(({body_from_sensor: m}) => m[7] > 0 === onLeft), onLeft);
  }

  /** Draws cameras with their names in a column beside the car. */
  private drawCameras(cameras: CameraInfo[], onLeft: boolean): void {
    const aside =
      Math.max(half_width, ...cameras.map(({body_from_sensor: m}) => Math.abs(m[7])));
    const label_u = this.inDrawing(0, onLeft ? aside : -aside)[0] + (onLeft ? -4 : 4);
    const room = (onLeft ? label_u : size - label_u) - 2;
    const most = Math.floor(room / leastLetter);
    let next = line; // where the next name has room
    const inOrder = cameras.map(({name, body_from_sensor: m}) =>
      ({name, at: this.inDrawing(m[3], m[7])})).sort((a, b) => a.at[1] - b.at[1]);
    for (const {name, at: [u, v]} of inOrder) {
      const label_v = Math.max(v, next);
      next = label_v + line;
      const dot = node("circle", {class: "camera", cx: u, cy: v, r: 2.5});
      const label = node("text", {
        x: label_u, y: label_v + 3, "text-anchor": onLeft ? "end" : "start"});
      if (letter * name.length > room)
        set(label, {textLength: room, lengthAdjust: "spacingAndGlyphs"});
      label.textContent = name.length > most ? `${name.slice(0, most - 1)}…` : name;
      for (const part of [dot, label]) {
        const title = node("title", {});
        title.textContent = name;
        part.append(title);
      }
      const leader = node("line", {class: "leader", x1: u, y1: v, x2: label_u, y2: label_v});
      this.car.append(dot, ...(next > size ? [] : [leader, label]));
    }
  }
}
