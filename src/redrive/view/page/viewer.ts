// SPDX-License-Identifier: Apache-2.0
// The page of `redrive view`: requests the image of its state, draws the answers, and turns pointer
// and keys into changes of the state.
import {captionOf} from "./caption";
import {Controls, element, isNarrow} from "./controls";
import {showLegend} from "./legend";
import {DriveMap} from "./map";
import {
  approach, fly, lengthUnit, orbitAbout, turn, turnAbout, type Orbit,
} from "./motion";
import {cameraOf} from "./mount";
import {placeCard} from "./object_card";
import {toggleFullScreen} from "./panels";
import {PathPart} from "./path";
import {
  Connection, decode, type Hello, type ImageHeader, type Picked, type Picture,
  type ReferenceHeader, type Text,
} from "./protocol";
import {listenToPointer} from "./pointer";
import {Stage} from "./stage";
import {fromHash, referenceKey, toHash, toRequest, type State} from "./state";
import {TrafficPart} from "./traffic";
import {TrainingPanel, WaitNote} from "./training";

const speed = 3; // metres a second; shift: four times
const turnSpeed = 45; // degrees a second

/** Whether the state of a page still fits. */
function sameRun(a: Hello, b: Hello): boolean {
  const what = ({run, method, cameras, frames, held_out, novel, objects}: Hello) => JSON.stringify(
    [run, method, cameras.map(({name}) => name), frames, held_out, novel,
      objects.map(({id}) => id)]);
  return what(a) === what(b);
}

class Viewer {
  private readonly connection = new Connection();
  readonly stage = new Stage(element<HTMLCanvasElement>("canvas"), () => this.room());
  private hello!: Hello;
  state!: State;
  private controls!: Controls;
  private readonly wait = new WaitNote(element("wait"));
  private readonly training = new TrainingPanel(
    element("training"), (message) => this.connection.send(message));
  private path!: PathPart;
  private traffic!: TrafficPart;
  private map!: DriveMap;
  private id = 0;  // id of the last request
  private asks = false;  // the state has changed since its image was requested
  private playing = false;
  private playedUntil = 0;
  private readonly held = new Set<string>(); // keys of flight
  private last = 0; // time of the last tick
  private orbiting = false;
  private orbit: Orbit | null = null;  // orbit of `orbiting`; null until the surface is known
  private picked: Picked | null = null;
  private pickMark: {u: number; v: number} | null = null;
  private selects = false; // the point that was asked for selects an object
  private score: number | null = null; // PSNR of the image that is shown
  private seen: number | null = null; // the share of its pixels that training images saw
  private noReference = "";
  private problem = "";  // problem of the run
  private noticed = "";
  private references = new Map<string, Picture<ReferenceHeader>>(); // the last one, by its key
  private asked = ""; // the last request, without its number
  private address = "";  // address of the state that was asked for
  private askedView = ""; // the same without the selected object
  private shownAt: number[] = []; // times of the last images

  start(): void {
    this.connection.onText = (message) => this.receive(message);
    this.connection.onPicture = (bytes) => void this.show(bytes);
    this.connection.onState = (connected) => {
      this.wait.connected = connected;
      this.notice(connected ? "" : "No connection to redrive view; trying again.");
      this.asked = "";
    };
    this.connection.connect();
    const resized = new ResizeObserver(() => this.draw());
    for (const id of ["left", "view", "below"]) resized.observe(element(id));
    addEventListener("resize", () => this.draw());
    requestAnimationFrame((now) => this.tick(now));
  }

  private receive(message: Text): void {
    if (message.kind === "preparing") {
      this.wait.preparing = message;
      return;
    }
    if (message.kind === "hello") this.begin(message);
    if (message.kind === "paths") this.path.receive(message);
    if (message.kind === "edited" || message.kind === "dragged") this.traffic.receive(message);
    if (message.kind === "picked") this.showPicked(message);
    if (message.kind === "seen_by") this.controls.showSeen(message);
    if (message.kind === "score" && message.id === this.id) {
      this.score = message.psnr_db;
      this.seen = message.seen;
    }
    if (message.kind === "no_reference") {
      this.noReference = message.text;
      this.stage.reference = null;
    }
    if (message.kind === "training") {
      this.training.showTraining(message);
      this.wait.training = message;
      this.hello.step = message.step;
      this.controls.showStep();
    }
    if (message.kind === "curve") this.training.showCurve(message);
    if (message.kind === "problem") {
      this.problem = message.text;
      this.notice(this.noticed);
    }
    if (message.kind === "error" && message.id === this.id) this.notice(message.text);
    this.caption();
    this.draw();
  }

