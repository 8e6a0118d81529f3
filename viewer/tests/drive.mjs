// Use a page of one object as people do, in headless Chromium: node drive.mjs PAGE [FOLDER for pictures]
import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { open } from "./browser.mjs";

const [, , file, pictures] = process.argv;
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const WAIT = { timeout: 120_000 };
const SIZES = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844, hasTouch: true } };

/** Do something, and remember what was answered before it. */
async function answered(page, act) {
  const before = await page.evaluate(() => {
    window.seen = { sound: window.objectfolder.lastSound, touch: window.objectfolder.lastTouch };
    return document.getElementById("touch").toDataURL();
  });
  await act();
  return { before, after: () => page.evaluate(() => document.getElementById("touch").toDataURL()) };
}

const struck = (page) =>
  page.waitForFunction(() => window.objectfolder.lastSound !== window.seen.sound, null, WAIT);
const felt = (page) =>
  page.waitForFunction(() => window.objectfolder.lastTouch !== window.seen.touch, null, WAIT);

async function middle(page) {
  const box = await page.locator("#view").boundingBox();
  return [box.x + box.width / 2, box.y + box.height / 2];
}

const click = (page, x, y) => page.mouse.click(x, y);

async function strike(page) {
  const [x, y] = await middle(page);
  const { before, after } = await answered(page, () => click(page, x, y));
  await struck(page);
  await felt(page);
  assert.notEqual(await after(), before, "the tactile image changes");
  await sounds(page);
}

const sounds = (page) =>
  page.waitForFunction(() => window.objectfolder.player.state === "running", null, WAIT);

/**
 * Tap the object, as the first gesture on the page. The answers come while the finger is down, when browsers do not
 * yet allow sound. Playwright's evaluations count as gestures, so the page is asked without them.
 */
