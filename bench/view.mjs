// SPDX-License-Identifier: Apache-2.0
// Times `redrive view` over loopback, without a browser:
//   node bench/view.mjs REDRIVE RUN NODE_MODULES [CAMERA]
// NODE_MODULES is src/redrive/view/page/node_modules in the build folder. Prints JSON.
//   start_ms: from the start of the program to the first image
//   answer_ms: from a camera message to its image, of a camera that moves when the image has come:
//     median and 95th percentile, at the size that the viewer chose
//   images_per_s: of a camera that moves all the time, 60 messages a second
//   full_ms: rendering an image at full size, median
import {spawn} from "node:child_process";
import {createRequire} from "node:module";
import path from "node:path";

const [redrive, run, modules, wanted] = process.argv.slice(2);
const {WebSocket} = createRequire(path.resolve(modules, "x.js"))("ws");
const seconds = 5;

const start = performance.now();
const program = spawn(redrive, ["view", run, "--port", "0"], {stdio: ["ignore", "pipe", "inherit"]});
let printed = "";
const address = await new Promise((resolve) => {
  program.stdout.on("data", (bytes) => {
    printed += bytes;
    const found = /http:\/\/\S+/.exec(printed);
    if (found) resolve(new URL(found[0]));
  });
});
const socket = new WebSocket(`ws://${address.host}${address.pathname}socket`,
  {origin: address.origin});

let hello = null;
let id = 0;
let onImage = () => {};
const median = (values, share = 0.5) =>
  [...values].sort((a, b) => a - b)[Math.floor(share * (values.length - 1))];

/** Asks for the camera, up to 0.5 m to the left of the car. */
function ask() {
  const camera = hello.cameras.find(({name}) => name === wanted) ?? hello.cameras[0];
  const frame = hello.frames[Math.floor(hello.frames.length / 2)];
  socket.send(JSON.stringify({
    type: "view", id: ++id, camera: camera.name, frame: frame.id,
    shift_m: [0, 0.25 + 0.25 * Math.sin(0.1 * id), 0], yaw_deg: 0, pitch_deg: 0, layer: "image",
    exposure: "own", overlays: [], reference: false, novel: null}));
}

/** Calls `each` with the header of every image for some seconds. */
async function collect(each) {
  const headers = [];
  onImage = (header) => {
    headers.push(header);
    each(header);
  };
  await new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
  onImage = () => {};
  await new Promise((resolve) => setTimeout(resolve, 500)); // the camera rests
  return headers;
}

socket.on("message", (data, isBinary) => {
  if (!isBinary) {
    const message = JSON.parse(data);
    if (message.kind === "hello") {
      hello = message;
      ask();
    }
    return;
  }
  const header = JSON.parse(data.subarray(4, 4 + data.readUInt32LE(0)));
  socket.send(JSON.stringify({type: "shown", sequence: header.sequence}));
  onImage(header);
});

const first = await new Promise((resolve) => (onImage = resolve));
const start_ms = performance.now() - start;
await new Promise((resolve) => setTimeout(resolve, 2000)); // full size has come and was measured

let asked = performance.now();
const answers = [];
const again = () => {
  asked = performance.now();
  ask();
};
again();
const answered = await collect((header) => {
  if (header.id !== id) return;
  answers.push(performance.now() - asked);
  again();
});
const timer = setInterval(ask, 1000 / 60);
const moving = await collect(() => {});
clearInterval(timer);
const full = answered.concat(moving).filter(({factor}) => factor === 1);
const size = ({width, height}) => `${width} x ${height}`;
console.log(JSON.stringify({
  run, camera: first.camera, full_size: `${first.full_width} x ${first.full_height}`,
  start_ms: Math.round(start_ms), first_size: size(first), first_ms: first.total_ms,
  answer_ms: {median: +median(answers).toFixed(1), p95: +median(answers, 0.95).toFixed(1)},
  answer_size: size(answered.at(-1)),
  images_per_s: +(moving.length / (seconds + 0.5)).toFixed(1), moving_size: size(moving.at(-1)),
  full_ms: full.length > 0 ? median(full.map(({render_ms}) => render_ms)) : null}, null, 2));
socket.terminate();
program.kill("SIGINT");
