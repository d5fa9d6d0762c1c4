// SPDX-License-Identifier: Apache-2.0
// Draws the rendering, the recorded image and the overlays on one canvas.
import type {ImageHeader, Line, Picture, ReferenceHeader} from "./protocol";
import {isDriven, type State} from "./state";

interface Rect {
  x: number;
  y: number;
  width: number;
  height: number;
}

export interface Mark {
  u: number;
  v: number;
}

/** A rectangle in pixels of the page, from the canvas's corner. */
export interface Outline {
  left: number;
  top: number;
  right: number;
  bottom: number;
}

const colours = {
  trajectory: "#ffd23f", frustum: "#4fd1ff", box: "#ff6ad5", object: "#7dff6a", handle: "#7dff6a",
};

/** Colours of LiDAR points: from red, which is near, bright or wrong, to blue. */
export const lidarLevels = Array.from({length: 256}, (_, i) => `hsl(${(i * 240) / 255} 100% 55%)`);

export class Stage {
  image: Picture<ImageHeader> | null = null;
  reference: Picture<ReferenceHeader> | null = null;  // reference image of the state that is shown
  marks: Mark[] = [];
  maskedShare = 0;  // masked share of the pixels of the image that is shown
  private masked: {of: Picture<ImageHeader>; shape: OffscreenCanvas | null} | null = null;
  handleAt: Mark | null = null; // where the handle is while it is dragged
  private rendering: Rect = {x: 0, y: 0, width: 1, height: 1}; // in pixels of the canvas

  /** `room`: the largest size that the canvas may have, in pixels of the page. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly room: () => {width: number; height: number},
  ) {}

  /** Returns where in the rendering a position of the pointer lies, if it does. */
  at(clientX: number, clientY: number): Mark | null {
    const box = this.canvas.getBoundingClientRect();
    const scale = this.canvas.width / box.width;
    const {x, y, width, height} = this.rendering;
    const u = ((clientX - box.left) * scale - x) / width;
    const v = ((clientY - box.top) * scale - y) / height;
    return u >= 0 && u < 1 && v >= 0 && v < 1 ? {u, v} : null;
  }

  /** Where in the rendering a position of the pointer lies, from 0 at the left to 1. */
  across(clientX: number): number {
    const box = this.canvas.getBoundingClientRect();
    const {x, width} = this.rendering;
    const u = ((clientX - box.left) * (this.canvas.width / box.width) - x) / width;
    return Math.min(1, Math.max(0, u));
  }

  /** The distance of two marks in pixels of the pointer. */
  distance(a: Mark, b: Mark): number {
    const scale = this.canvas.getBoundingClientRect().width / this.canvas.width;
    const {width, height} = this.rendering;
    return scale * Math.hypot((a.u - b.u) * width, (a.v - b.v) * height);
  }

  /** The cursor over the image; empty: the usual one. */
  set cursor(name: string) {
    this.canvas.style.cursor = name;
  }

  draw(state: State): void {
    const picture = this.image;
    if (!picture) return;
    const context = this.canvas.getContext("2d");
    if (!context) return;
    const {full_width, full_height} = picture.header;
    const beside = state.compare === "beside";
    const room = this.room();
    const scale = (columns: number, rows: number) =>
      Math.min(room.width / (columns * full_width), room.height / (rows * full_height));
    // Side by side or one above the other, whichever is larger.
    const wide = beside && scale(2, 1) >= scale(1, 2);
    const columns = wide ? 2 : 1;
    const rows = beside && !wide ? 2 : 1;
    const size = (pixels: number, count: number) =>
      Math.max(1, Math.floor(pixels * count * scale(columns, rows)));
    const [pageWidth, pageHeight] = [size(full_width, columns), size(full_height, rows)];
    this.canvas.style.width = `${pageWidth}px`;
    this.canvas.style.height = `${pageHeight}px`;
    const width = Math.round(pageWidth * devicePixelRatio);
    const height = Math.round(pageHeight * devicePixelRatio);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    const part = {width: width / columns, height: height / rows};
    this.rendering = {x: 0, y: 0, ...part};
    const other =
      wide ? {x: part.width, y: 0, ...part} : {x: 0, y: beside ? part.height : 0, ...part};
    context.globalAlpha = 1;
    context.globalCompositeOperation = "source-over";
    context.fillStyle = "#000";
    context.fillRect(0, 0, width, height);
    const put = (bitmap: ImageBitmap, to: Rect) =>
      context.drawImage(bitmap, to.x, to.y, to.width, to.height);
    put(picture.bitmap, this.rendering);
    if (this.reference && state.compare !== "off")
      this.drawReference(context, this.reference.bitmap, state, other, put);
    this.drawOverlays(context, picture, this.rendering);
    // Overlays projected for another pose would lie wrong over the recorded image.
    if (beside && this.reference && isDriven(state)) this.drawOverlays(context, picture, other);
    this.drawMarks(context);
    if (state.compare !== "off") this.drawLabels(context, state, other);
  }

