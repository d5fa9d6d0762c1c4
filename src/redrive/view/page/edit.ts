// SPDX-License-Identifier: Apache-2.0
// Changes to moving objects as an EDIT.json holds them (edit/traffic_edit.h), and the way back.

export type Three = [number, number, number];

export interface Change {
  remove?: boolean;
  track?: unknown[];
  speed?: number;
  shift_m?: Three; // forward, left, up in the object's own axes
  turn_deg?: number;
  hide_s?: [number, number];
  body?: number | {file: string};
  gain?: Three;
}

export interface Copy extends Change {
  of: number;
  id: number;
}

/** An object of no recording. */
export interface Added extends Change {
  id: number;
}

export interface Edit {
  actors: Record<string, Change>;
  copies: Copy[];
  added: Added[];
}

export const noEdit = (): Edit => ({actors: {}, copies: [], added: []});

const unchanged: Change = {
  remove: false, track: [], speed: 1, shift_m: [0, 0, 0], turn_deg: 0, gain: [1, 1, 1],
};

/** Throws SyntaxError for what is no JSON. */
export function parseEdit(text: string): Edit {
  return {...noEdit(), ...(JSON.parse(text) as Partial<Edit>)};
}

/** An edit as text, without what changes nothing; "{}" where nothing is changed. */
export function editText(edit: Edit): string {
  const short = <T extends Change>(change: T) => Object.fromEntries(
    Object.entries(change).filter(([key, value]) => JSON.stringify(value) !==
      JSON.stringify(unchanged[key as keyof Change])));
  const actors = Object.entries(edit.actors).map(([id, change]) => [id, short(change)] as const)
    .filter(([, change]) => Object.keys(change).length > 0);
  return JSON.stringify({
    ...(actors.length > 0 && {actors: Object.fromEntries(actors)}),
    ...(edit.copies.length > 0 && {copies: edit.copies.map(short)}),
    ...(edit.added.length > 0 && {added: edit.added.map(short)}),
  });
}

/** The text of an EDIT.json for people: a line for each object. */
export function fileText(text: string): string {
  const {actors, copies, added} = parseEdit(text);
  const list = (lines: string[], [open, close]: string) =>
    lines.length > 0 ? [`${open}\n  ${lines.join(",\n  ")}${close}`] : [];
  const own = Object.entries(actors).map(([id, change]) => `"${id}": ${JSON.stringify(change)}`);
  const parts = [
    ...list(own, "{}").map((part) => `"actors": ${part}`),
    ...list(copies.map((copy) => JSON.stringify(copy)), "[]").map((part) => `"copies": ${part}`),
    ...list(added.map((one) => JSON.stringify(one)), "[]").map((part) => `"added": ${part}`),
  ];
  return `{${parts.join(",\n ")}}\n`;
}

/** What the edit alone has, not the recording. */
function made(edit: Edit, id: number): Copy | Added | undefined {
  return [...edit.copies, ...edit.added].find((one) => one.id === id);
}

/** The change of an object, also of one that the edit made. */
export function changeOf(edit: Edit, id: number): Change {
  return made(edit, id) ?? edit.actors[id] ?? {};
}

/** Sets some fields of the change of an object. */
export function setChange(edit: Edit, id: number, fields: Change): void {
  const one = made(edit, id);
  if (one) Object.assign(one, fields);
  else edit.actors[id] = {...edit.actors[id], ...fields};
}

/** Takes back all changes of an object; one that the edit made goes. */
export function reset(edit: Edit, id: number): void {
  delete edit.actors[id];
  edit.copies = edit.copies.filter((copy) => copy.id !== id);
  edit.added = edit.added.filter((one) => one.id !== id);
}

/** Copies an object and returns the copy's id, one that no object up to `last` has. */
export function copyOf(edit: Edit, id: number, last: number, behind_m: number): number {
  const change = structuredClone(changeOf(edit, id));
  const [forward, left, up] = change.shift_m ?? [0, 0, 0];
  const copy = {
    ...change, remove: false, shift_m: [forward - behind_m, left, up] as Three,
    id: 1 + Math.max(last, ...edit.copies.map((one) => one.id), ...edit.added.map((one) => one.id)),
  };
  if (edit.added.some((one) => one.id === id)) edit.added.push(copy);
  else edit.copies.push({...copy, of: edit.copies.find((one) => one.id === id)?.of ?? id});
  return copy.id;
}

const mostStates = 200;

/** States of an edit, to go back and forth between; the first one is where it began. */
export class History {
  private states: string[];
  private at = 0;

  constructor(first: string) {
    this.states = [first];
  }

  current(): string {
    return this.states[this.at];
  }

  /** Adds a state after the current one and forgets those that were after it. */
  add(state: string): void {
    if (state === this.current()) return;
    this.states.splice(this.at + 1);
    this.states.push(state);
    this.states.splice(0, this.states.length - mostStates);
    this.at = this.states.length - 1;
  }

  /** Whether there is a state so many steps ahead, or, with a negative number, back. */
  has(steps: number): boolean {
    return this.states[this.at + steps] !== undefined;
  }

  go(steps: number): string {
    if (this.has(steps)) this.at += steps;
    return this.current();
  }

  /** Forgets the states after the last one that equals `state`. */
  backTo(state: string): void {
    const at = this.states.lastIndexOf(state, this.at);
    if (at < 0) return this.add(state);
    this.states.splice(at + 1);
    this.at = at;
  }
}