async function firstTap(page) {
  const session = await page.context().newCDPSession(page);
  const ask = async (expression) =>
    (await session.send("Runtime.evaluate", { expression, returnByValue: true })).result.value;
  const until = async (expression) => {
    for (
      const start = Date.now();
      !(await ask(expression));
      await new Promise((done) => setTimeout(done, 50))
    )
      assert.ok(Date.now() - start < WAIT.timeout, `waited for ${expression}`);
  };
  await until("!!window.objectfolder?.times.bounced");
  const [x, y] = await ask(`(() => {
    const { left, top, width, height } = document.getElementById("view").getBoundingClientRect();
    return [left + width / 2, top + height / 2];
  })()`);
  const touch = (type, touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
  await touch("touchStart", [{ x, y }]);
  await until("!!(window.objectfolder.lastSound && window.objectfolder.lastTouch)");
  assert.equal(await ask("window.objectfolder.player.state"), "none");
  await touch("touchEnd", []);
  await until('window.objectfolder.player.state === "running"');
}

/** Save the sound and the picture. */
async function save(page) {
  for (const [id, start] of [
    ["save-sound", "RIFF"],
    ["save-view", "\x89PNG"],
  ]) {
    const [saved] = await Promise.all([
      page.waitForEvent("download", WAIT),
      page.locator(`#${id}`).press("Enter"),
    ]);
    assert.ok(readFileSync(await saved.path(), "latin1").startsWith(start), `${id} saves its format`);
  }
}

async function use(page) {
  await strike(page);
  await save(page);
  const sound = await page.evaluate(() => {
    const { samples, rate, tones } = window.objectfolder.lastSound;
    // Power of the sound at a frequency, by Goertzel's algorithm.
    const power = (hertz) => {
      const factor = 2 * Math.cos((2 * Math.PI * hertz) / rate);
      let [a, b] = [0, 0];
      for (const value of samples) [a, b] = [value + factor * a - b, a];
      return a * a + b * b - factor * a * b;
    };
    const everywhere = Array.from({ length: 200 }, (_, n) => power(50 * 300 ** (n / 199))).sort(
      (a, b) => a - b,
    );
    return {
      peak: samples.reduce((most, value) => Math.max(most, Math.abs(value)), 0),
      own: power(tones[0].frequency),
      usual: everywhere[100],
    };
  });
  assert.ok(sound.peak > 0, "the sound is not silent");
  assert.ok(sound.own > 10 * sound.usual, "its loudest tone is at the frequency that is shown");

  const [x, y] = await middle(page);
  let step = await answered(page, async () => {
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + 30, y + 10, { steps: 4 });
    await page.mouse.up();
  });
  await felt(page);
  assert.notEqual(await step.after(), step.before, "a drag across the object touches on");

  for (const [id, key] of [
    ["depth", "End"],
    ["angle", "End"],
  ]) {
    step = await answered(page, () => page.locator(`#${id}`).press(key));
    await felt(page);
    assert.notEqual(await step.after(), step.before, `${id} changes the tactile image`);
  }
  for (const id of ["impulse", "contact", "size"]) {
    await answered(page, () => page.locator(`#${id}`).press("End"));
    await struck(page);
  }
  assert.match(await page.locator("#notes").textContent(), /Incomplete/, "notes of the tuning are shown");
  await answered(page, () => page.locator("#material").selectOption({ index: 1 }));
  await struck(page);
  assert.match(await page.locator("#notes").textContent(), /Poisson/);
  await page.locator("#sensor").selectOption("rigid");
  // A rigid gel has no force.
  await page.waitForFunction(
    () => !/ N on/.test(document.getElementById("touch-readout").textContent),
    null,
    WAIT,
  );

  const eye = () => page.evaluate(() => window.objectfolder.orbit.eye);
  const start = await eye();
  const corner = await page.locator("#view").boundingBox();
  await page.mouse.move(corner.x + 15, corner.y + corner.height - 15);
  await page.mouse.down();
  await page.mouse.move(corner.x + 115, corner.y + corner.height - 60, { steps: 4 });
  await page.mouse.up();
  const dragged = await eye();
  assert.notDeepEqual(dragged, start, "a drag beside the object turns it");
  await page.locator("#view").focus();
  for (const key of ["ArrowLeft", "ArrowUp", "+", "-"]) await page.keyboard.press(key);
  const keyed = await eye();
  assert.notDeepEqual(keyed, dragged, "arrow keys turn it");
  const taken = await page.evaluate(() =>
    ["ctrlKey", "metaKey", "altKey"].filter((modifier) => {
      const event = new KeyboardEvent("keydown", { key: "ArrowLeft", [modifier]: true, cancelable: true });
      return !document.getElementById("view").dispatchEvent(event);
    }),
  );
  assert.deepEqual(taken, [], "shortcuts are the browser's");
  assert.deepEqual(await eye(), keyed);
  await page.locator("#reset").click();
  assert.deepEqual(await eye(), start);
  await page.locator("#view").focus();
  await answered(page, () => page.keyboard.press("Enter"));
  await struck(page);

  const picture = () => page.evaluate(() => document.getElementById("view").toDataURL());
  const drawn = () =>
    page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  for (const act of [
    () => page.locator("#azimuth").press("Home"),
    () => page.locator("#elevation").press("Home"),
    () => page.locator("#setup").selectOption("point"),
    () => page.locator("#distance").press("End"),
  ]) {
    const before = await picture();
    await act();
    await drawn();
    assert.notEqual(await picture(), before, "the light moves");
  }
  await page.evaluate(() => window.objectfolder.poke({ origin: [0, 0, 3], direction: [1, 0, 0] }));
  await page.locator("#busy", { hasText: "Nothing is there" }).waitFor();
  await page.locator("#busy").waitFor({ state: "hidden" });
  await page.locator("#file").setInputFiles({
    name: "cube.stl",
    mimeType: "model/stl",
    buffer: Buffer.from("solid cube of a foreign format"),
  });
  await page.locator("#message").waitFor();
  assert.match(await page.locator("#message").textContent(), /not a safetensors file/);
  await page.locator("#message button").click();
  assert.ok(await page.locator("#chooser").isHidden(), "what cannot be shown is not in the menu");
  await answered(page, async () => click(page, ...(await middle(page))));
  await struck(page); // the open object stays
  await felt(page);
  await loseContext(page);
  await reopen(page);
}

/** Take the graphics card away and give it back: the page says so, and draws the same picture again. */
async function loseContext(page) {
  const picture = () => page.evaluate(() => document.getElementById("view").toDataURL());
  const before = await picture();
  await page.evaluate(() => {
    window.loss = document.getElementById("view").getContext("webgl2").getExtension("WEBGL_lose_context");
    window.loss.loseContext();
  });
  await page.locator("#message", { hasText: "reload the page" }).waitFor();
  assert.notEqual(await picture(), before);
  await page.evaluate(() => window.loss.restoreContext());
  await page.locator("#message").waitFor({ state: "hidden" });
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  assert.equal(await picture(), before, "the picture is drawn again");
}

/** Open the object once more, as a file: nothing that was answered before may stay. */
async function reopen(page) {
  const shown = () =>
    page.evaluate(() => {
      const drawn = ["wave", "tones", "touch", "heights"].filter((id) => {
        const { width, height } = document.getElementById(id);
        const blank = Object.assign(document.createElement("canvas"), { width, height });
        return document.getElementById(id).toDataURL() !== blank.toDataURL();
      });
      const texts = ["sound-readout", "touch-readout", "notes", "timing"].map(
        (id) => document.getElementById(id).textContent,
      );
      return { drawn, texts, again: !document.getElementById("again").disabled };
    });
  const before = await shown();
  assert.equal(before.drawn.length, 4);
  assert.ok(before.again);
  const content = await page.locator("script[data-object]").textContent();
  await page.locator("#file").setInputFiles({
    name: "again.safetensors",
    mimeType: "application/octet-stream",
    buffer: Buffer.from(content, "base64"),
  });
  await page.waitForFunction(() => window.objectfolder.lastSound === null, null, WAIT);
  assert.deepEqual(await shown(), {
    drawn: [],
    texts: ["Strike the object to hear it.", "Touch the object to feel it.", "", ""],
    again: false,
  });
  const menu = await page.locator("#object option").allTextContents();
  assert.equal(menu.length, 2);
  assert.equal(menu[1], "again", "an opened file can be chosen again");
  assert.equal(await page.locator("#object").inputValue(), "1");
  assert.match(await page.locator("#impulse").getAttribute("aria-valuetext"), /^\d+(\.\d+)? mN·s$/);
  await openTwo(page, content);
}

