// SPDX-License-Identifier: Apache-2.0
// The page of `redrive export --to html`: Gaussians drawn by the browser's GPU. It loads nothing.
import {SparkRenderer, SplatFileType, SplatMesh} from "@sparkjsdev/spark";
import {
  Color, Matrix4, PerspectiveCamera, Quaternion, Scene, SRGBColorSpace, Vector3, WebGLRenderer,
} from "three";

/** As ../scene_page.cc writes it. */
interface SceneData {
  fov: number; // vertical, degrees
  screen_variance: number; // pixels^2, that training adds
  background: [number, number, number]; // behind the Gaussians, r g b as displayed
  up: [number, number, number]; // in the world, of length 1
  drive: {t_s: number; camera_to_world: number[]}[]; // row by row, OpenGL camera axes
}

const speed = 3; // metres a second; shift: four times
const radiansPerPixel = 0.003;
const metresPerPixel = 0.02; // for two fingers
const steepest = 0.49 * Math.PI;

function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no element ${id}`);
  return found as T;
}

function decode64(text: string): Uint8Array {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

class ScenePage {
  private readonly data = JSON.parse(element("scene").textContent ?? "") as SceneData;
  private readonly canvas = element<HTMLCanvasElement>("canvas");
  private readonly slider = element<HTMLInputElement>("time");
  // Depth and antialiasing do not help Gaussians, which are sorted and blended.
  private readonly renderer = new WebGLRenderer({canvas: this.canvas, antialias: false});
  private readonly scene = new Scene();
  private readonly up = new Vector3(...this.data.up);
  readonly camera: PerspectiveCamera;
  private readonly held = new Set<string>();
  private readonly pointers = new Map<number, {x: number; y: number}>();
  private readonly poses = this.data.drive.map(({camera_to_world}) => {
    const position = new Vector3();
    const rotation = new Quaternion();
    new Matrix4().fromArray(camera_to_world).transpose()
      .decompose(position, rotation, new Vector3());
    return {position, rotation};
  });
  private playing = false;
  private last = 0;
  private loaded = false; // the Gaussians are read
  ready = false; // and drawn

  constructor() {
    this.camera = new PerspectiveCamera(this.data.fov, 1, 0.1, 10000);
    // As the program draws them (field/gaussian.h): a filter that keeps the sum over the pixels,
    // Gaussians down to an alpha of 1/255 however large.
    this.scene.add(new SparkRenderer({
      renderer: this.renderer,
      preBlurAmount: 0,
      blurAmount: this.data.screen_variance,
      maxStdDev: Math.sqrt(2 * Math.log(255)),
      minAlpha: 1 / 255,
      maxPixelRadius: 8192,
      accumExtSplats: true,
    }));
    this.renderer.setClearColor(new Color().setRGB(...this.data.background, SRGBColorSpace), 1);
    this.slider.max = String(this.data.drive[this.data.drive.length - 1].t_s);
    this.seek(0);
    this.listen();
    const splats = element("splats");
    const mesh = new SplatMesh({
      fileBytes: decode64(splats.textContent ?? ""),
      fileType: SplatFileType.SPZ,
      extSplats: true, // positions of 32 bits
    });
    splats.remove();
    this.scene.add(mesh);
    mesh.initialized.then(
      () => (this.loaded = true),
      (error: unknown) => (element("notice").textContent = `The scene cannot be read: ${error}`));
    this.renderer.setAnimationLoop((now) => this.frame(now));
  }

  /** Moves the camera to its pose at a time of the drive. */
  seek(t_s: number): void {
    const {drive} = this.data;
    this.slider.value = String(t_s);
    const next = drive.findIndex((key) => key.t_s > t_s);
    const b = next < 0 ? drive.length - 1 : Math.max(next, Math.min(1, drive.length - 1));
    const a = Math.max(0, b - 1);
    const way = drive[b].t_s - drive[a].t_s;
    const share = way > 0 ? Math.min(1, Math.max(0, (t_s - drive[a].t_s) / way)) : 0;
    this.camera.position.lerpVectors(this.poses[a].position, this.poses[b].position, share);
    this.camera.quaternion.slerpQuaternions(this.poses[a].rotation, this.poses[b].rotation, share);
  }

  private frame(now: number): void {
    const seconds = Math.min(0.1, (now - this.last) / 1000);
    this.last = now;
    if (this.playing) {
      const end = Number(this.slider.max);
      const t_s = Number(this.slider.value) + seconds;
      this.seek(Math.min(t_s, end));
      if (t_s >= end) this.play(false);
    }
    this.fly(seconds);
    const {clientWidth: width, clientHeight: height} = this.canvas;
    const ratio = devicePixelRatio;
    if (this.canvas.width !== Math.round(width * ratio) ||
      this.canvas.height !== Math.round(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.renderer.render(this.scene, this.camera);
    if (this.loaded && !this.ready && this.drawsSomething()) {
      element("notice").hidden = true;
      this.ready = true;
    }
  }

  /** Whether some pixel is not that of the background: Gaussians come once they are sorted. */
  private drawsSomething(): boolean {
    const gl = this.renderer.getContext();
    const pixels = new Uint32Array(gl.drawingBufferWidth * gl.drawingBufferHeight);
    gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE,
      new Uint8Array(pixels.buffer));
    return pixels.some((pixel) => pixel !== pixels[0]);
  }

  private play(on: boolean): void {
    if (on && Number(this.slider.value) >= Number(this.slider.max)) this.slider.value = "0";
    this.playing = on;
    element("play").textContent = on ? "❚❚" : "▶";
  }

  private fly(seconds: number): void {
    const has = (key: string) => Number(this.held.has(key));
    const way = seconds * speed * (this.held.has("shift") ? 4 : 1);
    const move = new Vector3(has("d") - has("a"), 0, has("s") - has("w")).multiplyScalar(way);
    if (move.lengthSq() === 0 && has("r") === has("f")) return;
    this.play(false);
    this.camera.position.add(move.applyQuaternion(this.camera.quaternion));
    this.camera.position.addScaledVector(this.up, way * (has("r") - has("f")));
  }

  /** Turns about the world's direction up, then up. */
  private turn(left: number, up: number): void {
    this.play(false);
    const forward = new Vector3(0, 0, -1).applyQuaternion(this.camera.quaternion);
    const pitch = Math.asin(Math.max(-1, Math.min(1, forward.dot(this.up))));
    up = Math.max(-steepest, Math.min(steepest, pitch + up)) - pitch;
    this.camera.quaternion.premultiply(new Quaternion().setFromAxisAngle(this.up, left));
    this.camera.quaternion.multiply(new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), up));
  }

  /** One pointer turns the camera; two move it aside and up, and ahead as they part. */
  private drag(event: PointerEvent): void {
    const from = this.pointers.get(event.pointerId);
    if (!from) return;
    const to = {x: event.clientX, y: event.clientY};
    const [right, down] = [to.x - from.x, to.y - from.y];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (at: {x: number; y: number}) => Math.hypot(at.x - other.x, at.y - other.y);
      const move = new Vector3(-right / 2, down / 2, apart(from) - apart(to));
      this.play(false);
      this.camera.position.add(
        move.multiplyScalar(metresPerPixel).applyQuaternion(this.camera.quaternion));
    } else {
      this.turn(radiansPerPixel * right, radiansPerPixel * down);
    }
    this.pointers.set(event.pointerId, to);
  }

  private listen(): void {
    element("play").addEventListener("click", () => this.play(!this.playing));
    this.slider.addEventListener("input", () => {
      this.play(false);
      this.seek(Number(this.slider.value));
    });
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    });
    this.canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"] as const)
      this.canvas.addEventListener(end, (event) => this.pointers.delete(event.pointerId));
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.play(false);
      this.camera.translateZ(0.005 * event.deltaY);
    }, {passive: false});
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const key = event.key.toLowerCase();
      if (key === " ") {
        if (event.target === element("play")) return;
        event.preventDefault();
        this.play(!this.playing);
      } else if (key === "h") {
        element("bar").classList.toggle("hidden");
      } else {
        this.held.add(key);
      }
    });
    addEventListener("keyup", (event) => this.held.delete(event.key.toLowerCase()));
    addEventListener("blur", () => this.held.clear());
  }
}

try {
  Object.assign(window, {redriveScene: new ScenePage()}); // for tests and the console
} catch (error) {
  element("notice").textContent = `This browser cannot draw the scene: ${error}`;
}
