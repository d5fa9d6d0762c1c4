// SPDX-License-Identifier: Apache-2.0
// Pointer actions in the image: look around, move ahead, wipe, drag the selected object, click
// points.
import type {Mark, Stage} from "./stage";
import type {State} from "./state";
import type {TrafficPart} from "./traffic";

const degreesPerPixel = 0.15;
const metresPerPixel = 0.005;  // motion for each pixel of the wheel
const clickReach = 4; // pixels that the pointer may move in a click

/** The page, as the pointer sees it. */
interface Page {
  readonly stage: Stage;
  readonly state: State;
  changed(): void;
  play(on: boolean): void;
  pick(mark: Mark, selects: boolean): void;
  turn(yaw_deg: number, pitch_deg: number): void;
  moveAhead(ahead: number): void;
  readonly turnsAbout: boolean;  // the camera circles the point that it looks at
  readonly unit: number;  // unit of lengths
}

interface Held {
  x: number;
  y: number;
  moved: boolean;
  wipes: boolean;
  mark: Mark | null;
  grip: "object" | "handle" | null;
}

export function listenToPointer(place: HTMLElement, page: Page, traffic: TrafficPart): void {
  const {stage, state} = page;
  let held: Held | null = null;
  const gripAt = (mark: Mark | null) => mark && traffic.grip(
    mark, stage.image?.header.lines ?? [], (a, b) => stage.distance(a, b));
  place.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    place.setPointerCapture(event.pointerId);
    const mark = stage.at(event.clientX, event.clientY);
    const wipes = state.compare === "wipe" && mark !== null &&
      Math.abs(mark.u - (1 - state.share)) < 0.02;
    held = {x: event.clientX, y: event.clientY, moved: false, wipes, mark,
      grip: wipes ? null : gripAt(mark)};
  });
  place.addEventListener("pointermove", (event) => {
    if (!held) {
      const grip = gripAt(stage.at(event.clientX, event.clientY));
      stage.cursor = grip === "object" ? "move" : grip === "handle" ? "grab" : "";
      return;
    }
    const [dx, dy] = [event.clientX - held.x, event.clientY - held.y];
    if (!held.moved && Math.hypot(dx, dy) < clickReach) return;
    if (held.grip && held.mark) {
      if (!held.moved) {
        page.play(false);
        traffic.beginDrag(held.mark, held.grip === "handle");
      }
      held.moved = true;
      const mark = stage.at(event.clientX, event.clientY);
      if (mark) traffic.dragTo(mark);
      return;
    }
    Object.assign(held, {x: event.clientX, y: event.clientY, moved: true});
    if (held.wipes) {
      state.share = Math.round(100 * (1 - stage.across(event.clientX))) / 100;
      page.changed();
    } else {
      const scale = degreesPerPixel * (page.turnsAbout ? -2 : 1);
      page.turn(scale * dx, scale * dy);
    }
  });
  const end = (event: PointerEvent, clicks: boolean) => {
    const mark = stage.at(event.clientX, event.clientY);
    if (held && !held.moved && clicks && mark) page.pick(mark, true);
    if (held?.grip && held.moved) traffic.endDrag();
    held = null;
  };
  place.addEventListener("pointerup", (event) => end(event, true));
  place.addEventListener("pointercancel", (event) => end(event, false));
  place.addEventListener("wheel", (event) => {
    event.preventDefault();
    page.moveAhead(-metresPerPixel * page.unit * event.deltaY);
  }, {passive: false});
}
