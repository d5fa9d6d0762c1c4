// SPDX-License-Identifier: Apache-2.0
// `redrive view` in a real browser: node viewer_test.mjs REDRIVE SAMPLES NODE_MODULES [SHOTS]
// Trains a small run of the sample street, opens its page in a headless chromium and uses it.
// SHOTS: a folder for screenshots. Exit code 77: skipped, there is no chromium.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import {findBrowser, openPage, serve, status} from "./browser.mjs";
import {dragTests} from "./viewer_drags.mjs";
import {seenTests} from "./viewer_seen.mjs";
import {psnrOfPage, renderAsThePageSays, runParts, set, settled, text}
  from "./viewer_page.mjs";

const [redrive, samples, modules, shots] = process.argv.slice(2);
const launch = findBrowser(modules);
const street = path.join(samples, "street");
const camera = "F_MIDLONGRANGECAM_CL";
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-browser-"));
const run = path.join(folder, "run");

function trainWords(out, steps) {
  return ["train", street, "--out", out, "--truth-poses", "--method", "splat", "--cameras", camera,
    "--frames", "1016:1040", "--holdout-every", "4", "--max-steps", String(steps),
    "--max-gaussians", "60000", "--threads", "2"];
}

/** Names of the path's keys. */
const keyLabels = (page) => page.$$eval("#path-keys li",
  (rows) => rows.map((row) => row.querySelector("button").textContent));

