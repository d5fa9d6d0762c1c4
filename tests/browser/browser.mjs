// SPDX-License-Identifier: Apache-2.0
// What the tests in a browser share.
import {spawn} from "node:child_process";
import fs from "node:fs";
import http from "node:http";
import {createRequire} from "node:module";
import path from "node:path";

/** Ends the test as skipped. */
export function skip(why) {
  console.log(`skipped: ${why}`);
  process.exit(77);
}

/** Returns a function that starts a headless chromium; skips the test where there is none. */
export function findBrowser(modules) {
  const chromium = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"]
    .find((file) => fs.existsSync(file));
  if (!chromium) skip("there is no chromium (scripts/setup installs it)");
  if (!fs.existsSync(path.join(modules, "puppeteer-core")))
    skip("npm could not install puppeteer-core when this was built");
  const puppeteer = createRequire(path.resolve(modules, "x.js"))("puppeteer-core");
  // The first start reads hundreds of megabytes from a disk that may be cold and busy: ctest's
  // limit is the one that counts.
  return (flags) => puppeteer.launch({
    executablePath: chromium, headless: true, timeout: 0,
    args: ["--no-sandbox", "--disable-dev-shm-usage", ...flags]});
}

/** Opens a page whose waits are long: how fast this machine is at the moment is no test. */
export async function openPage(browser) {
  const page = await browser.newPage();
  page.setDefaultTimeout(120000);
  return page;
}

/** PSNR of two PNGs, in dB; the second one is scaled to the size of the first. */
export function psnr(page, pngs) {
  return page.evaluate(async (texts) => {
    const images = await Promise.all(texts.map(async (text) => {
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      return createImageBitmap(new Blob([bytes]));
    }));
    const [{width, height}] = images;
    const pixels = images.map((image) => {
      const context = new OffscreenCanvas(width, height).getContext("2d");
      context.drawImage(image, 0, 0, width, height);
      return context.getImageData(0, 0, width, height).data;
    });
    let sum = 0;
    for (let i = 0; i < pixels[0].length; ++i)
      if (i % 4 !== 3) sum += (pixels[0][i] - pixels[1][i]) ** 2;
    return 10 * Math.log10(255 ** 2 / (sum / (0.75 * pixels[0].length)));
  }, pngs.map((png) => Buffer.from(png).toString("base64")));
}

/** Starts the program and returns it with the address that it prints. `more`: options of spawn. */
export async function serve(redrive, words, more = {}) {
  const program =
    spawn(redrive, [...words, "--port", "0"], {stdio: ["ignore", "pipe", "pipe"], ...more});
  let printed = "";
  const address = await new Promise((resolve, reject) => {
    program.stdout.on("data", (bytes) => {
      printed += bytes;
      const found = /http:\/\/\S+/.exec(printed);
      if (found) resolve(found[0]);
    });
    program.stderr.on("data", (bytes) => (printed += bytes));
    program.on("exit",
      (code) => reject(new Error(`redrive ${words[0]} ended with ${code}: ${printed}`)));
  });
  return {program, address};
}

/** Returns the status of the answer to a GET. */
export function status(address, headers = {}) {
  return new Promise((resolve, reject) => {
    http.get(address, {headers}, (response) => {
      response.resume();
      resolve(response.statusCode);
    }).on("error", reject);
  });
}