  /** Returns the rectangle around the lines of some kinds; null where there are none. */
  outlineOf(kinds: Line["kind"][]): Outline | null {
    const lines = this.image?.header.lines.filter(({kind}) => kinds.includes(kind)) ?? [];
    const points = lines.flatMap((line) => line.points);
    if (points.length === 0) return null;
    const {x, y, width, height} = this.rendering;
    const scale = this.canvas.clientWidth / this.canvas.width;
    const u = points.filter((_, i) => i % 2 === 0).map((value) => scale * (x + value * width));
    const v = points.filter((_, i) => i % 2 === 1).map((value) => scale * (y + value * height));
    return {
      left: Math.min(...u), right: Math.max(...u), top: Math.min(...v), bottom: Math.max(...v),
    };
  }

  /** Names the halves of a comparison. */
  private drawLabels(context: CanvasRenderingContext2D, state: State, other: Rect): void {
    const name = state.novel ? "ground truth" : "recorded";
    const recorded = this.reference ? name : `${name}: none`;
    const here = this.rendering;
    const put = (text: string, to: Rect, atRight: boolean) => {
      const unit = devicePixelRatio;
      context.font = `${13 * unit}px system-ui, sans-serif`;
      const width = context.measureText(text).width + 12 * unit;
      const left = atRight ? to.x + to.width - width - 8 * unit : to.x + 8 * unit;
      context.fillStyle = "rgb(0 0 0 / 65%)";
      context.fillRect(left, to.y + 8 * unit, width, 22 * unit);
      context.fillStyle = "#fff";
      context.fillText(text, left + 6 * unit, to.y + 23 * unit);
    };
    if (state.compare === "difference") return put(`rendered − ${recorded}, × 4`, here, false);
    put("rendered", here, false);
    if (state.compare === "beside") put(recorded, other, false);
    if (state.compare === "wipe") put(recorded, here, true);
    if (state.compare === "blend")
      put(`${recorded}, ${Math.round(100 * state.share)} %`, here, true);
  }

  private drawReference(
    context: CanvasRenderingContext2D, bitmap: ImageBitmap, state: State, to: Rect,
    put: (bitmap: ImageBitmap, to: Rect) => void,
  ): void {
    if (state.compare === "beside") put(bitmap, to);
    if (state.compare === "blend") {
      context.globalAlpha = state.share;
      put(bitmap, to);
      context.globalAlpha = 1;
    }
    if (state.compare === "wipe") {
      const edge = to.x + to.width * (1 - state.share);
      context.save();
      context.beginPath();
      context.rect(edge, to.y, to.width, to.height);
      context.clip();
      put(bitmap, to);
      context.restore();
      context.fillStyle = "#fff";
      context.fillRect(edge - devicePixelRatio, to.y, 2 * devicePixelRatio, to.height);
    }
    if (state.compare === "difference") {
      context.globalCompositeOperation = "difference";
      put(bitmap, to);
      context.globalCompositeOperation = "lighter"; // twice the canvas onto itself: x 4
      context.drawImage(this.canvas, 0, 0);
      context.drawImage(this.canvas, 0, 0);
      context.globalCompositeOperation = "source-over";
    }
  }