const tests = {
  async "opens with an image"(page) {
    await settled(page);
    assert.match(await text(page, "run"), /splat, step 120/);
    assert.match(await text(page, "timing"), /480 x 264/);
  },

  async "shows what render writes"(page) {
    await set(page, "left-number", 1);
    await set(page, "yaw-number", -12.5);
    await set(page, "pitch-number", 3);
    const file = path.join(folder, "view.png");
    const command = await text(page, "command");
    assert.match(command, /--translate=0,1,0 --yaw=-12.5 --pitch=3/);
    renderAsThePageSays(redrive, command, file);
    const db = await psnrOfPage(page, file);
    assert.ok(db >= 35, `PSNR of the page's image and render's: ${db} dB`);
  },

  async "scrubs, slides and goes back to the car"(page) {
    await set(page, "frame", 20);
    assert.equal(await page.evaluate(() => window.redriveView.state.frame), 1036);
    assert.match(page.url(), /frame=1036/);
    await set(page, "left-range", -2);
    assert.match(page.url(), /left=-2/);
    await page.click("#home");
    await settled(page);
    assert.doesNotMatch(page.url(), /left=/);
    await page.focus("#stage");
    await page.keyboard.press("ArrowLeft");
    await page.waitForFunction(() => window.redriveView.state.frame === 1035);
    await page.keyboard.press("Space");
    await page.waitForFunction(() => window.redriveView.state.frame !== 1035);
    await page.keyboard.press("Space");
    await page.keyboard.press("Home");
    await page.waitForFunction(() => window.redriveView.state.frame === 1016);
    await settled(page);
  },

  async "flies and orbits"(page) {
    await page.focus("#stage");
    await page.keyboard.down("w");
    await page.waitForFunction(() => window.redriveView.state.forward > 0.5);
    await page.keyboard.up("w");
    await settled(page);
    await page.click("#orbit");
    await page.waitForFunction(() => window.redriveView.orbit !== null);
    const target = await page.evaluate(() => [...window.redriveView.orbit.point]);
    const box = await (await page.$("#canvas")).boundingBox();
    const middle = {x: box.x + box.width / 2, y: box.y + box.height / 2};
    await page.mouse.move(middle.x, middle.y);
    await page.mouse.down();
    await page.mouse.move(middle.x + 40, middle.y, {steps: 4});
    await page.mouse.up();
    await settled(page);
    const moved = await page.evaluate(() => window.redriveView.state);
    assert.ok(Math.abs(moved.yaw) > 5 && Math.abs(moved.left) > 0.1);
    // The camera still looks at the point: it lies on the ray of the middle of the image.
    await page.evaluate(() => {
      window.redriveView.picked = null;
      window.redriveView.pick({u: 0.5, v: 0.5});
    });
    await page.waitForFunction(() => window.redriveView.picked !== null);
    const offset = await page.evaluate((point) => {
      const {picked, state, hello} = window.redriveView;
      const mount = hello.cameras.find(({name}) => name === state.camera).body_from_sensor;
      const eye = [mount[3] + state.forward, mount[7] + state.left, mount[11] + state.up];
      const ray = picked.body_m.map((x, k) => x - eye[k]);
      const way = point.map((x, k) => x - eye[k]);
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      return Math.acos(dot(ray, way) / Math.sqrt(dot(ray, ray) * dot(way, way)));
    }, target);
    assert.ok(offset < 0.01, `the point is ${offset} rad off the middle after the turn`);
    await page.click("#orbit");
    await page.keyboard.press("b");
    await settled(page);
  },

  async "compares with the recorded image"(page) {
    await set(page, "truth", "held-out/1032");
    assert.equal(await page.$eval("#compare", (field) => field.value), "beside");
    await page.waitForFunction(
      () => /PSNR \d+\.\d\d dB/.test(document.getElementById("caption").textContent));
    const shown = Number(/PSNR ([\d.]+)/.exec(await text(page, "caption"))[1]);
    assert.ok(shown > 15 && shown < 40, `PSNR of a held-out frame: ${shown} dB`);
    const pixel = () => page.evaluate(() => {
      const {width, height} = document.getElementById("canvas");
      const context = document.getElementById("canvas").getContext("2d");
      return [...context.getImageData(0.8 * width, 0.8 * height, 1, 1).data];
    });
    await set(page, "compare", "wipe");
    await set(page, "share", 1); // the recorded image alone
    const recorded = await pixel();
    await set(page, "share", 0);
    const rendered = await pixel();
    await set(page, "compare", "difference");
    const difference = await pixel();
    for (let c = 0; c < 3; ++c) {
      const expected = Math.min(255, 4 * Math.abs(recorded[c] - rendered[c]));
      assert.ok(Math.abs(difference[c] - expected) <= 8, `${recorded} ${rendered} ${difference}`);
    }
    await set(page, "truth", "novel/2/left_0.5");
    await page.waitForFunction(() => /PSNR/.test(document.getElementById("caption").textContent));
    await set(page, "compare", "off");
    await page.click("#home");
    await settled(page);
  },

  async "finds a point and a distance"(page) {
    const {u, v, depth_m} = parkedCar();
    await set(page, "truth", "novel/3/forward_0.5");
    await set(page, "compare", "off");
    const box = await (await page.$("#canvas")).boundingBox();
    await page.mouse.click(box.x + u * box.width, box.y + v * box.height);
    await page.waitForFunction(() => window.redriveView.stage.marks.length > 0);
    const picked = await page.evaluate(() => window.redriveView.picked);
    assert.ok(Math.abs(picked.depth_m - depth_m) < 0.05,
      `depth ${picked.depth_m} m, ground truth ${depth_m} m`);
    const point = await text(page, "point");
    for (const name of ["depth", "body", "world", "ECEF", "WGS 84"])
      assert.ok(point.includes(name), point);
    await page.waitForFunction(
      () => /^[1-9]\d* of 18 training images/.test(document.getElementById("seen").textContent));
    await page.mouse.click(box.x + (u + 0.1) * box.width, box.y + v * box.height);
    // Until it is answered, the panel shows the first point.
    await page.waitForFunction(
      (first) => window.redriveView.picked.pixel[0] !== first, {}, picked.pixel[0]);
    assert.match(await text(page, "point"), /to the point before/);
    await page.waitForSelector("#seen button");
    // One call: a mouse would miss the button if the panel moved between its two steps.
    const named = await page.$eval("#seen button", (button) => {
      button.click();
      return button.textContent;
    });
    await settled(page);
    const {camera: there, frame} = await page.evaluate(() => window.redriveView.state);
    assert.ok(named.startsWith(`${there} ${frame}, `), `${named}: ${there} ${frame}`);
    assert.equal(await page.evaluate(() => window.redriveView.state.novel), null);
  },

  async "shows the view of a mount of one's own"(page) {
    await set(page, "left-number", 0.5);
    await set(page, "yaw-number", 10);
    const before = await page.evaluate(() => window.redriveView.stage.image.header.full_width);
    await page.focus("#stage");
    await page.keyboard.press("m");
    await page.waitForFunction(() => window.redriveView.state.mount !== null);
    await settled(page);
    // The mount stands where the view was, with a lens of its own.
    const {mount, left} = await page.evaluate(() => window.redriveView.state);
    assert.equal(left, 0);
    assert.equal(mount.lens, "pinhole:90:1280x704");
    assert.ok(Math.abs(mount.yaw - 10) < 3, `yaw ${mount.yaw}`);
    assert.notEqual(await page.evaluate(
      () => window.redriveView.stage.image.header.full_width), before);
    await set(page, "mount-width", 640);
    await set(page, "mount-height", 352);
    await set(page, "mount-fov", 70);
    await set(page, "mount-roll", 15);
    await set(page, "mount-yaw", -5.5);
    await set(page, "up-number", 0.25);
    const command = await text(page, "command");
    assert.match(command, /--mount=[-\d.,]+,-5.5,[-\d.]+,15 --lens pinhole:70:640x352 --frame/);
    const file = path.join(folder, "mount.png");
    renderAsThePageSays(redrive, command, file);
    const db = await psnrOfPage(page, file);
    assert.ok(db >= 35, `PSNR of the page's image and render's: ${db} dB`);
    // Keys of a number field: one step up.
    await page.focus("#mount-x");
    const x = await page.$eval("#mount-x", (field) => Number(field.value));
    await page.keyboard.press("ArrowUp");
    await page.waitForFunction((least) => window.redriveView.state.mount.x > least, {}, x);
    await settled(page);  // its address has the state
    const address = page.url();
    await page.reload();
    await page.waitForFunction(() => window.redriveView?.state?.mount);
    await settled(page);
    assert.equal(page.url(), address);
    await set(page, "mount-lens", camera);
    assert.match(await text(page, "timing"), /480 x 264/);
    assert.equal(await page.$eval("#mount-fov", (field) => field.offsetParent), null);
    await set(page, "camera", camera);
    assert.equal(await page.evaluate(() => window.redriveView.state.mount), null);
    await page.click("#home");
    await settled(page);
  },

  async "shows layers and overlays"(page) {
    await set(page, "frame", 4); // much of the drive lies ahead
    for (const layer of ["depth", "normals", "opacity", "coverage", "actors", "image"])
      await set(page, "layer", layer);
    for (const overlay of ["trajectory", "frusta", "lidar"]) // the street has no boxes
      await page.click(`#overlays input[value="${overlay}"]`);
    await page.waitForFunction(() => window.redriveView.stage.image.points.length > 600);
    const kinds = await page.evaluate(
      () => [...new Set(window.redriveView.stage.image.header.lines.map(({kind}) => kind))]);
    assert.ok(kinds.includes("trajectory"), `${kinds}`);
    assert.match(page.url(), /over=trajectory%2Cfrusta%2Clidar/);
    await page.click('#overlays input[value="cloud"]');
    await page.waitForFunction(() => { // points of the cloud come as they are read
      const {points} = window.redriveView.stage.image;
      let cloud = 0;
      for (let i = 5; i < points.length; i += 6) cloud += points[i] === 0;
      return cloud > 5000;
    });
    await page.click('#overlays input[value="cloud"]');
    await page.click('#overlays input[value="masks"]');
    await page.waitForFunction(
      () => /\d % masked/.test(document.getElementById("caption").textContent));
    await page.click('#overlays input[value="masks"]');
    await settled(page);
  },

  async "shows a rendered LiDAR scan"(page) {
    const kinds = () => page.evaluate(() => {
      const {points} = window.redriveView.stage.image;
      return [0, 1, 2].map((kind) => points.filter((value, i) => i % 6 === 5 && value === kind).length);
    });
    const [, recorded] = await kinds();
    await set(page, "scan", "recorded");
    await set(page, "scan-colour", "error");
    const [, , rendered] = await kinds();
    assert.ok(rendered > 0.8 * recorded && rendered < 1.1 * recorded, `${rendered}, ${recorded}`);
    assert.match(await text(page, "caption"), /scan: \d+ of \d+ rays return, median error \d/);
    assert.match(await text(page, "legend"), /error 1 cm/);
    assert.match(page.url(), /scan=recorded%2Cerror/);
    await set(page, "scan", "vlp-16"); // nobody recorded its ranges
    assert.equal(await page.$eval("#scan-colour", (field) => field.value), "range");
    assert.ok((await kinds())[2] > 500);
    await set(page, "scan-colour", "intensity");
    assert.match(await text(page, "legend"), /intensity 0/);
    await set(page, "scan", "");
    assert.equal((await kinds())[2], 0);
  },

  async "comes back from its address"(page) {
    const address = page.url();
    await page.reload();
    await page.waitForFunction(() => window.redriveView?.state?.overlays.size === 3);
    await settled(page);
    assert.equal(page.url(), address);
  },

  async "makes a path, saves it and renders it"(page) {
    await set(page, "layer", "image");
    for (const overlay of ["trajectory", "frusta", "lidar"])
      await page.click(`#overlays input[value="${overlay}"]`);
    await set(page, "frame", 4);
    await page.click("#path-add");
    await set(page, "left-number", 1);
    await set(page, "yaw-number", 10);
    await page.click("#path-add");
    await set(page, "frame", 12);
    await page.click("#path-add");
    assert.deepEqual(await keyLabels(page),
      [`1020 ${camera}`, `1020 ${camera}, moved`, `1028 ${camera}, moved`]);
    await page.click("#path-keys li:nth-child(3) [title='Earlier: view']");
    assert.equal((await keyLabels(page))[1], `1028 ${camera}, moved`);
    await page.click("#path-keys li:nth-child(3) [title='Delete view']");
    // One call: the preview ends by itself.
    assert.equal(await page.$eval("#path-play", (button) => {
      button.click();
      return button.textContent;
    }), "Stop");
    await page.waitForFunction(
      () => document.getElementById("path-play").textContent === "Preview");
    await settled(page);

    await page.$eval("#path-keys li:nth-child(2) input", (field) => {
      field.value = "0.5";
      field.dispatchEvent(new Event("change"));
    });
    assert.match(await text(page, "path-note"), /2 views, 0.50 s/);
    await set(page, "path-name", "../left");
    await page.click("#path-save");
    assert.match(await text(page, "path-note"), /letters, digits/);
    await set(page, "path-name", "left");
    await page.click("#path-save");
    await page.waitForFunction(
      () => /^Saved/.test(document.getElementById("path-note").textContent));
    await page.click("#path-save");
    assert.match(await text(page, "path-note"), /exists/);

    // Its last image is the image of its last key.
    const command = await text(page, "path-command");
    assert.equal(command,
      `redrive render path ${run} ${run}/paths/left.json --out left.mp4`);
    const images = path.join(folder, "left");
    renderAsThePageSays(redrive, command, images);
    assert.equal(fs.readdirSync(images).filter((name) => name.endsWith(".png")).length, 12);
    await page.click("#path-keys li:nth-child(2) [title='Show view']");
    await page.waitForFunction(() => window.redriveView.state.frame === 1028);
    await settled(page);
    const db = await psnrOfPage(page, path.join(images, "000011.png"));
    assert.ok(db >= 30, `PSNR of the page's image and the path's last one: ${db} dB`);
    try {
      renderAsThePageSays(redrive, command, path.join(folder, "left.mp4"));
      assert.ok(fs.statSync(path.join(folder, "left.mp4")).size > 1000);
    } catch (error) {
      assert.match(String(error.stderr), /FFmpeg/);
    }

    await page.reload();
    await page.waitForFunction(() => window.redriveView?.state);
    await page.waitForFunction(() => !document.getElementById("path-load").disabled);
    await page.select("#path-load", "left");
    await page.waitForFunction(() => document.querySelectorAll("#path-keys li").length === 2);
    assert.equal(await text(page, "path-command"), command);

    // A path that was loaded is saved in another order.
    const noted = (pattern) => page.waitForFunction((source) => new RegExp(source).test(
      document.getElementById("path-note").textContent), {}, pattern);
    await page.click("#path-keys li:nth-child(2) [title='Earlier: view']");
    await page.click("#path-save");
    await page.click("#path-save");
    await noted("^Saved");
    // Nothing is sent that the program would refuse.
    const file = path.join(run, "paths/left.json");
    const saved = JSON.parse(fs.readFileSync(file, "utf8"));
    saved.keyframes[1].time_s = 3599;
    fs.writeFileSync(file, JSON.stringify(saved));
    await page.select("#path-load", "left");
    await noted("3599.00 s");
    await page.click("#path-add");
    await page.click("#path-play");
    await noted("^At most 3600 s");
    await page.click("#home");
    await settled(page);
  },

  ...dragTests({set, settled, labels: keyLabels}),

  ...seenTests({redrive, folder, street, camera}),

  async "fits a narrow page"(page) {
    await page.setViewport({width: 360, height: 740});
    await page.waitForFunction(() => document.documentElement.scrollWidth <= 360, {timeout: 5000});
    await page.setViewport({width: 1280, height: 900});
  },

  async "follows the run"(page) {
    const checkpoint = path.join(run, "checkpoint.safetensors");
    const moved = path.join(folder, "moved");
    fs.renameSync(run, moved);
    const noticed = (pattern) => page.waitForFunction(
      (source) => new RegExp(source).test(document.getElementById("notice").textContent), {},
      pattern);
    await noticed("run is gone");
    await set(page, "frame", 3); // what was loaded is still there
    fs.renameSync(moved, run);
    await noticed("^$");
    const {size} = fs.statSync(checkpoint);
    fs.copyFileSync(checkpoint, `${checkpoint}.whole`);
    fs.truncateSync(checkpoint, size / 2);
    await noticed("cannot be shown");
    fs.renameSync(`${checkpoint}.whole`, checkpoint);
    await noticed("^$");
    execFileSync(redrive, ["resume", run, "--max-steps", "140"], {stdio: "pipe"});
    await page.waitForFunction(
      () => /step 140, loaded \d/.test(document.getElementById("run").textContent));
    await settled(page);
  },

  async "shows a run that trains"(page, address) {
    const {program, address: live} =
      await serve(redrive, [...trainWords(path.join(folder, "live"), 100000), "--view"]);
    try {
      await page.goto(live);
      assert.match(await text(page, "wait"), /redrive|Preparing|Training/); // and no black image
      const label = (pattern) => page.waitForFunction((source) => new RegExp(source).test(
        document.getElementById("training-label")?.textContent ?? ""), {}, pattern);
      await label("^step [1-9]\\d* of 100000, \\d+ s of training$");
      await page.waitForSelector("#training polyline.psnr"); // 50 steps
      await page.click("#pause");
      await label("paused$");
      const step = () => page.$eval(
        "#training-label", (element) => Number(/\d+/.exec(element.textContent)[0]));
      const before = await step();
      await set(page, "left-number", 1); // images are made while it waits
      assert.equal(await step(), before);
      await page.focus("#pause");
      await page.keyboard.press("Enter");
      await label("training$");
      await page.waitForFunction((least) => Number(/\d+/.exec(
        document.getElementById("training-label").textContent)[0]) > least, {}, before);
    } finally {
      program.kill("SIGINT");
      await new Promise((resolve) => program.on("exit", resolve));
    }
    await page.goto(address);
    await page.waitForFunction(() => window.redriveView?.state);
    await settled(page);
    assert.match(await text(page, "curve-label"), /^PSNR of training rays/);
    assert.equal(await page.$eval("#pause", (button) => button.offsetParent), null);
  },

  async "opens by a file that this user alone can read"() {
    const opened = path.join(folder, "opened");
    fs.mkdirSync(path.join(folder, "bin"));
    fs.writeFileSync(path.join(folder, "bin", "xdg-open"),
      `#!/bin/sh\nprintf '%s ' "$@" $(stat -c %a "$1") >${opened}.part\n` +
      `mv ${opened}.part ${opened}\n`, {mode: 0o755});
    const {program, address} = await serve(redrive, ["view", street, "--open"],
      {env: {...process.env, PATH: `${path.join(folder, "bin")}:${process.env.PATH}`}});
    while (!fs.existsSync(opened)) await new Promise((resolve) => setTimeout(resolve, 50));
    const [file, mode, ...more] = fs.readFileSync(opened, "utf8").trim().split(" ");
    assert.deepEqual([mode, more], ["600", []]);
    assert.ok(!file.includes(new URL(address).pathname), "the token is in no argument");
    assert.ok(fs.readFileSync(file, "utf8").includes(`url=${address}"`));
    program.kill("SIGINT");
    await new Promise((resolve) => program.on("exit", resolve));
    assert.ok(!fs.existsSync(file));
  },

  async "refuses strangers"(_page, address) {
    assert.equal(await status(address), 200);
    const {origin, host} = new URL(address);
    assert.equal(await status(`${origin}/00000000000000000000000000000000/`), 404);
    assert.equal(await status(address, {Origin: "http://example.org"}), 403);
    assert.equal(await status(address, {Host: "example.org"}), 403);
    assert.ok(host);
  },
};

/** Pixel (335, 160), a parked car, in the ground truth of novel/forward_0.5 at frame 1028: 9504 in
 * its image of depth. */
function parkedCar() {
  return {u: 335.5 / 480, v: 160.5 / 264, depth_m: 9.504};
}

async function shoot(browser, address) {
  for (const [width, height] of [[1280, 900], [360, 740]])
    for (const scheme of ["light", "dark"]) {
      const page = await openPage(browser);
      await page.setViewport({width, height});
      await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: scheme}]);
      await page.goto(`${address}#camera=${camera}&frame=1032&left=1&compare=beside`);
      await page.waitForFunction(() => window.redriveView?.state);
      await settled(page);
      await page.screenshot({path: path.join(shots, `${width}-${scheme}.png`), fullPage: true});
      await page.close();
    }
}

try {
  execFileSync(redrive, trainWords(run, 120), {stdio: "pipe"});
  await runParts({redrive, launch, words: ["view", run], tests,
    after: (browser, address) => shots && shoot(browser, address)});
} finally {
  fs.rmSync(folder, {recursive: true, force: true});
}
