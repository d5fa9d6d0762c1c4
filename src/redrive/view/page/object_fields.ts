// SPDX-License-Identifier: Apache-2.0
// The fields of the selected object's change.
import {element} from "./controls";
import type {Change, Three} from "./edit";
import type {ObjectInfo} from "./protocol";

const numbers = {
  forward: {label: "forward, m", step: 0.1, at: (change: Change) => change.shift_m?.[0] ?? 0},
  left: {label: "left, m", step: 0.1, at: (change: Change) => change.shift_m?.[1] ?? 0},
  up: {label: "up, m", step: 0.1, at: (change: Change) => change.shift_m?.[2] ?? 0},
  turn: {label: "turn, °", step: 5, at: (change: Change) => change.turn_deg ?? 0},
  speed: {label: "speed, ×", step: 0.1, at: (change: Change) => change.speed ?? 1},
  red: {label: "red, ×", step: 0.1, at: (change: Change) => change.gain?.[0] ?? 1},
  green: {label: "green, ×", step: 0.1, at: (change: Change) => change.gain?.[1] ?? 1},
  blue: {label: "blue, ×", step: 0.1, at: (change: Change) => change.gain?.[2] ?? 1},
  from: {label: "hidden, s", step: 0.1, at: (change: Change) => change.hide_s?.[0]},
  to: {label: "to, s", step: 0.1, at: (change: Change) => change.hide_s?.[1]},
};
type Name = keyof typeof numbers;

export class ObjectFields {
  private readonly inputs = {} as Record<Name, HTMLInputElement>;
  private readonly removed = element<HTMLInputElement>("object-removed");
  private readonly body = document.createElement("select");
  private file: {file: string} | undefined;  // file of a body that is among the choices

  /** `changed` gets the fields of a change that were set; `done`: and will not be for a while. */
  constructor(
    place: HTMLElement, objects: ObjectInfo[],
    private readonly changed: (fields: Change, done: boolean) => void,
  ) {
    this.body.id = "object-body";
    this.body.add(new Option("its own", ""));
    for (const {id, type} of objects)
      this.body.add(new Option(`${id} ${type.toLowerCase()}`, String(id)));
    this.body.addEventListener("change", () => {
      const {value} = this.body;
      changed({body: value === "" ? undefined : value === "file" ? this.file : Number(value)}, true);
    });
    this.removed.addEventListener("change", () => changed({remove: this.removed.checked}, true));
    const row = (text: string, input: HTMLElement) => {
      const made = document.createElement("label");
      made.append(text, input);
      return made;
    };
    for (const [name, {label, step}] of Object.entries(numbers) as [Name, {
      label: string; step: number;
    }][]) {
      const input = (this.inputs[name] = document.createElement("input"));
      input.type = "number";
      input.id = `object-${name}`;
      input.step = String(step);
      for (const event of ["input", "change"])
        input.addEventListener(event, () => this.read(name, event === "change"));
      place.append(row(label, input));
    }
    place.append(row("body of", this.body));
  }

  /** Shows a change; a field that is being edited keeps its text. */
  show(name: string, change: Change): void {
    element("object-title").textContent = name + (change.track?.length ? ", on another track" : "");
    for (const [name, {at}] of Object.entries(numbers) as [Name, {
      at: (change: Change) => number | undefined;
    }][]) {
      const input = this.inputs[name];
      if (document.activeElement !== input) input.value = String(at(change) ?? "");
    }
    this.removed.checked = change.remove ?? false;
    if (typeof change.body === "object" && this.file?.file !== change.body.file) {
      if (this.file) this.body.options[this.body.options.length - 1].remove();
      this.file = change.body;
      this.body.add(new Option(this.file.file, "file"));
    }
    this.body.value = typeof change.body === "object" ? "file" : String(change.body ?? "");
  }

  private read(name: Name, done: boolean): void {
    const value = (of: Name) => this.inputs[of].valueAsNumber;
    const three = (names: Name[]) => names.map(value) as Three;
    const fields: Change =
      name === "turn" ? {turn_deg: value("turn")}
      : name === "speed" ? {speed: value("speed")}
      : name === "red" || name === "green" || name === "blue"
        ? {gain: three(["red", "green", "blue"])}
      : name === "from" || name === "to" ? {hide_s: [value("from"), value("to")]}
      : {shift_m: three(["forward", "left", "up"])};
    const isEmpty = (of: Name) => this.inputs[of].value === "";
    if (fields.hide_s && isEmpty("from") && isEmpty("to")) fields.hide_s = undefined;
    else if (Object.values(fields).flat().some(Number.isNaN)) return; // a number is not complete
    this.changed(fields, done);
  }
}
