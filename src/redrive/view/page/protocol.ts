// SPDX-License-Identifier: Apache-2.0
// Messages between the page and `redrive view` (../messages.h, ../viewer.h).

export interface CameraInfo {
  name: string;
  model: string;
  width: number;
  height: number;
  body_from_sensor: number[]; // 3 x 4, row by row
}

export interface NovelSet {
  set: string;
  poses: string; // its poses.json
  views: {file: string; camera: string; frame: number}[];
}

/** A moving object of the run. */
export interface ObjectInfo {
  id: number;
  type: string;
  frames: [number, number] | null;  // its first and last frame
  size_m: number[];
  nearest: {camera: string; frame: number} | null;  // the image that shows it nearest
}

export interface Hello {
  kind: "hello";
  run: string;
  method: string; // empty: a recording, without a model
  step: number;
  metric: boolean;
  ecef: boolean;
  lidar: boolean;
  sensors: string[]; // sensors whose scans can be rendered
  boxes: boolean;
  cameras: CameraInfo[];
  frames: {id: number; t_s: number}[];
  held_out: number[];
  novel: NovelSet[];
  start: {camera: string; frame: number} | null; // an image to begin with
  map: [number, number][]; // places of the frames from above; y is left of x
  // range and colours of the layer of depth
  depth: {near_m: number; far_m: number; colours: string[]} | null;
  objects: ObjectInfo[];
  // Changes to moving objects with which pages begin; an empty file name means that no file has
  // them.
  edit: {text: string; file: string} | null;
}

export interface Picked {
  kind: "picked";
  id: number;
  surface: boolean;
  pixel?: [number, number];
  opacity?: number;
  camera?: string;
  frame?: number;
  object?: number | null; // the moving object there
  depth_m?: number;
  world_m?: number[];
  body_m?: number[];
  ecef_m?: number[];
  wgs84?: {latitude_deg: number; longitude_deg: number; height_m: number};
}

/** How far a run is that trains in the program. */
export interface Training {
  kind: "training";
  trains: boolean; // false: it has ended
  paused: boolean;
  step: number;
  steps: number; // when it ends at the latest; 0: not known
  seconds: number;
}

/** What is done before a run's first step. */
export interface Preparing {
  kind: "preparing";
  text: string; // empty: nothing that takes time
  share: number | null; // that is done; null: not known
}

/** Rows of metrics.jsonl. */
export interface Curve {
  kind: "curve";
  steps: number[];
  psnr_db: number[];
  loss: number[];
}

export interface SeenBy {
  kind: "seen_by";
  id: number;
  text?: string;  // reason why it is unknown
  seen?: number;
  of?: number; // training images
  nearest?: {camera: string; frame: number; distance_m: number}[];
}

/** The answer to an edit: taken, with remarks, or not. */
export interface Edited {
  kind: "edited";
  id: number;
  remarks?: string[];
  error?: string;
}

/** Where an object goes that is dragged; neither field where the program does not know. */
export interface Dragged {
  kind: "dragged";
  id: number;
  shift_m?: number[];
  turn_deg?: number;
}

export interface Line {
  kind: "trajectory" | "frustum" | "box" | "object" | "handle";
  label: string;
  points: number[]; // u, v, u, v, ...: 0..1 over the image
}

export interface ImageHeader {
  kind: "image";
  sequence: number;
  id: number;
  camera: string;
  frame: number;
  width: number;
  height: number;
  full_width: number;
  full_height: number;
  factor: number;
  render_ms: number;
  total_ms: number;
  at: [number, number, number, number]; // the camera's place on the map and its direction there
  beside: number;  // distance from the driven way
  lines: Line[];
  // the rendered scan: its rays and returns, and the median error of recorded ranges
  scan: {rays: number; returns: number; error_m: number | null} | null;
  trouble: string;  // what part of the overlays could not be read
  jpeg: number;
  points: number;
  mask: number;
}

export interface ReferenceHeader {
  kind: "reference";
  key: string;
  width: number;
  height: number;
  jpeg: number;
  points: number;
  mask: number;
}

/** A view of a camera path. */
export interface Keyframe {
  time_s: number;
  camera: string;
  frame_id: number;
  shift_body_m: number[]; // forward, left, up
  yaw_deg: number;
  pitch_deg: number;
}

/** The names of the saved paths, and the answer to a path or a load. */
export interface Paths {
  kind: "paths";
  names: string[];
  saved?: string;
  name?: string;
  loaded?: {fps: number; keyframes: Keyframe[]};
  error?: string;
}

export type Text =
  | Hello
  | Paths
  | Picked
  | Edited
  | Dragged
  | SeenBy
  | Preparing
  | Training
  | Curve
  // PSNR against the recorded image, or the share of pixels that training images saw
  | {kind: "score"; id: number; psnr_db: number | null; seen: number | null}
  | {kind: "no_reference"; key: string; text: string}
  | {kind: "problem"; text: string}  // problem of the run; empty: none
  | {kind: "error"; id: number; text: string};

export interface Picture<Header> {
  header: Header;
  bitmap: ImageBitmap;
  points: Uint8Array; // ../overlay.h
  mask: Uint8Array;
}

/** Splits a binary message into its header, its JPEG, its points and its mask. */
export async function decode(
  bytes: ArrayBuffer,
): Promise<Picture<ImageHeader> | Picture<ReferenceHeader>> {
  const size = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, size)));
  const jpeg = new Uint8Array(bytes, 4 + size, header.jpeg);
  const points = new Uint8Array(bytes, 4 + size + header.jpeg, header.points);
  const bitmap = await createImageBitmap(new Blob([jpeg], {type: "image/jpeg"}));
  const mask = new Uint8Array(
    bytes, 4 + size + header.jpeg + header.points, header.mask);
  return {header, bitmap, points, mask};
}

/** A connection that is made again when it ends. */
export class Connection {
  onText: (message: Text) => void = () => {};
  onPicture: (bytes: ArrayBuffer) => void = () => {};
  onState: (connected: boolean) => void = () => {};
  private socket: WebSocket | null = null;

  connect(): void {
    const address = new URL("socket", location.href.replace(/[?#].*$/, ""));
    address.protocol = "ws:";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.socket = socket;
      this.onState(true);
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (typeof event.data === "string") this.onText(JSON.parse(event.data) as Text);
      else this.onPicture(event.data);
    };
    socket.onclose = () => {
      this.socket = null;
      this.onState(false);
      setTimeout(() => this.connect(), 2000);
    };
  }

  send(message: object): void {
    this.socket?.send(JSON.stringify(message));
  }
}
