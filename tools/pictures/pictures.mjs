// SPDX-License-Identifier: Apache-2.0
// The pictures of README.md and docs: node pictures.mjs REDRIVE SAMPLES NODE_MODULES OUT [NAME...]
// Runs are made in a temporary folder; a picture is written when all that it shows is there.
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import {pathToFileURL} from "node:url";
import {findBrowser, openPage, serve} from "../../tests/browser/browser.mjs";
import {settled} from "../../tests/browser/viewer_page.mjs";
import {screenshotOfCanvas} from "../../tests/browser/viewer_seen.mjs";

const [redriveFile, samples, modules, out, ...names] = process.argv.slice(2);
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-pictures-"));
const camera = "F_MIDLONGRANGECAM_CL";
const gap = 8; // pixels between images side by side

function redrive(...words) {
  console.log(`redrive ${words.join(" ")}`);
  execFileSync(redriveFile, words, {stdio: ["ignore", "ignore", "inherit"]});
}

const inFolder = (name) => path.join(folder, name);
const recorded = (sample, frame) =>
  path.join(samples, sample, "sensor", "camera", camera, `${camera}_${frame}.jpg`);

/** Trains once and returns the run's folder. */
function trained(name, words) {
  const run = inFolder(name);
  if (!fs.existsSync(run)) redrive("train", ...words, "--out", run);
  return run;
}

const traffic = () => trained("RUN", [path.join(samples, "street_traffic"), "--truth-poses",
  "--method", "splat", "--holdout-every", "6", "--max-seconds", "0", "--max-steps", "1500"]);

function rendered(run, name, frame, ...words) {
  const file = inFolder(`${name}.png`);
  redrive("render", run, "--camera", camera, "--frame", String(Number(frame)), ...words,
    "--out", file);
  return file;
}

/** An image of images side by side, each `width` wide; as JPEG where the name says so. */
async function row(browser, name, files, width) {
  const page = await openPage(browser);
  await page.setViewport({width: files.length * (width + gap) - gap, height: 600});
  const images = files.map((file) => {
    const type = file.endsWith(".png") ? "png" : "jpeg";
    return `<img src="data:image/${type};base64,${fs.readFileSync(file).toString("base64")}">`;
  });
  await page.setContent(`<style>body { margin: 0; display: flex; gap: ${gap}px; }
    img { width: ${width}px; display: block; }</style>${images.join("")}`);
  await page.evaluate(() => Promise.all([...document.images].map((image) => image.decode())));
  const height = await page.$eval("img", (image) => Math.floor(image.clientHeight));
  await write(page, name, {x: 0, y: 0, width: files.length * (width + gap) - gap, height});
  await page.close();
}

async function write(page, name, clip) {
  const type = name.endsWith(".png") ? {type: "png"} : {type: "jpeg", quality: 88};
  fs.writeFileSync(path.join(out, name),
    await page.screenshot({...type, clip, captureBeyondViewport: false}));
  console.log(path.join(out, name));
}

/** Draws masks, boxes and track ids over an image of a simulated drive; returns the file. */
async function labelled(browser, drive, frame) {
  const {images, annotations} = JSON.parse(
    fs.readFileSync(path.join(drive, "labels", "instances.json")));
  const image = images.find((one) => one.camera === camera && one.frame_id === Number(frame));
  const pixels = fs.readFileSync(path.join(drive, "labels", image.file_name)).toString("base64");
  const page = await openPage(browser);
  await page.setViewport({width: image.width, height: image.height});
  await page.setContent(
    '<style>body { margin: 0 } canvas { display: block }</style><canvas id="canvas"></canvas>');
  await page.evaluate(async (url, objects, {width, height}) => {
    const canvas = Object.assign(document.querySelector("canvas"), {width, height});
    const draw = canvas.getContext("2d");
    const drawn = new Image();
    drawn.src = url;
    await drawn.decode();
    draw.drawImage(drawn, 0, 0);
    draw.font = "bold 13px sans-serif";
    for (const {bbox, segmentation, track_id: id} of objects) {
      const hue = (id * 137 + 60) % 360; // apart for any number of objects
      draw.fillStyle = `hsl(${hue} 90% 50% / 0.45)`;
      let pixel = 0; // down the columns
      segmentation.counts.forEach((run, k) => {
        for (const end = pixel + run; pixel < end; ++pixel)
          if (k % 2 === 1) draw.fillRect(Math.floor(pixel / height), pixel % height, 1, 1);
      });
      draw.strokeStyle = draw.fillStyle = `hsl(${hue} 90% 60%)`;
      draw.lineWidth = 2;
      draw.strokeRect(...bbox);
      draw.fillText(String(id), bbox[0] + 3, bbox[1] - 4);
    }
  }, `data:image/png;base64,${pixels}`,
  annotations.filter((one) => one.image_id === image.id), image);
  const file = inFolder(`${path.basename(drive)}.png`);
  fs.writeFileSync(file, await screenshotOfCanvas(page));
  await page.close();
  return file;
}

function written(name, json) {
  fs.writeFileSync(inFolder(name), JSON.stringify(json));
  return inFolder(name);
}

