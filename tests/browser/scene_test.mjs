// SPDX-License-Identifier: Apache-2.0
// The page of `redrive export --to html`: node scene_test.mjs REDRIVE SAMPLES NODE_MODULES [SHOTS]
// Trains a small run of the sample street, opens its page from the disk in a headless chromium with
// WebGL in software, and compares it with `redrive render`. SHOTS: a folder for screenshots. Exit
// code 77: skipped, there is no chromium or it has no WebGL.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import {createRequire} from "node:module";
import os from "node:os";
import path from "node:path";

const [redrive, samples, modules, shots] = process.argv.slice(2);
const chromium = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"]
  .find((file) => fs.existsSync(file));
function skip(why) {
  console.log(`skipped: ${why}`);
  process.exit(77);
}
if (!chromium) skip("there is no chromium (scripts/setup installs it)");
if (!fs.existsSync(path.join(modules, "puppeteer-core")))
  skip("npm could not install puppeteer-core when this was built");
const puppeteer = createRequire(path.join(modules, "x.js"))("puppeteer-core");
const [width, height] = [320, 180];
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-scene-"));
const run = path.join(folder, "run");
const file = path.join(folder, "scene.html");

/** PSNR of two PNGs, in dB. */
function psnr(page, pngs) {
  return page.evaluate(async (texts) => {
    const pixels = await Promise.all(texts.map(async (text) => {
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      const image = await createImageBitmap(new Blob([bytes], {type: "image/png"}));
      const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
      context.drawImage(image, 0, 0);
      return context.getImageData(0, 0, image.width, image.height).data;
    }));
    if (pixels[0].length !== pixels[1].length) return 0;
    let sum = 0;
    for (let i = 0; i < pixels[0].length; ++i)
      if (i % 4 !== 3) sum += (pixels[0][i] - pixels[1][i]) ** 2;
    return 10 * Math.log10(255 ** 2 / (sum / (0.75 * pixels[0].length)));
  }, pngs.map((png) => Buffer.from(png).toString("base64")));
}

/** The image that `redrive render` makes of the page's first pose. */
function rendered() {
  const html = fs.readFileSync(file, "utf8");
  const scene = JSON.parse(/id="scene">(.*?)<\/script>/s.exec(html)[1]);
  const pathFile = path.join(folder, "path.json");
  fs.writeFileSync(pathFile, JSON.stringify({
    render_width: width, render_height: height, fps: 1,
    camera_path: [{camera_to_world: scene.drive[0].camera_to_world, fov: scene.fov}],
  }));
  execFileSync(redrive, ["render", run, "--path", pathFile, "--exposure", "none", "--out",
    path.join(folder, "rendered")], {stdio: "pipe"});
  return fs.readFileSync(path.join(folder, "rendered", "000000.png"));
}

let browser = null;
try {
  execFileSync(redrive, ["train", path.join(samples, "street"), "--out", run, "--truth-poses",
    "--method", "splat", "--cameras", "F_MIDLONGRANGECAM_CL", "--frames", "1016:1040",
    "--max-steps", "60", "--max-gaussians", "40000", "--threads", "2"], {stdio: "pipe"});
  execFileSync(redrive, ["export", run, "--to", "html", file], {stdio: "pipe"});
  browser = await puppeteer.launch({
    executablePath: chromium, headless: true,
    args: ["--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]});
  const page = await browser.newPage();
  const [errors, requests] = [[], []];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  page.on("request", (request) => requests.push(request.url()));
  await page.setViewport({width, height});
  await page.goto(`file://${file}`);
  const hasWebGl = await page.evaluate(
    () => document.createElement("canvas").getContext("webgl2") !== null);
  if (!hasWebGl) {
    await browser.close();
    fs.rmSync(folder, {recursive: true, force: true});
    skip("this chromium has no WebGL");
  }
  await page.waitForFunction(() => window.redriveScene?.ready, {timeout: 60000});
  await page.keyboard.press("h");

  // The Gaussians are sorted beside the page: it takes some images until they are in order.
  const expected = rendered();
  let db = 0;
  for (let i = 0; i < 30 && db < 30; ++i) {
    await page.evaluate(() => new Promise((done) => setTimeout(done, 500)));
    db = await psnr(page, [await page.screenshot(), expected]);
  }
  if (shots) {
    fs.writeFileSync(path.join(shots, "scene-page.png"), await page.screenshot());
    fs.writeFileSync(path.join(shots, "scene-rendered.png"), expected);
  }
  console.log(`PSNR of the page and redrive render: ${db.toFixed(2)} dB`);
  assert.ok(db >= 30);

  await page.keyboard.press("Space");
  await page.waitForFunction(() => Number(document.getElementById("time").value) > 0.1);
  await page.keyboard.press("Space");
  const at = () => page.evaluate(() => window.redriveScene.camera.position.toArray());
  const before = await at();
  await page.keyboard.down("w");
  await page.waitForFunction(
    (x) => Math.abs(window.redriveScene.camera.position.x - x) > 0.2, {}, before[0]);
  await page.keyboard.up("w");
  assert.ok((await at())[0] > before[0], "W moves ahead: x of the first body pose");

  assert.deepEqual(errors, []);
  assert.deepEqual(requests.filter((url) => !/^(file|data|blob):/.test(url)), []);
  assert.ok(fs.statSync(file).size < 60e6);
} finally {
  await browser?.close();
  fs.rmSync(folder, {recursive: true, force: true});
}