  private begin(hello: Hello): void {
    if (!this.hello) {
      this.hello = hello;
      this.state = fromHash(location.hash, hello);
      this.controls = new Controls(hello, this.state, () => this.changed());
      this.map = new DriveMap(element("map"), hello, (frame) => {
        this.controls.selectFrame(frame);
        this.changed();
      });
      this.path = new PathPart(hello, this.state,
        (answer) => this.connection.send(answer), () => this.changed());
      this.traffic = new TrafficPart(hello, this.state,
        (answer) => this.connection.send(answer), () => this.changed(), () => {
          this.asked = "";
          this.changed();
        });
      this.listen();
      document.body.classList.remove("empty");
      document.title = `${hello.run} · redrive view`;
    } else if (!sameRun(this.hello, hello)) {
      return location.reload();
    } else {
      const isNewer = this.hello.step !== hello.step;
      Object.assign(this.hello, hello); // refined extrinsics, too
      if (isNewer) this.controls.showStep(new Date());
    }
    this.asked = "";
    this.traffic.connected();
    this.changed();
  }

  /** Asks for the state's image at the next tick. */
  changed(): void {
    this.asks = true;
    this.controls.update();
    this.path.showCommand();
  }

  private ask(): void {
    this.asks = false;
    // Browsers ignore more than some 200 of these in 10 s: a preview has one address.
    const address = `#${toHash(this.state, this.hello)}`;
    if (address !== this.address) history.replaceState(null, "", address);
    this.address = address;
    const wanted = {...toRequest(this.state, 0), ...this.path.request()};
    const request = JSON.stringify(wanted);
    // only the share of a wipe has changed, for example
    if (request === this.asked) return this.draw();
    this.asked = request;
    this.score = this.seen = null;
    const view = JSON.stringify({...wanted, object: null});
    if (view !== this.askedView) {
      this.stage.marks = [];
      this.pickMark = null;
    }
    this.askedView = view;
    if (this.stage.reference?.header.key !== referenceKey(this.state)) this.noReference = "";
    this.connection.send({...wanted, id: ++this.id});
    this.caption();
    this.draw();
  }

  private async show(bytes: ArrayBuffer): Promise<void> {
    const picture = await decode(bytes);
    const {header} = picture;
    if (header.kind === "reference") {
      this.references.clear();
      this.references.set(header.key, picture as Picture<ReferenceHeader>);
    } else {
      this.connection.send({type: "shown", sequence: header.sequence});
      const before = this.stage.image?.header;
      // Bitmaps may be ready in another order than their images.
      if (before && (before.id > header.id ||
        (before.id === header.id && before.sequence > header.sequence))) return;
      this.stage.image = picture as Picture<ImageHeader>;
      this.notice("");
      this.shownAt = [...this.shownAt.filter((t) => t > performance.now() - 1000),
        performance.now()];
    }
    this.draw();
    this.caption();
  }

  private draw(): void {
    if (!this.hello) return;
    this.stage.reference = this.references.get(referenceKey(this.state)) ?? null;
    showLegend(element("legend"), this.hello, this.state);
    this.stage.handleAt = this.traffic.handleAt();
    this.stage.draw(this.state);
    placeCard(this.stage, this.traffic.drags());
    const header = this.stage.image?.header;
    this.map.show(this.state.frame, header?.at ?? null);
    this.wait.show(this.stage.image !== null);
    if (header)
      element("timing").textContent =
        `${header.width} x ${header.height} · ${header.render_ms.toFixed(0)} ms` +
        (this.shownAt.length > 2 ? ` · ${this.shownAt.length} /s` : "");
  }

  private caption(): void {
    if (!this.hello) return;
    const image = this.stage.image;
    element("caption").textContent = captionOf(this.hello, this.state, {
      header: image?.header ?? null, isOfState: image?.header.id === this.id, psnr_db: this.score,
      seen: this.seen, noReference: this.noReference, maskedShare: this.stage.maskedShare,
    });
  }

