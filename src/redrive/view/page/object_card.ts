// SPDX-License-Identifier: Apache-2.0
// Places the card of the selected object: beside it in the image, under the image on a narrow page.
import {element, isNarrow} from "./controls";
import type {Stage} from "./stage";

const gap = 16; // pixels from the object's outline and from the edges

/** Places the card; `isDragged`: it is out of the way. */
export function placeCard(stage: Stage, isDragged: boolean): void {
  const card = element("object");
  if (card.hidden) return;
  card.classList.toggle("away", isDragged);
  if (isNarrow()) {
    card.style.left = card.style.top = "";
    return;
  }
  const [view, canvas] = [element("view"), element("canvas")];
  const offset = {left: canvas.offsetLeft, top: canvas.offsetTop};
  const outline = stage.outlineOf(["object", "handle"]);
  const most = {left: view.clientWidth - card.offsetWidth - gap / 2,
    top: view.clientHeight - card.offsetHeight - gap / 2};
  let left = gap / 2;
  let top = gap / 2;
  if (outline) {
    const right = offset.left + outline.right + gap;
    const before = offset.left + outline.left - gap - card.offsetWidth;
    // Right of it, left of it, or in the corner that is further away.
    left = right <= most.left ? right
      : before >= gap / 2 ? before
      : outline.left + outline.right > canvas.offsetWidth ? gap / 2 : most.left;
    top = offset.top + outline.top;
  }
  card.style.left = `${Math.max(gap / 2, Math.min(left, most.left))}px`;
  card.style.top = `${Math.max(gap / 2, Math.min(top, most.top))}px`;
}
