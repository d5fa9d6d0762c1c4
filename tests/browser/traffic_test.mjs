// SPDX-License-Identifier: Apache-2.0
// Moving objects in the page of `redrive view`: node traffic_test.mjs REDRIVE SAMPLES NODE_MODULES
// [SHOTS]. Trains a small run of the street with annotated vehicles, and moves them.
// SHOTS: a folder for screenshots. Exit code 77: skipped, there is no chromium.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import {findBrowser, openPage} from "./browser.mjs";
import {psnrOfPage, renderAsThePageSays, runParts, set, settled, text} from "./viewer_page.mjs";

const [redrive, samples, modules, shots] = process.argv.slice(2);
const launch = findBrowser(modules);
const camera = "F_MIDLONGRANGECAM_CL";
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-traffic-"));
const run = path.join(folder, "run");
const car = "2"; // an oncoming car

/** The edit of the page once the program has answered. */
async function edit(page) {
  await page.waitForFunction(() => {
    const {drag, accepted, sent} = window.redriveView.traffic;
    return !drag && JSON.stringify(JSON.parse(sent.text || accepted)) === accepted;
  });
  await settled(page);
  return JSON.parse(await page.evaluate(() => window.redriveView.traffic.accepted));
}

/** u, v of the middle of the selected object's base, of its handle, and of its box's middle. */
function outline(page) {
  return page.evaluate(() => {
    const {lines} = window.redriveView.stage.image.header;
    const [handle] = lines.filter(({kind}) => kind === "handle");
    const box = lines.filter(({kind}) => kind === "object").flatMap(({points}) => points);
    const middle = (k) => {
      const values = box.filter((_, i) => i % 2 === k);
      return (Math.min(...values) + Math.max(...values)) / 2;
    };
    return handle && {
      base: handle.points.slice(0, 2), tip: handle.points.slice(-2), middle: [middle(0), middle(1)],
    };
  });
}

/** The place of u, v in the window. */
async function placeOf(page, [u, v]) {
  await page.$eval("#canvas", (canvas) => canvas.scrollIntoView({block: "center"}));
  const box = await (await page.$("#canvas")).boundingBox();
  return {x: box.x + u * box.width, y: box.y + v * box.height, box};
}

async function drag(page, from, right, down) {
  const {x, y, box} = await placeOf(page, from);
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + right * box.width, y + down * box.height, {steps: 5});
  await page.mouse.up();
}

const near = (a, b, tolerance, what) =>
  assert.ok(Math.abs(a - b) <= tolerance, `${what}: ${a} instead of ${b}`);

async function select(page, id) {
  await page.select("#objects", id);
  await page.waitForFunction((wanted) => String(window.redriveView.state.object) === wanted, {}, id);
  await settled(page);
}

async function click(page, id) {
  await page.$eval(`#${id}`, (button) => button.click());
  return edit(page);
}

const savedFile = path.join(folder, "EDIT.json");