  /** The largest size of the canvas at which all that belongs to the image stays in sight. */
  private room(): {width: number; height: number} {
    const below = element("below").offsetHeight;
    const all = isNarrow() ? 0.6 * innerHeight : element("left").clientHeight;
    return {width: element("view").clientWidth, height: Math.max(80, all - below)};
  }

  private notice(text: string): void {
    this.noticed = text;
    const place = element("notice");
    place.textContent = [this.problem, text].filter((part) => part !== "").join(" · ");
    place.hidden = place.textContent === "";
  }

  // ---- Points

  /** `selects`: also selects the moving object there. */
  pick(mark: {u: number; v: number}, selects = false): void {
    this.pickMark = mark;
    this.selects = selects;
    this.connection.send({type: "pick", id: this.id, at: [mark.u, mark.v]});
  }

  private showPicked(picked: Picked): void {
    if (this.selects) this.traffic.select(picked.object ?? null);
    this.selects = false;
    this.controls.showPoint(picked, this.picked);
    if (picked.surface) this.picked = picked;
    if (picked.id === this.id && this.pickMark)
      this.stage.marks = [...this.stage.marks.slice(-1), this.pickMark];
    if (this.orbiting && !this.orbit)
      this.orbit = orbitAbout(this.camera(), this.state, picked.body_m ?? null, this.hello);
  }

  // ---- Time

  private tick(now: number): void {
    const seconds = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    this.wait.show(this.stage.image !== null);
    if (this.hello) {
      if (this.playing) this.advance(now);
      if (this.held.size > 0) this.flyOn(seconds);
      this.path.tick();
      if (this.asks) this.ask();
    }
    requestAnimationFrame((next) => this.tick(next));
  }

  play(on: boolean): void {
    this.playing = on;
    this.playedUntil = performance.now();
    const button = element("play");
    button.textContent = on ? "❚❚" : "▶";
    button.ariaLabel = on ? "Pause" : "Play";
  }

  /** Goes to the frame whose time has come; after the last one the first follows. */
  private advance(now: number): void {
    const {frames} = this.hello;
    let index = frames.findIndex(({id}) => id === this.state.frame);
    const before = index;
    for (let steps = 0; steps < frames.length; ++steps) {
      const next = (index + 1) % frames.length;
      const wait = next === 0 ? 0.5 : Math.max(0.01, frames[next].t_s - frames[index].t_s);
      if (this.playedUntil + 1000 * wait > now) break;
      this.playedUntil += 1000 * wait;
      index = next;
    }
    if (index === before) return;
    this.controls.selectFrame(frames[index].id);
    this.changed();
  }

  private stepFrame(by: number): void {
    const {frames} = this.hello;
    const index = frames.findIndex(({id}) => id === this.state.frame) + by;
    this.controls.selectFrame(frames[Math.min(frames.length - 1, Math.max(0, index))].id);
    this.changed();
  }

  // ---- Flight

  private camera() {
    return cameraOf(this.state, this.hello);
  }

  private flyOn(seconds: number): void {
    const has = (key: string) => Number(this.held.has(key));
    const way = seconds * speed * this.unit * (this.held.has("shift") ? 4 : 1);
    const right = way * (has("d") - has("a"));
    const ahead = way * (has("w") - has("s"));
    const up = way * (has("r") - has("f"));
    const yaw = seconds * turnSpeed * (has("j") - has("l"));
    const pitch = seconds * turnSpeed * (has("i") - has("k"));
    if (!right && !ahead && !up && !yaw && !pitch) return;
    if (right || up) this.leaveOrbit();
    fly(this.camera(), this.state, right, 0, up);
    this.moveAhead(ahead);
    this.turn(yaw, pitch);
  }

  /** Turns the camera, in orbit about its point. */
  turn(yaw_deg: number, pitch_deg: number): void {
    this.controls.leaveTruth();
    if (this.orbit) turnAbout(this.camera(), this.state, yaw_deg, pitch_deg, this.orbit);
    else turn(this.camera(), this.state, yaw_deg, pitch_deg);
    this.changed();
  }

  /** Moves the camera ahead by metres, or by units of photographs. */
  moveAhead(ahead: number): void {
    this.controls.leaveTruth();
    if (this.orbit) approach(this.camera(), this.state, ahead, this.orbit);
    else fly(this.camera(), this.state, 0, ahead, 0);
    this.changed();
  }

