// SPDX-License-Identifier: Apache-2.0
// Times `redrive view` over loopback, without a browser:
//   node bench/view.mjs REDRIVE RUN NODE_MODULES [CAMERA] [--clients N] [--seconds S]
//       [--drive SPEED]
// NODE_MODULES is src/redrive/view/page/node_modules in the build folder. Prints JSON.
//   page_gz_bytes: the page with all its files, compressed
//   start_ms: from the start of the program to a run's camera's first image
//   sizes: for each image size, with a pinhole of 60 degrees mounted where the camera is:
//     first_ms: from the first message to its first image, at the size that the viewer chose
//     answer_ms: from a message to its image, while the camera moves after each image:
//       median and 95th percentile, and the size of most of these images
//     images_per_s: while the camera moves all the time, 60 messages a second, and their size
//     full: the images at full size among all these: their share, rendering, and from the
//       message's arrival to the image on its way, medians; without any, the machine is too slow
//   crowd: N pages (8) that move all the time for S seconds (60): images a second of all, the
//     slowest one's, and the program's memory at a tenth of the time and at the end, in MB
//   drive: only with --drive, the whole drive at SPEED times its own: images a second, the
//     longest time without a new one (a frame's own distance included), and the most memory, in MB
import {spawn} from "node:child_process";
import fs from "node:fs";
import http from "node:http";
import {createRequire} from "node:module";
import path from "node:path";

const words = process.argv.slice(2);
function option(name, usual) {
  const at = words.indexOf(name);
  return at < 0 ? usual : Number(words.splice(at, 2)[1]);
}
const clients = option("--clients", 8);
const crowdSeconds = option("--seconds", 60);
const speed = option("--drive", 0);
const [redrive, run, modules, wanted] = words;
const {WebSocket} = createRequire(path.resolve(modules, "x.js"))("ws");
const seconds = 5;
const sizes = ["640x352", "1280x704"];

const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const quantile = (values, share = 0.5) =>
  [...values].sort((a, b) => a - b)[Math.floor(share * (values.length - 1))];
const size = ({width, height}) => `${width} x ${height}`;

/** Returns the value that occurs most often. */
function mode(values) {
  const count = (value) => values.filter((other) => other === value).length;
  return [...new Set(values)].sort((a, b) => count(b) - count(a))[0];
}

/** A page without a browser. */
class Client {
  static async connect(address) {
    const client = new Client();
    client.id = 0;
    client.onImage = () => {};
    client.socket = new WebSocket(`ws://${address.host}${address.pathname}socket`,
      {origin: address.origin});
    await new Promise((resolve) => {
      client.socket.on("message", (data, isBinary) => {
        if (!isBinary) {
          const message = JSON.parse(data);
          if (message.kind === "hello") resolve((client.hello = message));
          if (message.kind === "error") throw new Error(message.text);
          return;
        }
        const header = JSON.parse(data.subarray(4, 4 + data.readUInt32LE(0)));
        client.socket.send(JSON.stringify({type: "shown", sequence: header.sequence}));
        client.onImage(header);
      });
    });
    return client;
  }

  camera() {
    const {cameras} = this.hello;
    return cameras.find(({name}) => name === wanted) ?? cameras[0];
  }

  /** Asks for the camera, or for a pinhole in its place, up to 0.5 m to the left of the car. */
  ask(pinhole, frame = this.hello.frames[Math.floor(this.hello.frames.length / 2)]) {
    const camera = this.camera();
    const m = camera.body_from_sensor;
    const yaw = (Math.atan2(m[6], m[2]) * 180) / Math.PI;
    this.socket.send(JSON.stringify({
      type: "view", id: ++this.id, camera: camera.name, frame: frame.id,
      shift_m: [0, 0.25 + 0.25 * Math.sin(0.1 * this.id), 0], yaw_deg: 0, pitch_deg: 0,
      layer: "image", exposure: `${camera.name}:${frame.id}`, overlays: [], reference: false,
      novel: null,
      mount: pinhole ? {
        at: `${m[3]},${m[7]},${m[11]},${yaw.toFixed(3)},0,0`, lens: `pinhole:60:${pinhole}`} : null,
    }));
  }

  image() {
    return new Promise((resolve) => (this.onImage = resolve));
  }

  /** Calls `each` with the header of every image for some time. */
  async collect(for_s, each = () => {}) {
    const headers = [];
    this.onImage = (header) => {
      headers.push(header);
      each(header);
    };
    await wait(1000 * for_s);
    this.onImage = () => {};
    return headers;
  }

  /** Asks 60 times a second and returns the headers of the images. */
  async move(for_s, pinhole) {
    const timer = setInterval(() => this.ask(pinhole), 1000 / 60);
    const headers = await this.collect(for_s);
    clearInterval(timer);
    return headers;
  }
}

