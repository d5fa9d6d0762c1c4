// SPDX-License-Identifier: Apache-2.0
// The page of `redrive export --to html`: node scene_test.mjs REDRIVE SAMPLES NODE_MODULES [SHOTS]
// Trains a small run of the sample street, opens its page from the disk in a headless chromium with
// WebGL in software, and compares it with `redrive render`. SHOTS: a folder for screenshots. Exit
// code 77: skipped, there is no chromium or it has no WebGL.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import {findBrowser, openPage, psnr, skip} from "./browser.mjs";

const [redrive, samples, modules, shots] = process.argv.slice(2);
const launch = findBrowser(modules);
const [width, height] = [320, 180];
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-scene-"));
const run = path.join(folder, "run");
const file = path.join(folder, "scene.html");

/** The image that `redrive render` makes of the page's first pose. */
function rendered() {
  const html = fs.readFileSync(file, "utf8");
  const scene = JSON.parse(/id="scene">(.*?)<\/script>/s.exec(html)[1]);
  const pathFile = path.join(folder, "path.json");
  fs.writeFileSync(pathFile, JSON.stringify({
    render_width: width, render_height: height, fps: 1,
    camera_path: [{camera_to_world: scene.drive[0].camera_to_world, fov: scene.fov}],
  }));
  execFileSync(redrive, ["render", "path", run, pathFile, "--exposure", "none", "--out",
    path.join(folder, "rendered")], {stdio: "pipe"});
  return fs.readFileSync(path.join(folder, "rendered", "000000.png"));
}

let browser = null;
try {
  execFileSync(redrive, ["train", path.join(samples, "street"), "--out", run, "--truth-poses",
    "--method", "splat", "--cameras", "F_MIDLONGRANGECAM_CL", "--frames", "1016:1040",
    "--max-steps", "60", "--max-gaussians", "40000", "--threads", "2"], {stdio: "pipe"});
  execFileSync(redrive, ["export", `${run}/`, "--to", "html", file], {stdio: "pipe"});
  browser = await launch(["--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]);
  const page = await openPage(browser);
  const [errors, requests] = [[], []];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  page.on("request", (request) => requests.push(request.url()));
  await page.setViewport({width, height});
  await page.goto(`file://${file}`, {waitUntil: "domcontentloaded"});
  const [notes, isReady] = await page.evaluate(() => {
    const notice = document.getElementById("notice");
    return [notice.hidden ? "" : notice.textContent, window.redriveScene?.ready ?? false];
  });
  assert.ok(isReady || /Loading the scene/.test(notes), "it says that it is loading");
  const hasWebGl = await page.evaluate(
    () => document.createElement("canvas").getContext("webgl2") !== null);
  if (!hasWebGl) {
    await browser.close();
    fs.rmSync(folder, {recursive: true, force: true});
    skip("this chromium has no WebGL");
  }
  await page.waitForFunction(() => window.redriveScene?.ready);
  assert.equal(await page.$eval("#notice", (notice) => notice.hidden), true);
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
  const cdp = await page.createCDPSession();
  const touch = (type, points) => cdp.send("Input.dispatchTouchEvent",
    {type, touchPoints: points.map(([x, y], id) => ({x, y, id}))});
  const still = await at();
  await touch("touchStart", [[140, 90], [180, 90]]);
  await touch("touchMove", [[110, 90], [210, 90]]);
  await touch("touchEnd", []);
  await page.waitForFunction((x) => window.redriveScene.camera.position.x - x > 0.5, {}, still[0]);

  // A world whose direction up is not z, as in sets of photographs: R moves and the mouse turns so.
  const up = [0, 0.6, 0.8];
  const html = fs.readFileSync(file, "utf8");
  assert.ok(html.includes("<title>run - redrive</title>"));
  const data = JSON.parse(/id="scene">(.*?)<\/script>/s.exec(html)[1]);
  assert.deepEqual(data.up, [0, 0, 1]);
  fs.writeFileSync(file, html.replace(/(id="scene">).*?(<\/script>)/s,
    (_, before, after) => before + JSON.stringify({...data, up}) + after));
  await page.reload();
  await page.waitForFunction(() => window.redriveScene?.ready);
  const start = await at();
  await page.keyboard.down("r");
  await page.waitForFunction(
    (z) => window.redriveScene.camera.position.z - z > 0.2, {}, start[2]);
  await page.keyboard.up("r");
  const risen = (await at()).map((x, k) => x - start[k]);
  const length = Math.hypot(...risen);
  risen.forEach((x, k) => assert.ok(Math.abs(x / length - up[k]) < 1e-3, `R moves along ${risen}`));
  const forwardUp = () => page.evaluate((axis) => {
    const {elements} = window.redriveScene.camera.matrixWorld;
    return -axis.reduce((sum, x, k) => sum + x * elements[8 + k], 0);
  }, up);
  const [ahead, level] = [await page.evaluate(
    () => window.redriveScene.camera.quaternion.toArray()), await forwardUp()];
  await page.mouse.move(100, 60);
  await page.mouse.down();
  await page.mouse.move(160, 60, {steps: 4});
  await page.mouse.up();
  await page.waitForFunction((before) => window.redriveScene.camera.quaternion.toArray()
    .some((x, k) => Math.abs(x - before[k]) > 0.01), {}, ahead);
  await page.evaluate(() => window.redriveScene.camera.updateMatrixWorld());
  assert.ok(Math.abs(await forwardUp() - level) < 1e-3, "a turn about up keeps the pitch");

  assert.deepEqual(errors, []);
  assert.deepEqual(requests.filter((url) => !/^(file|data|blob):/.test(url)), []);
  assert.ok(fs.statSync(file).size < 60e6);
} finally {
  await browser?.close();
  fs.rmSync(folder, {recursive: true, force: true});
}
