// SPDX-License-Identifier: Apache-2.0
// What the tests of the viewer's page share.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import {openPage, psnr, serve} from "./browser.mjs";

/** Waits until the page shows the full image of its state. */
export async function settled(page) {
  await page.waitForFunction(() => {
    const {stage, id, asks, state} = window.redriveView;
    const header = stage.image?.header;
    return !asks && header?.id === id && header.factor === 1 &&
      (state.compare === "off" || stage.reference);
  });
}

/** Sets a field as a user does. */
export async function set(page, id, value) {
  await page.$eval(`#${id}`, (field, text) => {
    field.value = text;
    field.dispatchEvent(new Event("input", {bubbles: true}));
    field.dispatchEvent(new Event("change", {bubbles: true}));
  }, String(value));
  // The next tick asks for the image.
  await page.waitForFunction(() => !window.redriveView.asks);
  await settled(page);
}

export const text = (page, id) => page.$eval(`#${id}`, (element) => element.textContent);

/** PSNR of the page's image and a PNG, in dB. */
export async function psnrOfPage(page, file) {
  const shown = await page.evaluate(() => {
    const {bitmap} = window.redriveView.stage.image;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
    return canvas.toDataURL("image/png").split(",")[1];
  });
  const files = [Buffer.from(shown, "base64"), fs.readFileSync(file)];
  const sizes = files.map((png) => [png.readUInt32BE(16), png.readUInt32BE(20)]);
  assert.deepEqual(sizes[0], sizes[1]);
  return psnr(page, files);
}

/** Renders by the command that the page gives, into `file`; `edit` takes the place of its
 * EDIT.json. */
export function renderAsThePageSays(redrive, command, file, edit) {
  const words = command.split(" ").slice(1);
  words[words.indexOf("--out") + 1] = file;
  if (edit) words[words.indexOf("--edit") + 1] = edit;
  execFileSync(redrive, words, {stdio: "pipe"});
}

/** Runs the parts of a test one after another in a page of `redrive WORDS`, and ends the process.
 * `after`: called with the browser and the page's address. */
export async function runParts({redrive, launch, words, tests, after}) {
  let program = null, browser = null, failed = 0;
  try {
    const served = await serve(redrive, words);
    program = served.program;
    browser = await launch(["--disable-gpu"]);
    const page = await openPage(browser);
    const errors = [];
    page.on("pageerror", (error) => errors.push(String(error)));
    page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
    await page.setViewport({width: 1280, height: 900});
    await page.goto(served.address);
    await page.waitForFunction(() => window.redriveView?.state);
    for (const [name, test] of Object.entries(tests)) {
      const start = Date.now();
      try {
        await test(page, served.address, browser);
        assert.deepEqual(errors.splice(0), []);
        console.log(`ok: ${name} (${Date.now() - start} ms)`);
      } catch (error) {
        ++failed;
        console.log(`FAILED: ${name}: ${error.stack}`);
      }
    }
    await after?.(browser, served.address);
  } finally {
    await browser?.close();
    program?.kill("SIGINT");
  }
  process.exitCode = failed ? 1 : 0;
}