/** Choose a foreign file while an Object File is being read: the menu names what is shown. */
async function openTwo(page, content) {
  await page.evaluate(async (base64) => {
    const put = (name, bytes) => {
      const files = new DataTransfer();
      files.items.add(new File([bytes], name));
      document.getElementById("file").files = files.files;
      document.getElementById("file").dispatchEvent(new Event("change"));
    };
    put(
      "first.safetensors",
      Uint8Array.from(atob(base64), (char) => char.charCodeAt(0)),
    );
    while (!document.getElementById("busy").textContent.startsWith("Reading"))
      await new Promise((done) => setTimeout(done, 0));
    put("second.safetensors", "of a foreign format");
  }, content);
  await page.locator("#message", { hasText: "This file cannot be shown" }).waitFor();
  await page.locator("#message button").click();
  const menu = await page.locator("#object option").allTextContents();
  assert.deepEqual(menu.slice(1), ["again", "first"]);
  assert.equal(await page.locator("#object").inputValue(), "2", "the file that could be read is shown");
}

/** Pinch the object: it is not struck, but turned and zoomed. */
async function pinch(page) {
  const session = await page.context().newCDPSession(page);
  const [x, y] = await middle(page);
  const touch = (type, ...at) =>
    session.send("Input.dispatchTouchEvent", { type, touchPoints: at.map((dx) => ({ x: x + dx, y })) });
  const state = () =>
    page.evaluate(() => [window.objectfolder.orbit.eye, window.objectfolder.lastSound === window.seen.sound]);
  await answered(page, () => {});
  const [before] = await state();
  await touch("touchStart", -20);
  await touch("touchStart", -20, 20);
  await touch("touchMove", -30, 40);
  await touch("touchEnd");
  await new Promise((done) => setTimeout(done, 500));
  const [after, silent] = await state();
  assert.ok(silent, "two fingers do not strike");
  assert.ok(Math.hypot(...after) < Math.hypot(...before), "they zoom");
}

/** In a frame, the wheel scrolls the page around until the picture is clicked. */
async function framed() {
  const outer = join(mkdtempSync(join(tmpdir(), "framed-")), "outer.html");
  writeFileSync(
    outer,
    `<body style="margin:0"><iframe src="file://${resolve(file)}" style="width:100%;height:640px"></iframe>
    <div style="height:4000px"></div></body>`,
  );
  const { browser, page } = await open(outer);
  const [, frame] = page.frames();
  await frame.waitForFunction(() => window.objectfolder?.times.bounced, null, WAIT);
  const state = async () => ({
    eye: await frame.evaluate(() => window.objectfolder.orbit.eye),
    scrolled: await page.evaluate(() => window.scrollY),
  });
  const start = await state();
  await page.mouse.move(400, 300);
  await page.mouse.wheel(0, 60);
  await page.waitForFunction(() => window.scrollY > 0, null, WAIT);
  const passed = await state();
  assert.deepEqual(passed.eye, start.eye, "the wheel scrolls the page");
  await page.mouse.click(400, 240);
  await page.mouse.wheel(0, 60);
  await frame.waitForFunction((eye) => window.objectfolder.orbit.eye[0] !== eye[0], passed.eye, WAIT);
  assert.equal((await state()).scrolled, passed.scrolled, "a picture in use is zoomed");
  await browser.close();
}

await framed();
for (const [name, size] of Object.entries(SIZES))
  for (const colorScheme of ["light", "dark"]) {
    const { browser, page, complaints } = await open(file, { ...size, colorScheme });
    if (size.hasTouch) await firstTap(page);
    await page.waitForFunction(() => window.objectfolder?.times.bounced, null, WAIT);
    if (name === "desktop" && colorScheme === "light") await use(page);
    else if (!size.hasTouch) await strike(page);
    else await pinch(page);
    await page.evaluate(axe); // a script in the page would break its policy
    const { violations } = await page.evaluate(() => window.axe.run());
    const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
    assert.deepEqual(
      serious.map(({ id, nodes }) => `${id}: ${nodes.map(({ target }) => target).join(", ")}`),
      [],
      `${name}, ${colorScheme}`,
    );
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
    assert.ok(wide <= 0, `${name}: ${wide} pixels too wide`);
    if (pictures) await page.screenshot({ path: `${pictures}/${name}-${colorScheme}.png` });
    assert.deepEqual(complaints, []);
    await browser.close();
  }
