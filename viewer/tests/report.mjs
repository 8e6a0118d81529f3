// Use a report as people do, in headless Chromium: node report.mjs INDEX [FOLDER for pictures]
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { open } from "./browser.mjs";

const [, , file, pictures] = process.argv;
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const WAIT = { timeout: 120_000 };
const SIZES = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844, hasTouch: true } };

async function look(page, name) {
  // Pictures below the fold load when they are scrolled to.
  await page.evaluate(() => {
    for (const image of document.images) image.loading = "eager";
  });
  await page.waitForFunction(() => [...document.images].every((image) => image.complete), null, WAIT);
  await page.evaluate(axe); // a script in the page would break its policy
  const { violations } = await page.evaluate(() => window.axe.run({ exclude: ["iframe"] }));
  const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
  assert.deepEqual(
    serious.map(({ id, nodes }) => `${id}: ${nodes.map(({ target }) => target).join(", ")}`),
    [],
    name,
  );
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wide <= 0, `${name}: ${wide} pixels too wide`);
  const cut = await page
    .locator(".scroll")
    .evaluateAll((boxes) => boxes.map((box) => box.scrollWidth - box.clientWidth));
  assert.ok(Math.max(0, ...cut) <= 0, `${name}: no column of a table is cut`);
  const broken = await page.evaluate(() =>
    [...document.images].filter((image) => image.complete && !image.naturalWidth).map(({ alt }) => alt),
  );
  assert.deepEqual(broken, [], "every picture is shown");
  if (pictures) await page.screenshot({ path: `${pictures}/${name}.png`, fullPage: true });
}

async function filter(page) {
  const keys = () => page.locator("#cards strong").allTextContents();
  const all = await keys();
  assert.ok(all.length > 0);
  await page.locator("#search").fill(all[0]);
  assert.ok((await keys()).includes(all[0]));
  await page.locator("#search").fill("no such object");
  assert.deepEqual(await keys(), []);
  await page.locator("#search").fill("");
  await page.locator("#order").selectOption("key");
  assert.deepEqual(await keys(), [...all].sort());
  await page.locator("#state").selectOption("failed");
  assert.equal((await keys()).length, await page.locator("#cards .failed").count());
  await page.locator("#state").selectOption("");
  await page.locator("#order").selectOption("");
}

/** Tables are shown whole, their numbers line up, and an object alone is not ranked. */
async function tables(page) {
  const hidden = await page
    .locator(".scroll:not(.long)")
    .evaluateAll((boxes) => boxes.map((box) => box.scrollHeight - box.clientHeight));
  assert.ok(hidden.length >= 2);
  assert.ok(Math.max(...hidden) <= 0, "no row of a short table is cut");
  for (const table of await page.locator("section:has(h2:text-is('Modes')) table").all()) {
    const rows = await table
      .locator("tbody tr")
      .evaluateAll((found) => found.map((row) => [...row.cells].map(({ textContent }) => textContent)));
    for (const texts of rows[0].map((_, n) => rows.map((row) => row[n]))) {
      const decimals = texts.filter((text) => text !== "–").map((text) => text.split(".")[1]?.length);
      assert.equal(new Set(decimals).size <= 1, true, `decimals of ${texts}`);
    }
  }
  const titles = await page.locator("#body h2").allTextContents();
  const built = await page.evaluate(() =>
    JSON.parse(document.getElementById("data").textContent).rows.filter((row) => !row.missing),
  );
  const modes = page.locator("#statistics > div:has(h3:text-is('Modes')) svg");
  if (built.length === 1) assert.equal(await modes.count(), 0, "no histogram of one object");
  const counted = `${built.length} ${built.length === 1 ? "object" : "objects"}, `;
  assert.ok((await page.locator("#summary").textContent()).startsWith(counted));
  assert.match(await page.locator("#body .quiet").first().textContent(), / from (\d+|\d{1,3}\.\d) Hz$/);
  assert.equal(titles.includes("Among the other objects"), built.length > 1);
  assert.ok(titles.includes("Cost of the build"));
}

async function live(page) {
  await page.locator("#body button").click();
  const frame = await (await page.locator("iframe").elementHandle()).contentFrame();
  await frame.waitForFunction(() => window.objectfolder?.times.coloured, null, WAIT);
  const reached = await frame.evaluate(() => {
    try {
      return parent.document.title;
    } catch {
      return null;
    }
  });
  assert.equal(reached, null, "the frame does not reach the report");
  await frame.locator("#view").press("Enter");
  await frame.waitForFunction(
    () => window.objectfolder.lastSound && window.objectfolder.lastTouch,
    null,
    WAIT,
  );
}

for (const [name, size] of Object.entries(SIZES))
  for (const colorScheme of ["light", "dark"]) {
    const { browser, page, complaints } = await open(file, { ...size, colorScheme });
    await page.locator("#cards li").first().waitFor();
    const used = name === "desktop" && colorScheme === "light";
    if (used) await filter(page);
    await look(page, `overview-${name}-${colorScheme}`);
    // By keyboard: the first card, then its page.
    const card = page.locator("#cards a[href]").first();
    await card.focus();
    await page.keyboard.press("Enter");
    await page.locator("#body h1").waitFor(WAIT);
    assert.match(await page.locator("#body").textContent(), /Certificate: \d+ of \d+ checks passed/);
    await look(page, `object-${name}-${colorScheme}`);
    if (used) await tables(page);
    if (used) await live(page);
    await page.locator("#back").click();
    await page.locator("#cards li").first().waitFor();
    assert.deepEqual(complaints, []);
    await browser.close();
  }