  private setOrbiting(on: boolean): void {
    if (!this.hello.method) return;
    this.orbiting = on;
    this.orbit = null;
    element("orbit").setAttribute("aria-pressed", String(on));
    if (on) this.pick({u: 0.5, v: 0.5});
  }

  private leaveOrbit(): void {
    if (this.orbiting) this.setOrbiting(false);
  }

  get turnsAbout(): boolean {
    return this.orbit !== null;
  }

  get unit(): number {
    return lengthUnit(this.hello);
  }

  private home(): void {
    this.controls.home();
    this.leaveOrbit();
    this.changed();
  }

  // ---- Pointer and keys

  private listen(): void {
    element("play").addEventListener("click", () => this.play(!this.playing));
    element("previous").addEventListener("click", () => this.stepFrame(-1));
    element("next").addEventListener("click", () => this.stepFrame(1));
    element("home").addEventListener("click", () => this.home());
    element("orbit").addEventListener("click", () => this.setOrbiting(!this.orbiting));
    listenToPointer(element("stage"), this, this.traffic);
    addEventListener("keydown", (event) => this.keyDown(event));
    addEventListener("keyup", (event) => this.held.delete(event.key.toLowerCase()));
    addEventListener("blur", () => this.held.clear());
    addEventListener("hashchange", () => {
      const {overlays, object: _, edit: __, ...rest} = fromHash(location.hash, this.hello);
      Object.assign(this.state, rest, {overlays: this.state.overlays});
      this.state.overlays.clear();
      overlays.forEach((name) => this.state.overlays.add(name));
      this.address = location.hash;
      this.changed();
    });
  }

  private keyDown(event: KeyboardEvent): void {
    if (event.altKey) return;
    const target = event.target as HTMLElement;
    const key = event.key.toLowerCase();
    // Fields keep their keys, sliders the keys that move them, buttons and boxes space and enter.
    const type = target instanceof HTMLInputElement ? target.type : "";
    const isField = type !== "" && type !== "range" && type !== "checkbox";
    if (isField) return;
    if (event.ctrlKey || event.metaKey) {
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      this.traffic.step(key === "y" || event.shiftKey ? 1 : -1);
      return;
    }
    if (target instanceof HTMLSelectElement && (target.size < 2 || key !== "delete")) return;
    if (type === "range" && /^(arrow|home|end|page)/.test(key)) return;
    const isButton = target instanceof HTMLButtonElement || target.tagName === "SUMMARY" ||
      type === "checkbox";
    if (isButton && (key === " " || key === "enter")) return;
    if ("wasdrfijkl".includes(key) && key.length === 1) {
      this.held.add(key);
      if (event.shiftKey) this.held.add("shift");
      else this.held.delete("shift");
      return;
    }
    const actions: Record<string, () => void> = {
      " ": () => this.play(!this.playing),
      arrowleft: () => this.stepFrame(-1),
      arrowright: () => this.stepFrame(1),
      home: () => this.stepFrame(-1e9),
      end: () => this.stepFrame(1e9),
      b: () => this.home(),
      m: () => (this.controls.takeMount(), this.changed()),
      g: () => toggleFullScreen(),
      o: () => this.setOrbiting(!this.orbiting),
      p: () => this.pick({u: 0.5, v: 0.5}, true),
      q: () => this.traffic.turnBy(event.shiftKey ? 1 : 5),
      e: () => this.traffic.turnBy(event.shiftKey ? -1 : -5),
      delete: () => this.traffic.toggle(),
      escape: () => this.traffic.select(null),
      c: () => (this.controls.nextCompare(), this.changed()),
      v: () => (this.controls.nextLayer(), this.changed()),
      ",": () => this.shareBy(-0.05),
      ".": () => this.shareBy(0.05),
      "?": () => {
        const help = element<HTMLDetailsElement>("help");
        help.open = !help.open;
        help.scrollIntoView({block: "nearest"});
      },
    };
    const number = Number(event.key);
    const camera = number >= 1 ? this.hello.cameras[number - 1] : undefined;
    const action = camera
      ? () => (this.controls.selectCamera(camera.name), this.changed()) : actions[key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  private shareBy(by: number): void {
    this.state.share = Math.round(100 * Math.min(1, Math.max(0, this.state.share + by))) / 100;
    this.changed();
  }
}

const viewer = new Viewer();
viewer.start();
Object.assign(window, {redriveView: viewer}); // for tests and the console
