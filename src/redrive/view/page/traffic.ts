// SPDX-License-Identifier: Apache-2.0
// The panel's part for moving objects: their list, the change of the selected one, undo, and
// loading and saving EDIT.json. The program applies every change and reports errors.
import {element} from "./controls";
import {
  changeOf, copyOf, editText, fileText, History, noEdit, parseEdit, reset, setChange, type Change,
  type Edit,
} from "./edit";
import {ObjectFields} from "./object_fields";
import {download} from "./panels";
import type {Dragged, Edited, Hello, Line, ObjectInfo} from "./protocol";
import type {Mark} from "./stage";
import {moves, type State} from "./state";

const usualFile = "EDIT.json";
const mostCharacters = 500000;  // longest text of an edit: the program takes messages of 1 MiB
const nearHandle = 14; // pixels

interface Sent {
  id: number;
  text: string;
  file: string;  // file that was loaded; empty: none
}

interface Drag {
  object: number;
  turns: boolean;
  from: Mark;
  at: Mark; // where the pointer is
  change: Change; // when it began
  next: Mark | null;  // the same, until the program was asked for it
  waits: boolean; // for an answer
  ended: boolean;
}

/** Whether the convex hull of the points contains a point: no half of the directions is free. */
function contains(points: Mark[], {u, v}: Mark): boolean {
  const angles = points.map((point) => Math.atan2(point.v - v, point.u - u)).sort((a, b) => a - b);
  return angles.length > 2 && angles.every((angle, i) =>
    (i + 1 < angles.length ? angles[i + 1] : angles[0] + 2 * Math.PI) - angle < Math.PI);
}

function marks(line: Line): Mark[] {
  return line.points.flatMap((u, i, all) => (i % 2 === 0 ? [{u, v: all[i + 1]}] : []));
}

export class TrafficPart {
  private edit: Edit;
  private readonly history: History;
  private sent: Sent = {id: 0, text: "", file: ""}; // the last edit
  private unanswered: Sent[] = []; // edits up to the last one; the program may skip some
  private accepted: string; // the last edit that the program took
  private file = {name: usualFile, text: "{}"};  // file that holds an edit
  private drag: Drag | null = null;
  private dragId = 0;
  private readonly fields: ObjectFields;
  private readonly stored: string; // key of the edit in the tab's storage: it outlives a reload

  /** `changed` is called when the state has changed, `again` when the image has, too. */
  constructor(
    private readonly hello: Hello,
    private readonly state: State,
    private readonly send: (message: object) => void,
    private readonly changed: () => void,
    private readonly again: () => void,
  ) {
    this.stored = `edit ${location.pathname} ${hello.run}`;
    const first = hello.edit ? editText(parseEdit(hello.edit.text)) : "{}";
    if (hello.edit?.file) this.file = {name: hello.edit.file, text: first};
    this.accepted = first;
    this.history = new History(first);
    this.history.add(sessionStorage.getItem(this.stored) ?? first);
    this.edit = parseEdit(this.history.current());
    this.fields = new ObjectFields(element("object-fields"), hello.objects,
      (fields, done) => this.change(fields, done));
    element("traffic").hidden = hello.objects.length === 0 && !hello.edit;
    const on = (id: string, action: () => void) => element(id).addEventListener("click", action);
    on("edit-undo", () => this.step(-1));
    on("edit-redo", () => this.step(1));
    on("edit-clear", () => this.commit(noEdit()));
    on("object-go", () => this.goThere());
    on("turn-left", () => this.turnBy(5));
    on("turn-right", () => this.turnBy(-5));
    on("object-close", () => this.select(null));
    on("object-copy", () => this.copyObject());
    on("object-reset", () => this.resetObject());
    on("edit-save", () => this.save());
    on("edit-load", () => element("edit-file").click());
    element("edit-file").addEventListener("change", () => void this.load());
    element("objects").addEventListener("change", () => {
      const {value} = element<HTMLSelectElement>("objects");
      this.select(value === "" ? null : Number(value));
    });
    this.update();
  }

  /** Sends the edit to a program that may not have it. */
  connected(): void {
    if (this.drag) this.history.add(editText(this.edit));
    this.drag = null;
    if (editText(this.edit) !== "{}" || this.hello.edit) this.submit();
  }