/** Times one client at a size of the pinhole. */
async function measure(client, pinhole) {
  let asked = performance.now();
  const first = client.image();
  client.ask(pinhole);
  const {width, height} = await first;
  const first_ms = performance.now() - asked;
  await wait(2000); // full size has come and was measured
  const answers = [];
  const again = () => {
    asked = performance.now();
    client.ask(pinhole);
  };
  again();
  const answered = await client.collect(seconds, (header) => {
    if (header.id !== client.id) return;
    answers.push(performance.now() - asked);
    again();
  });
  await wait(500);
  const moving = await client.move(seconds, pinhole);
  await wait(500);
  const full = answered.concat(moving).filter(({factor}) => factor === 1);
  return {
    first_ms: Math.round(first_ms), first_size: size({width, height}),
    answer_ms: {
      median: +quantile(answers).toFixed(1), p95: +quantile(answers, 0.95).toFixed(1),
      size: mode(answered.map(size))},
    images_per_s: +(moving.length / seconds).toFixed(1), moving_size: mode(moving.map(size)),
    full: full.length === 0 ? null : {
      share: +(full.length / (answered.length + moving.length)).toFixed(2),
      render_ms: quantile(full.map(({render_ms}) => render_ms)),
      total_ms: quantile(full.map(({total_ms}) => total_ms))},
  };
}

function memory_mb(pid) {
  const pages = fs.readFileSync(`/proc/${pid}/statm`, "utf8").split(" ")[1];
  return Math.round((pages * 4096) / 1e6);
}

/** Times `clients` pages at once. */
async function crowd(address, pid) {
  const all = await Promise.all(Array.from({length: clients}, () => Client.connect(address)));
  const moved = all.map((client) => client.move(crowdSeconds));
  await wait(100 * crowdSeconds);
  const early_mb = memory_mb(pid);
  const counts = (await Promise.all(moved)).map((headers) => headers.length);
  const late_mb = memory_mb(pid);
  all.forEach(({socket}) => socket.terminate());
  const sum = counts.reduce((a, b) => a + b, 0);
  return {clients, seconds: crowdSeconds, images_per_s: +(sum / crowdSeconds).toFixed(1),
    slowest_images_per_s: +(Math.min(...counts) / crowdSeconds).toFixed(1), early_mb, late_mb};
}

/** Drives from the first frame to the last. */
async function drive(client, pid) {
  const {frames} = client.hello;
  const arrivals = [];
  let most_mb = 0;
  client.onImage = () => {
    arrivals.push(performance.now());
    most_mb = Math.max(most_mb, memory_mb(pid));
  };
  const began = performance.now();
  for (const frame of frames) {
    const ahead = (1000 * (frame.t_s - frames[0].t_s)) / speed - (performance.now() - began);
    if (ahead > 0) await wait(ahead);
    client.ask(null, frame);
  }
  await wait(1000);
  const driven = arrivals.filter((at) => at < began + (1000 * frames.at(-1).t_s) / speed);
  const gaps = driven.slice(1).map((at, i) => at - driven[i]);
  return {frames: frames.length, seconds: frames.at(-1).t_s / speed,
    images_per_s: +((1000 * driven.length) / (driven.at(-1) - began)).toFixed(1),
    longest_gap_ms: Math.round(Math.max(...gaps)), p95_gap_ms: Math.round(quantile(gaps, 0.95)),
    most_mb};
}

/** Size of a file of the page as it is sent. */
function bytesOf(address) {
  return new Promise((resolve) => {
    http.get(address, {headers: {"Accept-Encoding": "gzip"}}, (response) => {
      let sum = 0;
      response.on("data", (bytes) => (sum += bytes.length));
      response.on("end", () => resolve(sum));
    });
  });
}

const start = performance.now();
const program =
  spawn(redrive, ["view", run, "--port", "0"], {stdio: ["ignore", "pipe", "inherit"]});
let failed = true;
try {
  let printed = "";
  const address = await new Promise((resolve) => {
    program.stdout.on("data", (bytes) => {
      printed += bytes;
      const found = /http:\/\/\S+/.exec(printed);
      if (found) resolve(new URL(found[0]));
    });
  });
  const client = await Client.connect(address);
  const first = client.image();
  client.ask();
  const {camera} = await first;
  const start_ms = Math.round(performance.now() - start);
  await wait(2000);
  let page_gz_bytes = 0;
  for (const file of ["", "viewer.js", "viewer.css"])
    page_gz_bytes += await bytesOf(new URL(file, address));
  const result = {run, method: client.hello.method, camera, page_gz_bytes, start_ms, sizes: {}};
  if (speed > 0) result.drive = await drive(client, program.pid);
  for (const pinhole of speed > 0 ? [] : sizes)
    result.sizes[pinhole] = await measure(client, pinhole);
  client.socket.terminate();
  if (clients > 0 && speed === 0) result.crowd = await crowd(address, program.pid);
  console.log(JSON.stringify(result, null, 2));
  failed = false;
} finally {
  program.kill("SIGINT");
}
process.exit(failed ? 1 : 0);
