// SPDX-License-Identifier: Apache-2.0
// The state of the page. It lives in the address, so that a view can be sent to a colleague.
import {mountFrom, mountText, type Mount} from "./mount";
import type {Hello} from "./protocol";

export const compares = ["off", "beside", "wipe", "blend", "difference"] as const;
export const layers = ["image", "depth", "normals", "opacity", "coverage", "actors"] as const;
export const overlays = ["trajectory", "frusta", "lidar", "cloud", "boxes", "masks"] as const;
export const scanColours = ["range", "intensity", "error"] as const;
export const moves = ["left", "forward", "up", "yaw", "pitch"] as const;

export type Compare = (typeof compares)[number];
export type Layer = (typeof layers)[number];
export type OverlayName = (typeof overlays)[number];
export type ScanColour = (typeof scanColours)[number];
export type Move = (typeof moves)[number];

export interface State {
  camera: string;
  frame: number; // id
  mount: Mount | null; // takes the place of the camera
  left: number; // metres along the body's axes, from where the camera is mounted
  forward: number;
  up: number;
  yaw: number; // degrees, to the left
  pitch: number; // degrees, upwards
  novel: {set: string; index: number} | null;  // takes the place of all above
  compare: Compare;
  share: number;  // share of the recorded image in wipe and blend
  layer: Layer;
  overlays: Set<OverlayName>;
  scan: {sensor: string; colour: ScanColour} | null; // the rendered LiDAR scan that is drawn
  exposure: string; // own, none, CAMERA:FRAME
  // Not in the address:
  object: number | null; // the moving object that is selected
  edit: string; // file that has the page's changes to moving objects; empty: there are none
}

export function initialState(hello: Hello): State {
  return {
    camera: hello.start?.camera ?? hello.cameras[0].name,
    frame: hello.start?.frame ?? hello.frames[Math.floor(hello.frames.length / 2)].id,
    mount: null,
    left: 0,
    forward: 0,
    up: 0,
    yaw: 0,
    pitch: 0,
    novel: null,
    compare: "off",
    share: 0.5,
    layer: "image",
    overlays: new Set(),
    scan: null,
    exposure: "own",
    object: null,
    edit: "",
  };
}

/** Rounds to what a command shows: millimetres and hundredths of a degree. Angles stay in
 * -180..180. */
export function setMove(state: State, move: Move, value: number): void {
  if (!Number.isFinite(value)) return;
  if (move === "yaw") value = ((((value + 180) % 360) + 360) % 360) - 180;
  if (move === "pitch") value = Math.min(89, Math.max(-89, value));
  const step = move === "yaw" || move === "pitch" ? 100 : 1000;
  const bound = 1e4;
  state[move] = Math.round(Math.min(bound, Math.max(-bound, value)) * step) / step || 0;
}

/** Selects the rendered scan; an empty sensor is none. Errors are those of the recorded scan. */
export function setScan(state: State, sensor: string, colour: ScanColour): void {
  state.scan = sensor
    ? {sensor, colour: colour === "error" && sensor !== "recorded" ? "range" : colour} : null;
}

export function isDriven(state: State): boolean {
  return state.novel !== null ||
    (state.mount === null && moves.every((move) => state[move] === 0));
}

/** Names the recorded image of the state, as the server does. */
export function referenceKey(state: State): string {
  if (state.novel) return `${state.novel.set}/${state.novel.index}`;
  return state.mount ? "mount" : `${state.camera}:${state.frame}`;
}

export function toHash(state: State, hello: Hello): string {
  const initial = initialState(hello);
  const values = new URLSearchParams();
  if (state.novel) {
    values.set("truth", referenceKey(state));
  } else {
    values.set("camera", state.camera);
    values.set("frame", String(state.frame));
    if (state.mount) {
      values.set("mount", mountText(state.mount));
      values.set("lens", state.mount.lens);
    }
    for (const move of moves) if (state[move] !== 0) values.set(move, String(state[move]));
  }
  for (const key of ["compare", "layer", "exposure", "share"] as const)
    if (state[key] !== initial[key]) values.set(key, String(state[key]));
  if (state.overlays.size > 0) values.set("over", [...state.overlays].join(","));
  if (state.scan) values.set("scan", `${state.scan.sensor},${state.scan.colour}`);
  return values.toString();
}

