// SPDX-License-Identifier: Apache-2.0
// The line under the image: what is shown, and its score.
import type {Hello, ImageHeader} from "./protocol";
import {isDriven, type State} from "./state";

/** What the page knows of the image that is shown. */
export interface Shown {
  header: ImageHeader | null;
  isOfState: boolean;  // the image shows the state
  psnr_db: number | null;
  seen: number | null; // share of pixels
  noReference: string; // why there is no recorded image
  maskedShare: number;
}

const worthSaying = 0.05;  // distance from the driven way above which it is shown, metres

function beside(hello: Hello, beside: number): string {
  if (!hello.metric) return `beside the photographs: ${Number(beside.toPrecision(2))}`;
  return beside < worthSaying ? "" : `beside the drive: ${beside.toFixed(1)} m`;
}

export function captionOf(hello: Hello, state: State, shown: Shown): string {
  const words: string[] = [];
  const driven = isDriven(state);
  const {header} = shown;
  if (!hello.method && !driven)
    words.push("a recording has images where they were taken only; train a run to see more");
  if (state.novel) words.push(`${state.novel.set}, frame ${state.frame}`);
  else if (hello.held_out.includes(state.frame)) words.push("held out from training");
  if ((!driven || state.novel) && header && shown.isOfState)
    words.push(beside(hello, header.beside));
  if (shown.seen !== null)
    words.push(`${(100 * shown.seen).toFixed(0)} % seen by training images`);
  if (state.compare !== "off" && shown.noReference) words.push(shown.noReference);
  else if (state.compare !== "off" && !driven)
    words.push("the recorded image is that of the frame's own pose");
  const scan = header?.scan;
  if (scan)
    words.push(`rendered scan: ${scan.returns} of ${scan.rays} rays return` +
      (scan.error_m === null ? "" : `, median error ${(100 * scan.error_m).toFixed(1)} cm`));
  if (state.overlays.has("masks"))
    words.push(driven && !state.novel
      ? `${(100 * shown.maskedShare).toFixed(1)} % masked`
      : "masks are those of the recorded image, from the frame's own pose");
  if (state.edit && state.compare !== "off") words.push("the recorded image is not edited");
  if (state.object !== null && header && shown.isOfState &&
    !header.lines.some(({kind}) => kind === "object"))
    words.push(`object ${state.object} is not in this image`);
  if (header?.trouble) words.push(header.trouble);
  if (shown.psnr_db !== null && (!state.edit || state.compare !== "off"))
    words.push(`PSNR ${shown.psnr_db.toFixed(2)} dB against the ` +
      (state.novel ? "ground truth" : "recorded image"));
  return words.filter((word) => word !== "").join(" · ");
}