  receive(message: Edited | Dragged): void {
    if (message.kind === "dragged") return this.dragged(message);
    const answered = this.unanswered.find(({id}) => id === message.id);
    this.unanswered = this.unanswered.filter(({id}) => id > message.id); // those before: skipped
    if (!answered) return;
    const {text, file} = answered;
    if (message.id !== this.sent.id) { // overtaken
      if (message.error === undefined) this.accepted = editText(parseEdit(text));
      return;
    }
    if (message.error !== undefined) {
      if (file === "") this.history.backTo(this.accepted);
      this.edit = parseEdit(this.accepted);
      return this.show(message.error);
    }
    if (file !== "") {
      this.edit = parseEdit(text);
      this.file = {name: file, text: editText(this.edit)};
      this.history.add(this.file.text);
      this.again();
    }
    this.accepted = editText(parseEdit(text));
    this.show((message.remarks ?? []).join("; "));
  }

  select(id: number | null): void {
    this.state.object = id !== null && this.ids().includes(id) ? id : null;
    this.update();
    this.changed();
  }

  /** Turns the selected object. */
  turnBy(degrees: number): void {
    if (this.state.object === null) return;
    const turn_deg = (changeOf(this.edit, this.state.object).turn_deg ?? 0) + degrees;
    this.change({turn_deg: turn_deg > 180 ? turn_deg - 360 : turn_deg < -180 ? turn_deg + 360
      : turn_deg}, true);
  }

  /** Removes the selected object, or brings it back. */
  toggle(): void {
    if (this.state.object === null) return;
    this.change({remove: !changeOf(this.edit, this.state.object).remove}, true);
  }

  /** Undoes, or with 1 redoes, a change. */
  step(by: number): void {
    if (!this.history.has(by)) return;
    this.edit = parseEdit(this.history.go(by));
    this.submit();
  }

  // ---- Dragging in the image

  /** What of the selected object lies under the pointer. `pixels`: the distance of two marks. */
  grip(
    at: Mark, lines: Line[], pixels: (a: Mark, b: Mark) => number,
  ): "object" | "handle" | null {
    if (this.state.object === null) return null;
    // A press within the outline moves the object, wherever the handle lies.
    const box = lines.filter(({kind}) => kind === "object").flatMap(marks);
    if (contains(box, at)) return "object";
    const handle = lines.find(({kind}) => kind === "handle");
    const tip = handle && marks(handle).pop();
    return tip && pixels(tip, at) < nearHandle ? "handle" : null;
  }

  /** Whether an object is dragged. */
  drags(): boolean {
    return this.drag !== null && !this.drag.ended;
  }

  /** Where the handle is while it is dragged. */
  handleAt(): Mark | null {
    return this.drag?.turns && !this.drag.ended ? this.drag.at : null;
  }

  beginDrag(from: Mark, turns: boolean): void {
    if (this.state.object === null) return;
    const change = changeOf(this.edit, this.state.object);
    this.drag = {
      object: this.state.object, turns, from, at: from, change: {...change}, next: null,
      waits: false, ended: false,
    };
  }

  dragTo(mark: Mark): void {
    if (!this.drag) return;
    this.drag.next = this.drag.at = mark;
    this.askWhere();
  }

  endDrag(): void {
    if (!this.drag) return;
    this.drag.ended = true;
    this.askWhere();
  }

  /** Asks the program where the pointer takes the object, one question at a time. */
  private askWhere(): void {
    const {drag} = this;
    if (!drag || drag.waits) return;
    if (!drag.next) {
      if (drag.ended) this.commit(this.edit);
      if (drag.ended) this.drag = null;
      return;
    }
    this.send({
      type: "drag", id: ++this.dragId, object: drag.object, turns: drag.turns,
      from: [drag.from.u, drag.from.v], to: [drag.next.u, drag.next.v],
      shift_m: drag.change.shift_m ?? [0, 0, 0], turn_deg: drag.change.turn_deg ?? 0,
    });
    drag.next = null;
    drag.waits = true;
  }

  private dragged({id, shift_m, turn_deg}: Dragged): void {
    if (!this.drag || id !== this.dragId) return;
    const {object} = this.drag;
    this.drag.waits = false;
    const rounded = (x: number, steps: number) => Math.round(x * steps) / steps || 0;
    const [forward, left, up] = (shift_m ?? []).map((x) => rounded(x, 1000));
    if (shift_m) this.change({shift_m: [forward, left, up]}, false, object);
    if (turn_deg !== undefined) this.change({turn_deg: rounded(turn_deg, 10)}, false, object);
    this.askWhere();
  }

  // ---- The edit

  /** Changes an object; `done`: as a step that undo takes back. */
  private change(fields: Change, done: boolean, object = this.state.object): void {
    if (object === null) return;
    setChange(this.edit, object, fields);
    if (done) this.commit(this.edit);
    else this.submit();
  }

  /** Makes an edit the current one, as a step. */
  private commit(edit: Edit): void {
    this.edit = edit;
    this.history.add(editText(edit));
    this.submit();
  }

