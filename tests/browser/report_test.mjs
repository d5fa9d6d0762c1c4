// SPDX-License-Identifier: Apache-2.0
// The pages of `redrive figures` and `redrive inspect --report`:
//   node report_test.mjs REDRIVE SAMPLES NODE_MODULES [SHOTS]
// Opens both from the disk in a headless chromium, as wide as a phone and as a desk's screen, light
// and dark. SHOTS: a folder for screenshots. Exit code 77: skipped, there is no chromium.
import assert from "node:assert/strict";
import {execFileSync} from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import {findBrowser, openPage} from "./browser.mjs";

const [redriveFile, samples, modules, shots] = process.argv.slice(2);
const launch = findBrowser(modules);
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "redrive-report-"));
const run = path.join(folder, "run");
const check = path.join(folder, "check");
const redrive = (...words) => execFileSync(redriveFile, words, {stdio: "pipe"}).toString();

/** What a person would miss: wider than the window, cut off, not drawn, hard to read. */
function faults() {
  const found = [];
  const name = (element) => `${element.tagName} ${element.textContent.trim().slice(0, 40)}`;
  if (document.documentElement.scrollWidth > innerWidth)
    found.push(`the page is ${document.documentElement.scrollWidth} pixels wide`);
  for (const element of document.querySelectorAll("body, body *")) {
    const box = element.getBoundingClientRect();
    if (box.right > innerWidth + 0.5 || box.left < 0) found.push(`outside: ${name(element)}`);
    if (getComputedStyle(element).display !== "inline" &&
        element.scrollWidth > element.clientWidth + 1)
      found.push(`cut off: ${name(element)}`);
  }
  for (const image of document.images)
    if (!image.naturalWidth || !image.alt) found.push(`no image, or not described: ${image.alt}`);
  return found;
}

/** Contrast of text and page by WCAG 2. */
function contrast() {
  const luminance = (colour) => {
    const [r, g, b] = colour.match(/[\d.]+/g).slice(0, 3).map((text) => {
      const c = Number(text) / 255;
      return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const page = luminance(getComputedStyle(document.body).backgroundColor);
  return Math.min(...[...document.querySelectorAll("h1, h2, p, td, th, dt, dd, figcaption")]
    .filter((element) => !element.closest(".warning")).map((element) => {
      const ink = luminance(getComputedStyle(element).color);
      return (Math.max(ink, page) + 0.05) / (Math.min(ink, page) + 0.05);
    }));
}

let browser = null;
try {
  redrive("train", path.join(samples, "street"), "--out", run, "--downscale", "8",
    "--holdout-every", "8", "--max-steps", "50", "--threads", "2");
  const printed = redrive("figures", run, "--max-images", "1", "--threads", "2");
  assert.match(printed,
    /^\S+\/run\/report\.html: PSNR [\d.]+ dB, SSIM [\d.]+, FLIP [\d.]+ on 4 held-out images\n$/);
  redrive("inspect", path.join(samples, "street_traffic"), "--report", check);
  browser = await launch([]);
  for (const [file, external] of
    [[path.join(run, "report.html"), 0], [path.join(check, "index.html"), 1]])
    for (const width of [390, 1280])
      for (const scheme of ["light", "dark"]) {
        const page = await openPage(browser);
        const requests = [];
        page.on("request", (request) =>
          request.url().startsWith("data:") || requests.push(request.url()));
        await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: scheme}]);
        await page.setViewport({width, height: 844, isMobile: width < 500});
        await page.goto(`file://${file}`);
        const where = `${path.basename(file)}, ${width} pixels, ${scheme}`;
        if (shots)
          await page.screenshot({fullPage: true,
            path: path.join(shots, `${path.basename(file, ".html")}-${width}-${scheme}.png`)});
        assert.deepEqual(await page.evaluate(faults), [], where);
        assert.ok(await page.evaluate(contrast) >= 4.5, `${where}: text is hard to read`);
        const background =
          await page.$eval("body", (body) => getComputedStyle(body).backgroundColor);
        assert.equal(background, scheme === "dark" ? "rgb(20, 20, 20)" : "rgb(255, 255, 255)");
        if (!external) assert.deepEqual(requests, [`file://${file}`], "one file");
        await page.close();
      }
  const page = await openPage(browser);
  await page.goto(`file://${path.join(run, "report.html")}`);
  const [score, command, images, curves] = await page.evaluate(() =>
    ["p.score", "pre", ".row.large", "figure.plot"].map((of) =>
      document.querySelector(of).getBoundingClientRect().top));
  assert.ok(score < images && images < command && command < curves, "the headline's order");
  // The command of the page makes the same run.
  const words = (await page.$eval("pre", (pre) => pre.textContent)).trim().split(" ");
  assert.equal(words.shift(), "redrive");
  words[words.indexOf("--out") + 1] = `${run}-again`;
  redrive(...words);
  const config = (of) => fs.readFileSync(path.join(of, "config.json"), "utf8");
  assert.equal(config(`${run}-again`), config(run));
  console.log("all passed");
} finally {
  if (browser) await browser.close();
  fs.rmSync(folder, {recursive: true, force: true});
}
