// SPDX-License-Identifier: Apache-2.0
// A user-defined camera on the car, as `redrive render mount` takes it (camera/mount.h),
// and its part of the panel.
import {CarPlan} from "./car_plan";
import type {CameraInfo, Hello} from "./protocol";

const numbers = ["x", "y", "z", "yaw", "pitch", "roll"] as const;
const sizes = ["fov", "width", "height"] as const;

export type Mount = Record<(typeof numbers)[number], number> & {lens: string};

const radians = Math.PI / 180;
const usualSizes = [90, 1280, 704];
export const usualLens = "pinhole:90:1280x704";

function rounded(value: number, digits: number): number {
  return Number(value.toFixed(digits)) || 0;
}

/** X,Y,Z,YAW,PITCH,ROLL. */
export function mountText(mount: Mount): string {
  return numbers.map((name) => mount[name]).join(",");
}

/** Reads a mount; null where the program would refuse it. */
export function mountFrom(text: string | null, lens: string | null, hello: Hello): Mount | null {
  const values = (text ?? "").split(",").map(Number);
  if (values.length !== 6 || !lens || !hello.method) return null;
  if (values.some((value, i) => !(Math.abs(value) <= (i < 3 ? 1e4 : 360)))) return null;
  const [x, y, z, yaw, pitch, roll] = values;
  if (!hello.cameras.some(({name}) => name === lens) && !pinhole(lens)) return null;
  return {x, y, z, yaw, pitch, roll, lens};
}

/** Field of view, width and height; null unless the program takes them. */
function pinhole(lens: string): [number, number, number] | null {
  const found = /^pinhole:([\d.]+):(\d+)x(\d+)$/.exec(lens);
  if (!found) return null;
  const [fov, width, height] = found.slice(1).map(Number);
  const fits = fov >= 1 && fov <= 170 && Math.min(width, height) >= 16 &&
    Math.max(width, height) <= 4096;
  return fits ? [fov, width, height] : null;
}

/** body_from_sensor, 3 x 4 row by row: yaw, pitch and roll of a camera that looks forward. */
export function mountPose(mount: Mount): number[] {
  const [cy, sy] = [Math.cos(mount.yaw * radians), Math.sin(mount.yaw * radians)];
  const [cp, sp] = [Math.cos(mount.pitch * radians), Math.sin(mount.pitch * radians)];
  const [cr, sr] = [Math.cos(mount.roll * radians), Math.sin(mount.roll * radians)];
  const forward = [cy * cp, sy * cp, sp];
  const right = [sy, -cy, 0]; // before the roll
  const down = [cy * sp, sy * sp, -cp];
  const at = [mount.x, mount.y, mount.z];
  return [0, 1, 2].flatMap((k) => [
    cr * right[k] + sr * down[k], cr * down[k] - sr * right[k], forward[k], at[k]]);
}

/** The mount at a pose of a camera, body_from_sensor. */
export function mountAt(m: number[], lens: string): Mount {
  const level = Math.hypot(m[2], m[6]);
  const yaw = level > 1e-9 ? Math.atan2(m[6], m[2]) : 0;
  const right = [Math.sin(yaw), -Math.cos(yaw), 0];  // axis of the same camera without roll
  const along = (k: number) => right[0] * m[k] + right[1] * m[4 + k];
  return {
    x: rounded(m[3], 3), y: rounded(m[7], 3), z: rounded(m[11], 3),
    yaw: rounded(yaw / radians, 2),
    pitch: rounded(Math.atan2(m[10], level) / radians, 2),
    roll: rounded(Math.atan2(-along(1), along(0)) / radians, 2),
    lens,
  };
}

/** The camera of the state: of the rig, or that of the mount, with a pose of its own. */
export function cameraOf(state: {camera: string; mount: Mount | null}, hello: Hello): CameraInfo {
  const camera = hello.cameras.find(({name}) => name === state.camera) ?? hello.cameras[0];
  return state.mount ? {...camera, body_from_sensor: mountPose(state.mount)} : camera;
}

const labels: Record<string, string> = {
  x: "forward, m", y: "left, m", z: "up, m", yaw: "yaw, °", pitch: "pitch, °", roll: "roll, °",
  fov: "wide, °", width: "wide, px", height: "high, px",
};

/** The fields of a mount, and the drawing of the car, which sets some of them. */
export class MountPanel {
  private readonly fields = {} as Record<string, HTMLInputElement>;
  private readonly lens = document.createElement("select");
  private readonly plan: CarPlan | null = null; // where lengths are metres

  /** `changed` gets every mount that the fields and the drawing make. */
  constructor(
    place: HTMLElement, private readonly hello: Hello,
    private readonly changed: (mount: Mount) => void,
  ) {
    this.lens.id = "mount-lens";
    for (const name of ["pinhole", ...hello.cameras.map((camera) => camera.name)])
      this.lens.add(new Option(name === "pinhole" ? name : `of ${name}`, name));
    this.lens.addEventListener("change", () => this.read());
    if (hello.metric)
      this.plan = new CarPlan(place, () => hello.cameras, (dragged) => {
        const mount = mountFrom(mountText(dragged), dragged.lens, hello);
        if (mount) changed(mount);
      });
    const row = document.createElement("label");
    row.append("lens", this.lens);
    place.append(
      ...numbers.map((name, i) => this.field(name, i < 3 ? 0.1 : 1, 0)), row,
      ...sizes.map((name, i) => this.field(name, i === 0 ? 1 : 16, usualSizes[i])));
  }

  /** Shows a mount; a field that is being edited keeps its text. */
  show(mount: Mount): void {
    const set = (field: HTMLInputElement, value: number) => {
      if (document.activeElement !== field) field.value = String(value);
    };
    for (const name of numbers) set(this.fields[name], mount[name]);
    this.plan?.show(mount);
    const found = pinhole(mount.lens);
    this.lens.value = found ? "pinhole" : mount.lens;
    sizes.forEach((name, i) => {
      if (found) set(this.fields[name], found[i]);
      const row = this.fields[name].parentElement;
      if (row) row.hidden = !found;
    });
  }

  private field(name: string, step: number, value: number): HTMLElement {
    const input = document.createElement("input");
    input.type = "number";
    input.id = `mount-${name}`;
    input.step = String(step);
    input.value = String(value);
    input.addEventListener("input", () => this.read());
    this.fields[name] = input;
    const row = document.createElement("label");
    row.append(labels[name], input);
    return row;
  }

  /** Takes the fields where the program would. */
  private read(): void {
    const value = (name: string) => this.fields[name].valueAsNumber;
    const [fov, width, height] = sizes.map(value);
    const lens = this.lens.value === "pinhole"
      ? `pinhole:${fov}:${width}x${height}` : this.lens.value;
    const mount = mountFrom(numbers.map(value).join(","), lens, this.hello);
    if (mount) this.changed(mount);
  }
}