  private submit(): void {
    const text = editText(this.edit);
    if (text.length > mostCharacters) {
      this.edit = parseEdit(this.accepted);
      return this.show("The edit is larger than the viewer takes.");
    }
    this.sendEdit(text, "");
    this.show("");
    this.again();
  }

  private sendEdit(text: string, file: string): void {
    this.sent = {id: this.sent.id + 1, text, file};
    this.unanswered.push(this.sent);
    // At most 256 bytes of a file's name.
    const name = [...(file || usualFile)].slice(0, 64).join("");
    this.send({type: "edit", id: this.sent.id, file: name, text});
  }

  /** Shows the edit and a note. */
  private show(note: string): void {
    element("edit-note").textContent = note;
    sessionStorage.setItem(this.stored, editText(this.edit));
    if (!this.ids().includes(this.state.object ?? NaN)) this.state.object = null;
    this.update();
  }

  private copyObject(): void {
    const {object} = this.state;
    if (object === null) return;
    const edit = parseEdit(editText(this.edit));
    const last = Math.max(0, ...this.hello.objects.map(({id}) => id));
    const length = this.infoOf(object)?.size_m[0] ?? 5;
    this.state.object = copyOf(edit, object, last, Math.round(10 * (length + 2)) / 10);
    this.commit(edit);
  }

  private resetObject(): void {
    const {object} = this.state;
    if (object === null) return;
    const edit = parseEdit(editText(this.edit));
    reset(edit, object);
    this.commit(edit);
  }

  private save(): void {
    const text = editText(this.edit);
    download(new Blob([fileText(text)], {type: "application/json"}), usualFile);
    this.file = {name: usualFile, text};
    this.update();
    element("edit-note").textContent = `Saved as ${usualFile}, where the browser puts downloads.`;
  }

  private async load(): Promise<void> {
    const input = element<HTMLInputElement>("edit-file");
    const file = input.files?.[0];
    if (!file) return;
    const text = file.size > mostCharacters ? "" : await file.text();
    input.value = ""; // the same file can be chosen again
    if (text.length === 0) {
      const why = file.size > 0 ? `has more than ${mostCharacters} bytes` : "is empty";
      element("edit-note").textContent = `${file.name} ${why}.`;
      return;
    }
    this.sendEdit(text, file.name);
  }

  // ---- The panel

  private ids(): number[] {
    return [...this.hello.objects, ...this.edit.copies, ...this.edit.added].map(({id}) => id);
  }

  /** The object of the recording that it is, or that it is a copy of. */
  private infoOf(id: number): ObjectInfo | undefined {
    const of = this.edit.copies.find((copy) => copy.id === id)?.of ?? id;
    return this.hello.objects.find((object) => object.id === of);
  }

  private goThere(): void {
    const {state} = this;
    const nearest = state.object === null ? null : this.infoOf(state.object)?.nearest;
    if (!nearest) return;
    for (const move of moves) state[move] = 0;
    Object.assign(state, {...nearest, novel: null, mount: null});
    this.changed();
  }

  private label(id: number): string {
    const info = this.infoOf(id);
    const copy = this.edit.copies.find((one) => one.id === id);
    const change = changeOf(this.edit, id);
    const words = [`${id} ${info?.type.toLowerCase() ?? "added"}`, info?.frames?.join(" to ") ?? ""];
    if (copy) words.push(`copy of ${copy.of}`);
    if (change.remove) words.push("removed");
    else if (info?.id === id && Object.keys(change).length > 0) words.push("changed");
    return words.filter((word) => word !== "").join(" · ");
  }

  private update(): void {
    const {state} = this;
    const ids = this.ids();
    const list = element<HTMLSelectElement>("objects");
    list.replaceChildren(...ids.map((id) => new Option(this.label(id), String(id))));
    list.value = String(state.object ?? "");
    element("object").hidden = state.object === null;
    if (state.object !== null) {
      const type = this.infoOf(state.object)?.type.toLowerCase() ?? "added";
      this.fields.show(`${state.object} ${type}`, changeOf(this.edit, state.object));
    }
    const text = editText(this.edit);
    const isSaved = text === this.file.text;
    state.edit = text === "{}" ? "" : isSaved ? this.file.name : usualFile;
    const enable = (id: string, on: boolean) => (element<HTMLButtonElement>(id).disabled = !on);
    enable("edit-undo", this.history.has(-1));
    enable("edit-redo", this.history.has(1));
    enable("edit-clear", text !== "{}");
    enable("edit-save", text !== "{}");
    element("edit-save").textContent = isSaved || text === "{}" ? "Save" : "Save *";
    enable("object-go", Boolean(state.object !== null && this.infoOf(state.object)?.nearest));
  }
}