  private drawOverlays(
    context: CanvasRenderingContext2D, picture: Picture<ImageHeader>, to: Rect,
  ): void {
    context.save();
    context.beginPath();
    context.rect(to.x, to.y, to.width, to.height);
    context.clip();
    const shape = this.maskOf(picture);
    if (shape) context.drawImage(shape, to.x, to.y, to.width, to.height);
    const {points} = picture;
    // Few points are larger: a tenth of their distance, up to 8 pixels.
    const apart = Math.sqrt((6 * to.width * to.height) / Math.max(1, points.length));
    const large = Math.round(Math.max(3, to.width / 400, Math.min(8, apart / 10)));
    for (let i = 0; i + 5 < points.length; i += 6) {
      const u = (points[i] + 256 * points[i + 1]) / 65535;
      const v = (points[i + 2] + 256 * points[i + 3]) / 65535;
      context.fillStyle = lidarLevels[points[i + 4]];
      // size of a point in a scan, or in the cloud
      const size = points[i + 5] ? large : large - 1;
      context.fillRect(to.x + u * to.width - size / 2, to.y + v * to.height - size / 2, size, size);
    }
    context.lineWidth = 1.5 * devicePixelRatio;
    context.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    for (const line of picture.header.lines) {
      context.strokeStyle = context.fillStyle = colours[line.kind];
      const points = line.kind === "handle" && this.handleAt
        ? [...line.points.slice(0, 2), this.handleAt.u, this.handleAt.v] : line.points;
      context.beginPath();
      for (let i = 0; i + 1 < points.length; i += 2)
        context.lineTo(to.x + points[i] * to.width, to.y + points[i + 1] * to.height);
      context.stroke();
      if (line.kind === "handle") {
        const [u, v] = points.slice(-2);
        context.beginPath();
        context.arc(to.x + u * to.width, to.y + v * to.height, 7 * devicePixelRatio, 0, 7);
        context.fill();
      }
      if (line.label)
        context.fillText(
          line.label,
          to.x + line.points[0] * to.width + 3 * devicePixelRatio,
          to.y + line.points[1] * to.height - 3 * devicePixelRatio,
        );
    }
    context.restore();
  }

  /** The masked pixels in half transparent red, made once for an image. */
  private maskOf(picture: Picture<ImageHeader>): OffscreenCanvas | null {
    if (this.masked?.of === picture) return this.masked.shape;
    this.masked = {of: picture, shape: null};
    this.maskedShare = 0;
    if (picture.mask.length === 0) return null;
    const {full_width, full_height} = picture.header;
    const image = new ImageData(full_width, full_height);
    const pixels = new Uint32Array(image.data.buffer);
    let [at, used, length, shift, masked] = [0, true, 0, 0, 0];
    for (const byte of picture.mask) {
      length += (byte & 127) * 2 ** shift;
      shift += 7;
      if (byte & 128) continue;
      if (!used) pixels.fill(0x803030ff, at, at + length), (masked += length); // alpha, b, g, r
      at += length;
      used = !used;
      length = shift = 0;
    }
    const shape = new OffscreenCanvas(full_width, full_height);
    shape.getContext("2d")?.putImageData(image, 0, 0);
    this.masked.shape = shape;
    this.maskedShare = masked / pixels.length;
    return shape;
  }

  private drawMarks(context: CanvasRenderingContext2D): void {
    const {x, y, width, height} = this.rendering;
    const r = 6 * devicePixelRatio;
    for (const mark of this.marks) {
      const [u, v] = [x + mark.u * width, y + mark.v * height];
      for (const [style, thickness] of [["#000", 4], ["#fff", 2]] as const) {
        context.strokeStyle = style;
        context.lineWidth = thickness * devicePixelRatio;
        context.beginPath();
        context.moveTo(u - r, v);
        context.lineTo(u + r, v);
        context.moveTo(u, v - r);
        context.lineTo(u, v + r);
        context.stroke();
      }
    }
  }
}