/** Reads an address; what does not fit the run is left as it is initially. */
export function fromHash(hash: string, hello: Hello): State {
  const values = new URLSearchParams(hash.replace(/^#/, ""));
  const state = initialState(hello);
  const camera = values.get("camera");
  if (camera && hello.cameras.some(({name}) => name === camera)) state.camera = camera;
  const frame = Number(values.get("frame") ?? NaN);
  if (hello.frames.some(({id}) => id === frame)) state.frame = frame;
  state.mount = mountFrom(values.get("mount"), values.get("lens"), hello);
  for (const move of moves) if (values.has(move)) setMove(state, move, Number(values.get(move)));
  const truth = /^(.*)\/(\d+)$/.exec(values.get("truth") ?? "");
  const set = truth && hello.novel.find((novel) => novel.set === truth[1]);
  if (set && Number(truth[2]) < set.views.length) {
    state.novel = {set: set.set, index: Number(truth[2])};
    state.mount = null;
    const view = set.views[state.novel.index];
    state.camera = view.camera;
    if (hello.frames.some(({id}) => id === view.frame)) state.frame = view.frame;
  }
  const compare = compares.find((name) => name === values.get("compare"));
  if (compare && hello.method) state.compare = compare;
  const layer = layers.find((name) => name === values.get("layer"));
  if (layer && hello.method) state.layer = layer;
  for (const name of (values.get("over") ?? "").split(","))
    for (const known of overlays) if (name === known) state.overlays.add(known);
  const [sensor, colour] = (values.get("scan") ?? "").split(",");
  if (hello.sensors.includes(sensor))
    setScan(state, sensor, scanColours.find((name) => name === colour) ?? "range");
  const share = Number(values.get("share") ?? NaN);
  if (share >= 0 && share <= 1) state.share = share;
  const exposure = values.get("exposure");
  if (exposure && (exposure === "none" || /^.{1,200}:\d+$/.test(exposure)))
    state.exposure = exposure;
  return state;
}

/** The message that asks for the state's image. */
export function toRequest(state: State, id: number): object {
  return {
    type: "view",
    id,
    camera: state.camera,
    frame: state.frame,
    shift_m: [state.forward, state.left, state.up],
    yaw_deg: state.yaw,
    pitch_deg: state.pitch,
    layer: state.layer,
    exposure: state.exposure,
    overlays: [...state.overlays],
    reference: state.compare !== "off",
    novel: state.novel,
    mount: state.mount && {at: mountText(state.mount), lens: state.mount.lens},
    object: state.object,
    scan: state.scan,
  };
}

export function quoted(word: string): string {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replace(/'/g, `'\\''`)}'`;
}

/** The command that renders the state's image. */
export function toCommand(state: State, hello: Hello): string {
  const words = ["redrive", "render"];
  const set = state.novel && hello.novel.find((novel) => novel.set === state.novel?.set);
  if (set) {
    words.push("poses", hello.run, set.poses, "--out", set.set);
  } else {
    if (state.mount)
      words.push("mount", hello.run, `--mount=${mountText(state.mount)}`, "--lens", state.mount.lens);
    else words.push("image", hello.run, "--camera", state.camera);
    words.push("--frame", String(state.frame));
    if (state.forward || state.left || state.up)
      words.push(`--translate=${state.forward},${state.left},${state.up}`);
    if (state.yaw) words.push(`--yaw=${state.yaw}`);
    if (state.pitch) words.push(`--pitch=${state.pitch}`);
    const file = (["depth", "normals", "opacity"] as const).find((name) => name === state.layer);
    if (file) words.push(`--${file}`, `${file}.png`);
    words.push("--out", "view.png");
  }
  if (state.exposure !== "own") words.push("--exposure", state.exposure);
  if (state.edit) words.push("--edit", state.edit);
  return words.map(quoted).join(" ");
}
