// SPDX-License-Identifier: Apache-2.0
// The part of viewer_test.mjs that looks at the page as a person does: screenshots of its window
// show what `redrive render` writes.
import assert from "node:assert/strict";
import fs from "node:fs";
import path from "node:path";
import {psnr, serve} from "./browser.mjs";
import {renderAsThePageSays, set, settled, text} from "./viewer_page.mjs";

const desktop = {width: 1280, height: 900};
const phone = {width: 390, height: 844};

/** A screenshot of the canvas as it stands in the window; all of it has to be in sight. */
export async function screenshotOfCanvas(page) {
  const [box, window] = await page.evaluate(() => {
    const {x, y, width, height} = document.getElementById("canvas").getBoundingClientRect();
    return [{x, y, width, height}, {width: innerWidth, height: innerHeight}];
  });
  assert.ok(box.x >= 0 && box.y >= 0 && box.x + box.width <= window.width + 1 &&
    box.y + box.height <= window.height + 1, `the image leaves the window: ${JSON.stringify(box)}`);
  return page.screenshot({clip: box, captureBeyondViewport: false});
}

/** The same, compared with a picture in a file: PSNR in dB. */
async function psnrOfScreenshot(page, file) {
  return psnr(page, [await screenshotOfCanvas(page), fs.readFileSync(file)]);
}

