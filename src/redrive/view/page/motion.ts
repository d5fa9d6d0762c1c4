// SPDX-License-Identifier: Apache-2.0
// Free flight and orbit: changes of the shift and the angles that `redrive render` takes.
import {extentOf} from "./map";
import type {CameraInfo, Hello} from "./protocol";
import {setMove, type State} from "./state";

type Vector = [number, number, number];
type Matrix = [Vector, Vector, Vector]; // rows

const radians = Math.PI / 180;

/** What is moved by as a metre: a metre, or of photographs a part of how far they lie apart. */
export function lengthUnit(hello: Hello): number {
  if (hello.metric) return 1;
  return Number((extentOf(hello.map) / 10).toPrecision(1));
}

function multiply(a: Matrix, b: Matrix): Matrix {
  const row = (i: number): Vector => [0, 1, 2].map((k) => dot(a[i], column(b, k))) as Vector;
  return [row(0), row(1), row(2)];
}
function column(m: Matrix, k: number): Vector {
  return [m[0][k], m[1][k], m[2][k]];
}
function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
function apply(m: Matrix, v: Vector): Vector {
  return [dot(m[0], v), dot(m[1], v), dot(m[2], v)];
}
function transpose(m: Matrix): Matrix {
  return [column(m, 0), column(m, 1), column(m, 2)];
}

/** body_from_camera of a turned camera: yaw about z of the body, then pitch about x of the
 * camera. */
function rotation(camera: CameraInfo, yaw_deg: number, pitch_deg: number): Matrix {
  const m = camera.body_from_sensor;
  const mounted: Matrix = [
    [m[0], m[1], m[2]],
    [m[4], m[5], m[6]],
    [m[8], m[9], m[10]],
  ];
  const [cy, sy] = [Math.cos(yaw_deg * radians), Math.sin(yaw_deg * radians)];
  const [cp, sp] = [Math.cos(pitch_deg * radians), Math.sin(pitch_deg * radians)];
  const yaw: Matrix = [[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]];
  const pitch: Matrix = [[1, 0, 0], [0, cp, -sp], [0, sp, cp]];
  return multiply(yaw, multiply(mounted, pitch));
}

function position(camera: CameraInfo, state: State): Vector {
  const m = camera.body_from_sensor;
  return [m[3] + state.forward, m[7] + state.left, m[11] + state.up];
}

/** body_from_sensor of the state, 3 x 4 row by row. */
export function poseOf(camera: CameraInfo, state: State): number[] {
  const at = position(camera, state);
  return rotation(camera, state.yaw, state.pitch).flatMap((row, k) => [...row, at[k]]);
}

function setPosition(camera: CameraInfo, state: State, at: Vector): void {
  const m = camera.body_from_sensor;
  setMove(state, "forward", at[0] - m[3]);
  setMove(state, "left", at[1] - m[7]);
  setMove(state, "up", at[2] - m[11]);
}

/** Moves by metres along the camera's right and viewing direction, and up along the body's z. */
export function fly(
  camera: CameraInfo, state: State, right: number, ahead: number, up: number,
): void {
  const axes = rotation(camera, state.yaw, state.pitch);
  const at = position(camera, state);
  for (let k = 0; k < 3; ++k) at[k] += right * axes[k][0] + ahead * axes[k][2];
  at[2] += up;
  setPosition(camera, state, at);
}

/** Turns the camera; with a point of the body about it, so that the point stays in the image. */
export function turn(
  camera: CameraInfo, state: State, yaw_deg: number, pitch_deg: number, about?: number[],
): void {
  const before = rotation(camera, state.yaw, state.pitch);
  const at = position(camera, state);
  setMove(state, "yaw", state.yaw + yaw_deg);
  setMove(state, "pitch", state.pitch + pitch_deg);
  if (!about) return;
  const after = rotation(camera, state.yaw, state.pitch);
  const inCamera = apply(
    transpose(before), [about[0] - at[0], about[1] - at[1], about[2] - at[2]]);
  const turned = apply(after, inCamera);
  setPosition(camera, state, [about[0] - turned[0], about[1] - turned[1], about[2] - turned[2]]);
}

/** What an orbit is about. */
export interface Orbit {
  point: number[]; // in the body
  least: number; // height of the camera in the body, above the ground
  unit: number; // lengthUnit
}

// In units of lengths:
// radius of an orbit, at most: what lies further away is circled at this distance
const reach = 15;
const clearance = 0.3;  // height of the camera above the point, at least
const [nearest, farthest] = [1, 60]; // from the point

function distance(a: number[], b: number[]): number {
  return Math.hypot(...a.map((x, k) => x - b[k]));
}

/** Begins an orbit about a surface in the middle of the image, or about a place before it where
 * that is far away, or nothing. */
export function orbitAbout(
  camera: CameraInfo, state: State, surface: number[] | null, hello: Hello,
): Orbit {
  const unit = lengthUnit(hello);
  const at = position(camera, state);
  const ahead = column(rotation(camera, state.yaw, state.pitch), 2);
  const away = surface ? Math.min(reach * unit, distance(surface, at)) : reach * unit;
  const point = at.map((x, k) => x + away * ahead[k]);
  // The camera is above the ground now, and so is every surface.
  const least = Math.min(at[2], point[2] + clearance);
  return {point, unit, least: hello.metric ? least : -Infinity}; // photographs have no up
}

/** Turns about an orbit's point, and stays above the ground. */
export function turnAbout(
  camera: CameraInfo, state: State, yaw_deg: number, pitch_deg: number, orbit: Orbit,
): void {
  const before = {...state};
  turn(camera, state, yaw_deg, pitch_deg, orbit.point);
  if (position(camera, state)[2] >= orbit.least) return;
  Object.assign(state, before);
  turn(camera, state, yaw_deg, 0, orbit.point);
}

/** Moves ahead as far as the camera stays near an orbit's point. */
export function approach(camera: CameraInfo, state: State, ahead: number, orbit: Orbit): void {
  const away = distance(orbit.point, position(camera, state));
  const kept = Math.min(farthest * orbit.unit, Math.max(nearest * orbit.unit, away - ahead));
  const before = {...state};
  fly(camera, state, 0, away - kept, 0);
  if (position(camera, state)[2] < orbit.least) Object.assign(state, before);
}
