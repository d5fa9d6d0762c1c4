// SPDX-License-Identifier: Apache-2.0
// Parts of the panel that stay closed, full screen, and the image as a file.
import {element} from "./controls";

const closedKey = "redrive view: closed parts";

/** Closes the parts that were closed in this browser before, and remembers what is closed. */
export function rememberClosedParts(): void {
  const parts = [...document.querySelectorAll<HTMLDetailsElement>("#panel > details.part")];
  const before = localStorage.getItem(closedKey);
  if (before !== null)
    for (const part of parts) part.open = !before.split(" ").includes(part.id);
  for (const part of parts)
    part.addEventListener("toggle", () => localStorage.setItem(closedKey,
      parts.filter(({open}) => !open).map(({id}) => id).join(" ")));
}

export function toggleFullScreen(): void {
  if (document.fullscreenElement) void document.exitFullscreen();
  else void element("left").requestFullscreen?.();
}

/** Hands the user a file, as a download. */
export function download(file: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Saves what the canvas shows. */
export function saveImage(name: string): void {
  element<HTMLCanvasElement>("canvas").toBlob((file) => {
    if (file) download(file, name);
  });
}
