// SPDX-License-Identifier: Apache-2.0
// The part of viewer_test.mjs in which a mouse drags: the keys of a path, and the own mount.
import assert from "node:assert/strict";

async function middle(page, selector) {
  const box = await (await page.$(selector)).boundingBox();
  return {x: box.x + box.width / 2, y: box.y + box.height / 2, height: box.height};
}

/** Waits until an element is in sight and has not moved for three frames: a page lays itself out
    anew some frames after its window has another size. */
async function restsInSight(page, selector) {
  await page.waitForFunction(async (sought) => {
    const element = document.querySelector(sought);
    element.scrollIntoView({block: "center"});
    const corner = () => element.getBoundingClientRect();
    const before = corner();
    for (let frame = 0; frame < 3; ++frame)
      await new Promise((next) => requestAnimationFrame(next));
    const {x, y, width, height} = corner();
    const hit = document.elementFromPoint(x + width / 2, y + height / 2);
    return x === before.x && y === before.y && (hit === element || element.contains(hit));
  }, {}, selector);
}

/** Drags the middle of an element by pixels. */
async function drag(page, selector, right, down) {
  let x, y;
  do { // an image that arrives meanwhile may move the element from under the pointer
    await restsInSight(page, selector);
    ({x, y} = await middle(page, selector));
    await page.mouse.move(x, y);
  } while (!await page.$eval(selector, (element, ...at) =>
    element.contains(document.elementFromPoint(...at)), x, y));
  await page.mouse.down();
  await page.mouse.move(x + right, y + down, {steps: 4});
  await page.mouse.up();
}

/** Helpers of viewer_test.mjs: `set` and `settled`, and `labels`, the names of the path's keys. */
export function dragTests({set, settled, labels}) {
  return {
    async "drags the keys of a path"(page) {
      await page.reload(); // an empty path
      await page.waitForFunction(() => window.redriveView?.state);
      for (const frame of [2, 4, 6]) {
        await set(page, "frame", frame);
        await page.click("#path-add");
      }
      const [a, b, c] = await labels(page);
      const row = (n) => middle(page, `#path-keys li:nth-child(${n})`);
      const pitch = (await row(2)).y - (await row(1)).y;
      const grip = (n) => `#path-keys li:nth-child(${n}) .grip`;
      await drag(page, grip(1), 0, 1.2 * pitch);
      assert.deepEqual(await labels(page), [b, a, c]);
      await drag(page, grip(3), 30, -5 * pitch); // beyond the list's end
      assert.deepEqual(await labels(page), [c, b, a]);
      await drag(page, grip(2), 0, 0.3 * pitch); // not far enough
      assert.deepEqual(await labels(page), [c, b, a]);
      assert.equal((await page.$$("#path-keys li:first-child input")).length, 0);
      assert.equal((await page.$$("#path-keys .dragged, .drop-before, .drop-after")).length, 0);
    },

    async "drags the own mount in the drawing of the car"(page) {
      await page.click("#home");
      await page.focus("#stage");
      await page.keyboard.press("m");
      await page.waitForSelector("#car-plan", {visible: true});
      for (const [name, value] of Object.entries({x: 1.25, y: 0, yaw: 0}))
        await set(page, `mount-${name}`, value);
      const mount = () => page.evaluate(() => window.redriveView.state.mount);
      const cameras = await page.evaluate(() => window.redriveView.hello.cameras.length);
      assert.equal((await page.$$("#car-plan circle.camera")).length, cameras);
      assert.equal((await page.$$("#car-plan text")).length, cameras);
      // The drawing shows 3.25 m to each side; a field that has the focus follows, too.
      const {height} = await middle(page, "#car-plan");
      const pixels = height / 6.5;
      await page.focus("#mount-x");
      await drag(page, "#mount-dot", -pixels, -1.5 * pixels);
      let {x, y, yaw} = await mount();
      assert.ok(Math.abs(x - 2.75) < 0.05 && Math.abs(y - 1) < 0.05, `x ${x}, y ${y}`);
      assert.equal(yaw, 0);
      const field = (name) => page.$eval(`#mount-${name}`, (input) => Number(input.value));
      assert.deepEqual([await field("x"), await field("y")], [x, y]);
      // From straight ahead to the left, and no further than the drawing.
      const dot = await middle(page, "#mount-dot");
      const tip = await middle(page, "#mount-tip");
      await drag(page, "#mount-tip", tip.y - dot.y, dot.y - tip.y);
      ({yaw} = await mount());
      assert.ok(Math.abs(yaw - 90) <= 2, `yaw ${yaw}`);
      assert.equal(await field("yaw"), yaw);
      await drag(page, "#mount-dot", 0, 100 * pixels);
      assert.equal((await mount()).x, 1.25 - 3.25);
      await settled(page);
      await page.setViewport({width: 360, height: 740});
      await settled(page);
      await drag(page, "#mount-dot", 0, -20);
      assert.ok((await mount()).x > 1.25 - 3.25);
      const width = await page.evaluate(() => document.documentElement.scrollWidth);
      assert.ok(width <= 360, `the page is ${width} px wide`);
      await page.setViewport({width: 1280, height: 900});
      await page.click("#home");
      await page.select("#camera", await page.$eval("#camera", (list) => list.options[0].value));
      await settled(page);
    },
  };
}