/** Serves the traffic run; use(open) opens pages at an address: open("&layer=depth"). */
async function viewed(browser, words, use) {
  const run = path.basename(traffic()); // the page shows it as it was named
  const {program, address} = await serve(path.resolve(redriveFile), ["view", run, ...words],
    {cwd: folder});
  try {
    await use(async (more) => {
      const page = await openPage(browser);
      await page.setViewport({width: 1280, height: 720});
      await page.goto(`${address}#camera=${camera}&frame=1012${more}`);
      await page.waitForFunction(() => window.redriveView?.state);
      return page;
    });
  } finally {
    program.kill("SIGINT");
  }
}

const pictures = {
  async demo(browser) {
    const run = trained("demo", [path.join(samples, "street"), "--method", "splat",
      "--truth-poses", "--holdout-every", "8", "--max-seconds", "60"]);
    const truth = path.join(samples, "street", "novel", "left_1");
    const [image] = fs.readdirSync(truth, {recursive: true})
      .filter((name) => /1028.*\.(jpg|png)$/.test(name) && !/depth/.test(name));
    await row(browser, "demo.png", [recorded("street", "0001028"), rendered(run, "own", "1028"),
      rendered(run, "left", "1028", "--translate", "0,1,0", "--axes", "body"),
      path.join(truth, image)], 300);
  },

  async traffic(browser) {
    const run = traffic();
    const removed = written("removed.json", {actors: {2: {remove: true}}});
    const moved = written("moved.json", {actors: {2: {shift_m: [0, 2.6, 0], turn_deg: 12}}});
    await row(browser, "traffic.jpg", [recorded("street_traffic", "0001012"),
      rendered(run, "as-recorded", "1012"), rendered(run, "removed", "1012", "--edit", removed),
      rendered(run, "moved", "1012", "--edit", moved)], 416);
  },

  async labels(browser) {
    const moved = written("anew.json", {actors: {2: {shift_m: [0, 2.6, 0], turn_deg: 12}}});
    const drives = {driven: [], anew: ["--path", "sideways:1", "--edit", moved]};
    const files = [];
    for (const [name, words] of Object.entries(drives)) {
      const drive = inFolder(name);
      redrive("simulate", traffic(), "--sensor", "none", "--labels", "masks", ...words,
        "--out", drive);
      files.push(await labelled(browser, drive, "1012"));
    }
    await row(browser, "labels.jpg", files, 628);
  },

  async poses(browser) {
    const street = path.join(samples, "street");
    const words = [street, "--method", "grid", "--holdout-every", "8", "--max-seconds", "0",
      "--max-steps", "2000"];
    redrive("align", street, "--out", inFolder("aligned"));
    const runs = {
      initial: ["--refine-poses", "off"], refined: [],
      aligned: ["--poses", inFolder("aligned")], truth: ["--truth-poses"],
    };
    const files = Object.entries(runs).map(([name, more]) =>
      rendered(trained(name, [...words, ...more]), `poses-${name}`, "1024"));
    await row(browser, "poses.jpg", files, 410);
  },

  async preflight(browser) {
    const check = inFolder("check");
    redrive("inspect", path.join(samples, "street"), "--report", check);
    const page = await openPage(browser);
    const size = {width: 1280, height: 1080};
    await page.setViewport(size);
    await page.goto(pathToFileURL(path.join(check, "index.html")).href);
    await write(page, "preflight.jpg", {x: 0, y: 0, ...size});
    await page.close();
  },

  async viewer(browser) {
    const edit = written("EDIT.json", {actors: {2: {shift_m: [-3, 1.2, 0], turn_deg: 12}}});
    await viewed(browser, ["--edit", edit], async (open) => {
      const page = await open("");
      await page.select("#objects", "2");
      await page.waitForFunction(() => window.redriveView.state.object === 2);
      await settled(page);
      await page.waitForFunction(
        () => window.redriveView.stage.image.header.lines.some(({kind}) => kind === "object"));
      await page.$eval("#object details", (numbers) => (numbers.open = true));
      await settled(page);
      await page.evaluate(() => window.redriveView.draw()); // the card has another height
      await screenshotOfCanvas(page); // all of it is in sight
      await write(page, "viewer.jpg", {x: 0, y: 0, width: 1280, height: 720});
      await page.close();
    });
  },

  async scan(browser) {
    const shown = {recorded: "&over=lidar", rendered: "&scan=recorded,range",
      other: "&scan=hdl-64e,range"};
    const files = [];
    await viewed(browser, [], async (open) => {
      for (const [name, more] of Object.entries(shown)) {
        const page = await open(more);
        await settled(page);
        files.push(inFolder(`scan-${name}.png`));
        fs.writeFileSync(files.at(-1), await screenshotOfCanvas(page));
        await page.close();
      }
    });
    await row(browser, "scan.jpg", files, 416);
  },
};

const wanted = names.length > 0 ? names : Object.keys(pictures);
for (const name of wanted)
  if (!pictures[name]) throw new Error(`no picture ${name}: ${Object.keys(pictures).join(", ")}`);
const browser = await findBrowser(modules)(["--disable-gpu"]);
try {
  for (const name of wanted) await pictures[name](browser);
} finally {
  await browser.close();
  fs.rmSync(folder, {recursive: true, force: true});
}
