// SPDX-License-Identifier: Apache-2.0
// What the colours of layers and overlays mean.
import type {Hello} from "./protocol";
import type {State} from "./state";
import {lidarLevels} from "./stage";

const lidar_m = [1, 100]; // as ../rendered_scans.cc colours points
const scanBars = { // likewise
  range: ["range", "1 m", "100 m, logarithmic"],
  intensity: ["intensity", "0", "1, by its root"],
  error: ["error", "1 cm", "1 m or lost, logarithmic"],
};

function swatch(colour: string, text: string): HTMLElement {
  const item = document.createElement("span");
  const box = document.createElement("i");
  box.style.background = colour;
  item.append(box, text);
  return item;
}

function bar(colours: string[], from: string, to: string, name: string): HTMLElement {
  const item = document.createElement("span");
  const strip = document.createElement("i");
  strip.className = "bar";
  strip.style.background = `linear-gradient(90deg, ${colours.join(", ")})`;
  item.append(`${name} ${from}`, strip, to);
  return item;
}

function lengths(values: number[], unit: string): string[] {
  return values.map((value) => `${Number(value.toPrecision(2))}${unit}`);
}

/** Fills `place` for a state; it is hidden where colours are those of the image. */
export function showLegend(place: HTMLElement, hello: Hello, state: State): void {
  const unit = hello.metric ? " m" : "";
  const items: HTMLElement[] = [];
  const {layer, overlays, scan} = state;
  if (layer === "depth" && hello.depth) {
    const [near, far] = lengths([hello.depth.near_m, hello.depth.far_m], unit);
    items.push(bar(hello.depth.colours, near, `${far}, logarithmic`, "depth"));
  }
  if (layer === "coverage") items.push(swatch("#f00", "no training image saw it"));
  if (layer === "actors") items.push(swatch("#ff8000", "a colour for each moving object"));
  if (layer === "opacity") items.push(bar(["#000", "#fff"], "empty", "opaque", "opacity"));
  if (layer === "normals")
    items.push(swatch("#ff8080", "faces right"), swatch("#80ff80", "up"),
      swatch("#8080ff", "the camera"));
  if (overlays.has("lidar") || overlays.has("cloud")) {
    const [near, far] = lengths(lidar_m, unit);
    items.push(bar(lidarLevels.filter((_, i) => i % 15 === 0), near, `${far}, logarithmic`,
      "LiDAR"));
  }
  if (scan) {
    const [name, from, to] = scanBars[scan.colour];
    const colours = lidarLevels.filter((_, i) => i % 15 === 0);
    items.push(bar(scan.colour === "range" ? colours : colours.reverse(), from, to,
      `rendered scan, ${name}`));
  }
  if (overlays.has("masks")) items.push(swatch("#ff303080", "not in training or scores"));
  place.replaceChildren(...items);
  place.hidden = items.length === 0;
}