const tests = {
  async "lists the objects"(page) {
    await settled(page);
    const listed = await page.$$eval("#objects option", (all) => all.map((one) => one.textContent));
    assert.deepEqual(listed, ["2 car · 1000 to 1023", "3 van · 1000 to 1023"]);
    await select(page, car);
    await page.click("#object-go");
    await settled(page);
    assert.ok(await outline(page));
  },

  async "selects by a click"(page) {
    const {middle} = await outline(page);
    await page.focus("#stage");
    await page.keyboard.press("Escape");
    await page.waitForFunction(() => window.redriveView.state.object === null);
    await settled(page);
    assert.equal(await outline(page), undefined);
    const {x, y, box} = await placeOf(page, middle);
    await page.mouse.click(x, y);
    await page.waitForFunction(() => window.redriveView.state.object === 2);
    await settled(page);
    await page.mouse.click(box.x + 0.5 * box.width, box.y + 0.03 * box.height); // the sky
    await page.waitForFunction(() => window.redriveView.state.object === null);
    await select(page, car);
  },

  async "drags on the road, and undoes it"(page) {
    const before = await outline(page);
    await drag(page, before.middle, -0.1, 0.02);
    const moved = await edit(page);
    const [forward, left, up] = moved.actors[car].shift_m;
    assert.ok(Math.hypot(forward, left) > 0.3 && up === 0, `${forward}, ${left}, ${up}`);
    const after = await outline(page);
    near(after.base[0] - before.base[0], -0.1, 0.004, "its base moves with the pointer, right");
    near(after.base[1] - before.base[1], 0.02, 0.004, "its base moves with the pointer, down");
    if (shots) await page.screenshot({path: path.join(shots, "dragged.png"), fullPage: true});
    assert.deepEqual(await click(page, "edit-undo"), {});
    near((await outline(page)).base[0], before.base[0], 0.001, "undone");
    assert.deepEqual(await click(page, "edit-redo"), moved);
    await page.focus("#stage");
    await page.keyboard.down("Control");
    await page.keyboard.press("z");
    await page.keyboard.up("Control");
    await page.waitForFunction(() => window.redriveView.traffic.accepted === "{}");
    assert.deepEqual(await edit(page), {});
    await drag(page, before.middle, 0, -0.9); // above the horizon it stays where it was last
    const kept = await edit(page);
    assert.ok(!kept.actors || Math.abs(kept.actors[car].shift_m[0]) < 250, JSON.stringify(kept));
    await click(page, "edit-clear");
  },

  async "keeps dragging an object that is no longer selected"(page) {
    const {x, y, box} = await placeOf(page, (await outline(page)).middle);
    await page.evaluate(() => {
      window.greetings = 0;
      const {traffic} = window.redriveView;
      const connected = traffic.connected.bind(traffic);
      traffic.connected = () => (++window.greetings, connected());
    });
    await page.focus("#stage");
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x - 0.05 * box.width, y);
    await page.keyboard.press("Escape");
    await page.mouse.move(x - 0.1 * box.width, y, {steps: 3});
    await page.mouse.up();
    const {actors} = await edit(page);
    assert.ok(Math.hypot(...actors[car].shift_m) > 0.1, JSON.stringify(actors));
    assert.equal(await page.evaluate(() => window.redriveView.state.object), null);
    assert.equal(await page.evaluate(() => window.greetings), 0, "connections that were closed");
    await click(page, "edit-clear");
    await select(page, car);
  },

  async "goes back to the last edit that the program took"(page) {
    const accepted = await page.evaluate(() => {
      const {traffic} = window.redriveView;
      const {send} = traffic;
      traffic.send = () => {}; // answered here
      traffic.change({speed: 0.5}, true);
      const {id} = traffic.sent;
      traffic.change({speed: 1000}, true);
      traffic.receive({kind: "edited", id, remarks: []});
      traffic.receive({kind: "edited", id: id + 1, error: "too fast"});
      traffic.send = send;
      return JSON.parse(traffic.accepted);
    });
    assert.deepEqual(accepted, {actors: {[car]: {speed: 0.5}}});
    assert.deepEqual(await click(page, "edit-undo"), {});
  },

  async "turns by the handle and by keys"(page) {
    const {tip, base} = await outline(page);
    await drag(page, tip, 2 * (base[0] - tip[0]), 2 * (base[1] - tip[1]));
    const {actors} = await edit(page);
    assert.ok(Math.abs(Math.abs(actors[car].turn_deg) - 180) < 60, `${actors[car].turn_deg}`);
    await click(page, "object-reset");
    await page.focus("#stage");
    await page.keyboard.press("q");
    await page.keyboard.press("q");
    await page.waitForFunction(() => /turn_deg":10/.test(window.redriveView.traffic.accepted));
    assert.deepEqual(await edit(page), {actors: {[car]: {turn_deg: 10}}});
    assert.deepEqual(await click(page, "object-reset"), {});
  },

  async "says what is wrong, and keeps what was right"(page) {
    await set(page, "object-speed", 0.5);
    assert.deepEqual(await edit(page), {actors: {[car]: {speed: 0.5}}});
    await set(page, "object-speed", 1000);
    await page.waitForFunction(
      () => /actors\.2\.speed/.test(document.getElementById("edit-note").textContent));
    assert.deepEqual(await page.evaluate(() => window.redriveView.traffic.edit.actors),
      {[car]: {speed: 0.5}});
    assert.deepEqual(await click(page, "edit-undo"), {});
    const wrong = path.join(folder, "wrong.json");
    fs.writeFileSync(wrong, JSON.stringify({actors: {77: {remove: true}}}));
    await (await page.$("#edit-file")).uploadFile(wrong);
    await page.waitForFunction(() => /wrong\.json.*actors\.77.*there are 2, 3/s.test(
      document.getElementById("edit-note").textContent));
    assert.equal(await page.evaluate(() => window.redriveView.traffic.accepted), "{}");
    fs.writeFileSync(wrong, "{");
    await (await page.$("#edit-file")).uploadFile(wrong);
    await page.waitForFunction(() => /wrong\.json/.test(
      document.getElementById("edit-note").textContent) && !/actors/.test(
      document.getElementById("edit-note").textContent));
  },

  async "saves what render draws"(page) {
    await set(page, "object-left", 1.5);
    await set(page, "object-turn", 20);
    await set(page, "object-red", 0.3);
    await page.click("#object-copy");
    await edit(page);
    await set(page, "object-from", 0);
    await set(page, "object-to", 0.05);
    await select(page, "3");
    await page.click("#object-removed");
    await edit(page);
    const client = await page.createCDPSession();
    await client.send("Browser.setDownloadBehavior", {behavior: "allow", downloadPath: folder});
    await page.click("#edit-save");
    while (!fs.existsSync(savedFile)) await new Promise((resolve) => setTimeout(resolve, 50));
    const saved = JSON.parse(fs.readFileSync(savedFile, "utf8"));
    assert.deepEqual(saved.actors[car], {shift_m: [0, 1.5, 0], turn_deg: 20, gain: [0.3, 1, 1]});
    assert.deepEqual(saved.actors["3"], {remove: true});
    assert.equal(saved.copies[0].of, 2);
    assert.deepEqual(saved.copies[0].hide_s, [0, 0.05]);
    const command = await text(page, "command");
    assert.match(command, / --edit EDIT\.json$/);
    const file = path.join(folder, "edited.png");
    renderAsThePageSays(redrive, command, file, savedFile);
    const db = await psnrOfPage(page, file);
    assert.ok(db >= 35, `PSNR of the page's image and render's: ${db} dB`);
    if (shots) await page.screenshot({path: path.join(shots, "edited.png"), fullPage: true});
  },

  async "loads it again, and keeps it over a reload, for one page"(page, address, browser) {
    const saved = await edit(page);
    await click(page, "edit-clear");
    await (await page.$("#edit-file")).uploadFile(savedFile);
    await page.waitForFunction(
      (wanted) => window.redriveView.traffic.accepted === wanted, {}, JSON.stringify(saved));
    assert.deepEqual(await edit(page), saved);
    await page.reload();
    await page.waitForFunction(() => window.redriveView?.state);
    assert.deepEqual(await edit(page), saved);
    const other = await openPage(browser);
    await other.goto(address);
    await other.waitForFunction(() => window.redriveView?.state);
    await settled(other);
    assert.equal(await other.evaluate(() => window.redriveView.traffic.accepted), "{}");
    await other.close();
    await page.bringToFront();
    await click(page, "edit-clear");
  },

  async "previews a path as render makes its video"(page) {
    await set(page, "exposure", "none");
    await set(page, "frame", 4);
    await page.click("#path-add");
    await set(page, "frame", 20);
    await page.click("#path-add");
    await page.click("#path-save");
    await page.waitForFunction(
      () => /^Saved/.test(document.getElementById("path-note").textContent));
    const images = path.join(folder, "path");
    renderAsThePageSays(redrive, `${await text(page, "path-command")} --exposure none`, images);
    await page.evaluate(() => { // stops at image 24 of 48, 2 s
      const {path} = window.redriveView;
      const request = path.request.bind(path);
      path.tick = () => {};
      path.play();
      path.request = () => ({...request(), path_s: 48 / 47});
      window.redriveView.changed();
    });
    await page.waitForFunction(() => !window.redriveView.asks);
    await settled(page);
    const db = await psnrOfPage(page, path.join(images, "000024.png"));
    assert.ok(db >= 35, `PSNR of the preview and the video: ${db} dB`);
  },
};

try {
  execFileSync(redrive, ["train", path.join(samples, "street_traffic"), "--out", run,
    "--truth-poses", "--method", "splat", "--cameras", camera, "--holdout-every", "6",
    "--max-steps", "150", "--threads", "2"], {stdio: "pipe"});
  await runParts({redrive, launch, words: ["view", run], tests});
} finally {
  fs.rmSync(folder, {recursive: true, force: true});
}