/** `street`: the recording of the page's run; `folder`: for files. */
export function seenTests({redrive, folder, street, camera}) {
  const file = path.join(folder, "seen.png");
  const shows = async (page, what, least = 30) => {
    await settled(page);
    fs.rmSync(file, {force: true});
    renderAsThePageSays(redrive, await text(page, "command"), file);
    const db = await psnrOfScreenshot(page, file);
    assert.ok(db >= least, `${what}: PSNR of the window's image and render's: ${db} dB`);
  };
  const canvas = async (page) => (await page.$("#canvas")).boundingBox();
  return {
    async "is seen as render writes it: at the start, after a click, dragged, scrolled"(page) {
      await page.reload();
      await page.waitForFunction(() => window.redriveView?.state);
      await shows(page, "start");
      assert.equal(await page.$eval("#wait", (note) => note.hidden), true);
      const box = await canvas(page);
      await page.mouse.click(box.x + 0.3 * box.width, box.y + 0.7 * box.height);
      await page.waitForFunction(() => window.redriveView.stage.marks.length > 0);
      await shows(page, "after a click", 27); // its mark lies over the image
      await page.mouse.move(box.x + 0.5 * box.width, box.y + 0.5 * box.height);
      await page.mouse.down();
      await page.mouse.move(box.x + 0.5 * box.width + 80, box.y + 0.5 * box.height, {steps: 4});
      await page.waitForFunction(() => !window.redriveView.asks);
      await shows(page, "while it is dragged");
      await page.mouse.up();
      await page.$eval("#help", (last) => last.scrollIntoView());
      await page.evaluate(() => scrollTo(0, 1e6));
      await shows(page, "scrolled to the panel's end");
      await page.click("#home");
      await settled(page);
    },

    async "is seen so upright, on a phone and in the dark"(page) {
      await page.focus("#stage");
      await page.keyboard.press("m");
      await page.waitForFunction(() => window.redriveView.state.mount !== null);
      await settled(page);
      for (const [name, value] of Object.entries({width: 360, height: 640, fov: 40}))
        await set(page, `mount-${name}`, value);
      await shows(page, "upright");
      await page.setViewport(phone);
      await shows(page, "upright on a phone");
      await page.$eval("#help", (last) => last.scrollIntoView());
      await shows(page, "upright on a phone, scrolled");
      await page.select("#camera", camera);
      await page.click("#home");
      await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: "dark"}]);
      await shows(page, "in the dark");
      await page.emulateMediaFeatures([]);
      await page.setViewport(desktop);
      await settled(page);
    },

    async "shows a recording's images"(page, address) {
      const {program, address: recording} = await serve(redrive, ["view", street]);
      try {
        await page.goto(recording);
        await page.waitForFunction(() => window.redriveView?.state);
        await settled(page);
        const at = await page.evaluate(() => window.redriveView.state);
        const name = `${at.camera}_${String(at.frame).padStart(7, "0")}.jpg`;
        const db = await psnrOfScreenshot(
          page, path.join(street, "sensor", "camera", at.camera, name));
        assert.ok(db >= 30, `PSNR of the window's image and the recorded one: ${db} dB`);
      } finally {
        program.kill("SIGINT");
      }
      await page.goto(address);
      await page.waitForFunction(() => window.redriveView?.state);
      await settled(page);
    },

    async "saves what is seen"(page) {
      const client = await page.createCDPSession();
      await client.send("Browser.setDownloadBehavior", {behavior: "allow", downloadPath: folder});
      await page.click("#save-image");
      const {camera: of, frame} = await page.evaluate(() => window.redriveView.state);
      const saved = path.join(folder, `${of}-${frame}.png`);
      while (!fs.existsSync(saved)) await new Promise((resolve) => setTimeout(resolve, 50));
      const db = await psnrOfScreenshot(page, saved);
      assert.ok(db >= 40, `PSNR of the saved image and the window's: ${db} dB`);
    },

    async "jumps on the map, and says how far beside the drive it is"(page) {
      await page.$eval("#drive-map", (map) => map.scrollIntoView({block: "center"}));
      const [first, last] = await page.evaluate(() => {
        const {frames} = window.redriveView.hello;
        return [frames[0].id, frames[frames.length - 1].id];
      });
      const box = await (await page.$("#drive-map")).boundingBox();
      await page.mouse.click(box.x + 2, box.y + box.height / 2); // drives from left to right
      await page.waitForFunction((frame) => window.redriveView.state.frame === frame, {}, first);
      await page.mouse.click(box.x + box.width - 2, box.y + box.height / 2);
      await page.waitForFunction((frame) => window.redriveView.state.frame === frame, {}, last);
      await settled(page);
      const says = (pattern) => page.waitForFunction((source) => new RegExp(source).test(
        document.getElementById("caption").textContent), {}, pattern);
      await says("PSNR \\d+\\.\\d\\d dB against the recorded image");
      await set(page, "left-number", 2);
      await says("beside the drive: 2\\.0 m");
      await says("\\d+ % seen by training images");
      await page.click("#home");
      await settled(page);
    },

    async "explains colours, and names the halves of a comparison"(page) {
      await set(page, "layer", "depth");
      assert.match(await text(page, "legend"), /^depth [\d.]+ m\d+ m, logarithmic$/);
      await set(page, "layer", "coverage");
      assert.match(await text(page, "legend"), /no training image saw it/);
      await set(page, "layer", "image");
      assert.equal(await page.$eval("#legend", (legend) => legend.hidden), true);
      const words = () => page.evaluate(() => {
        const {stage, state} = window.redriveView;
        const drawn = [];
        const {fillText} = CanvasRenderingContext2D.prototype;
        CanvasRenderingContext2D.prototype.fillText = (word) => drawn.push(word);
        stage.draw(state);
        CanvasRenderingContext2D.prototype.fillText = fillText;
        stage.draw(state);
        return drawn;
      });
      assert.deepEqual(await words(), []);
      for (const compare of ["beside", "wipe"]) {
        await set(page, "compare", compare);
        assert.deepEqual(await words(), ["rendered", "recorded"]);
      }
      await set(page, "compare", "off");
    },

    async "keeps an orbit above the ground and near"(page) {
      await page.focus("#stage");
      await page.keyboard.press("o");
      await page.waitForFunction(() => window.redriveView.orbit !== null);
      const box = await canvas(page);
      const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
      await page.mouse.move(x, y);
      for (let i = 0; i < 4; ++i) { // up: the camera goes down
        await page.mouse.down();
        await page.mouse.move(x, y - 0.4 * box.height, {steps: 8});
        await page.mouse.up();
        await page.mouse.move(x, y);
      }
      for (let i = 0; i < 20; ++i) await page.mouse.wheel({deltaY: -2000});
      await settled(page);
      const [height, away] = await page.evaluate(() => {
        const {state, orbit, hello} = window.redriveView;
        const m = hello.cameras.find(({name}) => name === state.camera).body_from_sensor;
        const at = [m[3] + state.forward, m[7] + state.left, m[11] + state.up];
        return [at[2], Math.hypot(...at.map((value, k) => value - orbit.point[k]))];
      });
      assert.ok(height > 0, `${height} m above the body's origin, on the road`);
      assert.ok(away > 0.99 && away < 60, `${away} m from the point`);
      await page.keyboard.press("o");
      await page.click("#home");
      await settled(page);
    },
  };
}
