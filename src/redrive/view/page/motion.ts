// SPDX-License-Identifier: Apache-2.0
// Free flight and orbit: changes of the shift and the angles that `redrive render` takes.
import type {CameraInfo} from "./protocol";
import {setMove, type State} from "./state";

type Vector = [number, number, number];
type Matrix = [Vector, Vector, Vector]; // rows

const radians = Math.PI / 180;

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
