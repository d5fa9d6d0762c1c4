// SPDX-License-Identifier: Apache-2.0
// The panel: shows the state and changes it.
import {lengthUnit, poseOf} from "./motion";
import {cameraOf, mountAt, MountPanel, usualLens} from "./mount";
import {rememberClosedParts, saveImage, toggleFullScreen} from "./panels";
import type {Hello, Picked, SeenBy} from "./protocol";
import {
  compares, isDriven, layers, moves, overlays, setMove, setScan, toCommand, type Compare,
  type Layer, type Move, type ScanColour, type State,
} from "./state";

export function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no element ${id}`);
  return found as T;
}

/** Whether the panel stands under the image. */
export function isNarrow(): boolean {
  return matchMedia("(max-width: 800px)").matches && !document.fullscreenElement;
}

const sliders: Record<Move, {label: string; range: number; step: number}> = {
  left: {label: "left", range: 5, step: 0.05},
  forward: {label: "forward", range: 5, step: 0.05},
  up: {label: "up", range: 5, step: 0.05},
  yaw: {label: "yaw, °", range: 180, step: 0.5},
  pitch: {label: "pitch, °", range: 89, step: 0.5},
};

const ownMount = "/mount"; // among the names of the cameras

function option(value: string, text: string): HTMLOptionElement {
  const made = document.createElement("option");
  made.value = value;
  made.textContent = text;
  return made;
}

function addRow(table: HTMLTableElement, name: string, value: string): HTMLTableCellElement {
  const row = table.insertRow();
  const head = document.createElement("th");
  head.scope = "row";
  head.textContent = name;
  row.append(head);
  const cell = row.insertCell();
  cell.textContent = value;
  return cell;
}

export class Controls {
  private readonly mount: MountPanel;
  private readonly ranges = {} as Record<Move, HTMLInputElement>;
  private readonly numbers = {} as Record<Move, HTMLInputElement>;

  /** `changed` is called after the panel has changed the state. */
  constructor(
    private readonly hello: Hello,
    private readonly state: State,
    private readonly changed: () => void,
  ) {
    this.showStep();
    if (!hello.metric) this.speakOfPhotographs();
    if (!hello.method)
      for (const id of ["compare", "layer", "exposure", "orbit", "copy"])
        element<HTMLInputElement>(id).disabled = true;
    element<HTMLSelectElement>("camera").replaceChildren(
      ...hello.cameras.map(({name, model}) => {
        const made = option(name, name);
        made.title = model;
        return made;
      }), ...(hello.method ? [option(ownMount, this.mountName())] : []));
    this.mount = new MountPanel(element("mount-fields"), hello, (mount) => {
      state.mount = mount;
      this.changed();
    });
    element("mount-here").addEventListener("click", () => {
      this.takeMount();
      this.changed();
    });
    this.listTruth();
    this.listSensors();
    this.makeSliders();
    const on = (id: string, event: string, change: (input: HTMLInputElement) => void) =>
      element<HTMLInputElement>(id).addEventListener(event, () => {
        change(element<HTMLInputElement>(id));
        this.changed();
      });
    on("camera", "change", ({value}) => this.selectCamera(value));
    on("truth", "change", ({value}) => this.selectTruth(value));
    on("compare", "change", ({value}) => (state.compare = value as Compare));
    on("share", "input", ({value}) => (state.share = Number(value)));
    on("layer", "change", ({value}) => (state.layer = value as Layer));
    on("scan", "change", ({value}) => setScan(state, value, state.scan?.colour ?? "range"));
    on("scan-colour", "change",
      ({value}) => setScan(state, state.scan?.sensor ?? "", value as ScanColour));
    on("frame", "input", ({value}) => this.selectFrame(hello.frames[Number(value)].id));
    on("exposure", "change", ({value}) =>
      (state.exposure = value === "fixed" ? `${state.camera}:${state.frame}` : value));
    on("exposure-of", "change", ({value}) => {
      if (/^.{1,200}:\d+$/.test(value)) state.exposure = value;
    });
    const frames = element<HTMLInputElement>("frame");
    frames.max = String(hello.frames.length - 1);
    for (const name of overlays) {
      const box = this.overlayBox(name);
      box.addEventListener("change", () => {
        if (box.checked) state.overlays.add(name);
        else state.overlays.delete(name);
        this.changed();
      });
      const missing = ((name === "lidar" || name === "cloud") && !hello.lidar) ||
        (name === "boxes" && !hello.boxes) || (name === "masks" && !hello.method);
      box.disabled = missing;
      if (missing) {
        state.overlays.delete(name);
        box.parentElement?.classList.add("missing");
        if (box.parentElement) box.parentElement.title =
          name === "masks" ? "Masks are those of a run" : "The recording has none";
      }
    }
    element("panel").addEventListener("submit", (event) => event.preventDefault());
    const copy = (id: string, text: () => string) =>
      element(id).addEventListener("click", () => void this.copy(id, text()));
    copy("copy", () => toCommand(state, hello));
    copy("copy-address", () => location.href);
    element("save-image").addEventListener("click", () =>
      saveImage(`${state.camera.replace(/[^\w.-]+/g, "_")}-${state.frame}.png`));
    element("full").addEventListener("click", () => toggleFullScreen());
    rememberClosedParts();
  }

  /** Photographs have no car, and their lengths no unit. */
  private speakOfPhotographs(): void {
    const name = (id: string, text: string) => {
      const summary = element(id).querySelector("summary");
      if (summary) summary.textContent = text;
    };
    name("leave-part", "Leave the photographs");
    name("mount", "Own camera");
    element("mount-here").textContent = "Move the camera to this view";
    element("help-home").textContent = "back to the photograph";
    element("help-mount").textContent = "own camera, where the view is";
    element("frame").ariaLabel = "Photograph";
  }

  private mountName(): string {
    return this.hello.metric ? "own mount" : "own camera";
  }

  /** Shows the run and its step, which was loaded at some time. */
  showStep(loaded?: Date): void {
    const {run, method, step} = this.hello;
    const when = loaded ? `, loaded ${loaded.toLocaleTimeString()}` : "";
    element("run").textContent =
      method ? `${run} · ${method}, step ${step}${when}` : `${run} · recording`;
  }

  selectCamera(name: string): void {
    this.leaveTruth();
    if (name === ownMount) return this.takeMount();
    this.state.mount = null;
    this.state.camera = name;
  }

  /** Puts a camera of one's own where the view is. */
  takeMount(): void {
    if (!this.hello.method) return;
    const {state, hello} = this;
    const pose = poseOf(cameraOf(state, hello), state);
    this.home();
    state.mount = mountAt(pose, state.mount?.lens ?? usualLens);
  }

  selectFrame(id: number): void {
    this.leaveTruth();
    this.state.frame = id;
  }

  /** A move starts from the frame's own pose, so a view with ground truth is left. */
  leaveTruth(): void {
    this.state.novel = null;
  }

  home(): void {
    this.leaveTruth();
    for (const move of moves) this.state[move] = 0;
  }

  nextCompare(): void {
    if (!this.hello.method) return;
    const at = compares.indexOf(this.state.compare);
    this.state.compare = compares[(at + 1) % compares.length];
  }

  nextLayer(): void {
    if (!this.hello.method) return;
    this.state.layer = layers[(layers.indexOf(this.state.layer) + 1) % layers.length];
  }

  /** Shows the state. */
  update(): void {
    const {state, hello} = this;
    const index = hello.frames.findIndex(({id}) => id === state.frame);
    const set = (id: string, value: string) => {
      const input = element<HTMLInputElement | HTMLSelectElement>(id);
      if (input.value !== value) input.value = value;
    };
    set("camera", state.mount ? ownMount : state.camera);
    element("mount").hidden = !state.mount;
    if (state.mount) this.mount.show(state.mount);
    set("frame", String(index));
    element("frame-label").textContent =
      hello.metric ? `${state.frame} · ${hello.frames[index].t_s.toFixed(2)} s`
        : `${index + 1} of ${hello.frames.length}`;
    set("truth", this.truthValue());
    set("compare", state.compare);
    set("share", String(state.share));
    element("share-row").hidden = state.compare !== "wipe" && state.compare !== "blend";
    set("layer", state.layer);
    set("scan", state.scan?.sensor ?? "");
    element("scan-row").hidden = !state.scan;
    if (state.scan) set("scan-colour", state.scan.colour);
    element<HTMLSelectElement>("scan-colour").options[2].disabled =
      state.scan?.sensor !== "recorded";
    const fixed = state.exposure !== "own" && state.exposure !== "none";
    set("exposure", fixed ? "fixed" : state.exposure);
    element("exposure-row").hidden = !fixed;
    if (fixed) set("exposure-of", state.exposure);
    for (const name of overlays) this.overlayBox(name).checked = state.overlays.has(name);
    for (const move of moves) {
      const value = String(state.novel ? 0 : state[move]);
      if (this.ranges[move].value !== value) this.ranges[move].value = value;
      if (document.activeElement !== this.numbers[move]) this.numbers[move].value = value;
    }
    element("command").textContent = hello.method ? toCommand(state, hello) : "";
  }

  /** Shows the surface that was clicked and its distance to the one before. */
  showPoint(picked: Picked, before: Picked | null): void {
    const place = element("point");
    if (!picked.surface || !picked.world_m || !picked.body_m) {
      place.textContent = "No surface there.";
      return;
    }
    const unit = this.hello.metric ? " m" : "";
    const three = (v: number[], digits = 3) => v.map((x) => x.toFixed(digits)).join(", ") + unit;
    const rows: [string, string][] = [
      ["depth", `${picked.depth_m?.toFixed(3)}${unit} along the ray`],
      [this.hello.metric ? "body" : "camera", three(picked.body_m)],
      ["world", three(picked.world_m)],
    ];
    if (picked.ecef_m) rows.push(["ECEF", three(picked.ecef_m)]);
    if (picked.wgs84) {
      const {latitude_deg, longitude_deg, height_m} = picked.wgs84;
      rows.push(["WGS 84",
        `${latitude_deg.toFixed(8)}°, ${longitude_deg.toFixed(8)}°, ${height_m.toFixed(3)} m`]);
    }
    if (before?.world_m) {
      const other = before.world_m;
      const distance = Math.hypot(...picked.world_m.map((x, i) => x - other[i]));
      rows.push(["distance", `${distance.toFixed(3)}${unit} to the point before`]);
    }
    const table = document.createElement("table");
    for (const [name, value] of rows) addRow(table, name, value);
    const seen = addRow(table, "seen by", "…");
    seen.id = "seen";
    place.replaceChildren(table);
  }

  /** Shows which training images saw the point; a click on one goes there. */
  showSeen({text, seen, of, nearest}: SeenBy): void {
    const cell = document.getElementById("seen");
    if (!cell) return;
    cell.textContent = text ?? `${seen} of ${of} training images`;
    if (!nearest?.length) return;
    const list = document.createElement("ul");
    for (const {camera, frame, distance_m} of nearest) {
      const button = document.createElement("button");
      button.type = "button";
      const distance = `${distance_m.toFixed(1)}${this.hello.metric ? " m" : ""}`;
      button.textContent = `${camera} ${frame}, ${distance}`;
      button.title = "Go to this image";
      button.addEventListener("click", () => {
        this.home();
        Object.assign(this.state, {camera, frame, mount: null});
        this.changed();
      });
      const item = document.createElement("li");
      item.append(button);
      list.append(item);
    }
    cell.append(list);
  }

  private overlayBox(name: string): HTMLInputElement {
    const box = document.querySelector<HTMLInputElement>(`#overlays input[value="${name}"]`);
    if (!box) throw new Error(`no overlay ${name}`);
    return box;
  }

  private truthValue(): string {
    const {novel, frame} = this.state;
    if (novel) return `novel/${novel.index}/${novel.set}`;
    const held_out = this.hello.held_out.includes(frame) && isDriven(this.state);
    return held_out ? `held-out/${frame}` : "";
  }

  private listSensors(): void {
    const list = element<HTMLSelectElement>("scan");
    const names: Record<string, string> =
      {recorded: "recorded rays", estimated: "estimated beams"};
    list.replaceChildren(option("", "none"),
      ...this.hello.sensors.map((name) => option(name, names[name] ?? name)));
    list.disabled = this.hello.sensors.length === 0;
    if (list.disabled) list.title = "Needs a run, and a recording with a LiDAR";
  }

  private listTruth(): void {
    const list = element<HTMLSelectElement>("truth");
    list.replaceChildren(option("", "-"));
    const group = (label: string, options: HTMLOptionElement[]) => {
      const made = document.createElement("optgroup");
      made.label = label;
      made.append(...options);
      if (options.length > 0) list.append(made);
    };
    group("held-out frames",
      this.hello.held_out.map((id) => option(`held-out/${id}`, `held out: ${id}`)));
    for (const {set, views} of this.hello.novel)
      group(set, views.map((view, i) => option(`novel/${i}/${set}`, `${set}: ${view.file}`)));
    list.disabled = list.options.length === 1;
  }

  private selectTruth(value: string): void {
    const {state} = this;
    const [kind, number, ...rest] = value.split("/");
    if (kind === "") return this.home();
    state.mount = null;
    if (kind === "held-out") {
      this.home();
      state.frame = Number(number);
    } else {
      const set = this.hello.novel.find((novel) => novel.set === rest.join("/"));
      const view = set?.views[Number(number)];
      if (!set || !view) return;
      this.home();
      state.novel = {set: set.set, index: Number(number)};
      state.camera = view.camera;
      if (this.hello.frames.some(({id}) => id === view.frame)) state.frame = view.frame;
    }
    if (state.compare === "off" && this.hello.method) state.compare = "beside";
  }

  private makeSliders(): void {
    for (const move of moves) {
      const isLength = move !== "yaw" && move !== "pitch";
      const unit = isLength ? lengthUnit(this.hello) : 1;
      const label = sliders[move].label + (isLength && this.hello.metric ? ", m" : "");
      const [range, step] = [sliders[move].range * unit, sliders[move].step * unit];
      const row = document.createElement("label");
      row.append(label);
      const input = (type: string) => {
        const made = document.createElement("input");
        made.type = type;
        made.id = `${move}-${type}`;
        made.step = type === "range" ? String(step) : "any";
        made.ariaLabel = label;
        made.addEventListener("input", () => {
          if (made.value === "") return;
          this.leaveTruth();
          setMove(this.state, move, Number(made.value));
          this.changed();
        });
        row.append(made);
        return made;
      };
      const slider = (this.ranges[move] = input("range"));
      slider.min = String(-range);
      slider.max = String(range);
      this.numbers[move] = input("number");
      element("sliders").append(row);
    }
  }

  private async copy(id: string, text: string): Promise<void> {
    const button = element(id);
    const label = button.textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Not allowed; select it below";
    }
    setTimeout(() => (button.textContent = label), 1500);
  }
}
