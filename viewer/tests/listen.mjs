// Take a listening test as two people, in headless Chromium: node listen.mjs PAGE FOLDER
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { open } from "./browser.mjs";

const [, , file, folder] = process.argv;
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const { browser, page, complaints } = await open(file, { width: 390, height: 844 });
const pairs = Number(await page.locator("#pairs").textContent());
for (const [listener, key] of [
  ["one", "ArrowLeft"],
  ["two, the second", "ArrowRight"],
]) {
  await page.locator("#listener").fill(listener);
  await page.keyboard.press("Enter");
  for (let n = 0; n < pairs; n++) {
    assert.equal(await page.locator("#progress").textContent(), `Pair ${n + 1} of ${pairs}`);
    await page.keyboard.press(key);
    if (n === 1 && listener === "one") {
      await page.reload(); // an interrupted test goes on
      await page.locator("#listener").fill(listener);
      await page.keyboard.press("Enter");
      assert.equal(await page.locator("#progress").textContent(), `Pair 2 of ${pairs}`);
    }
    assert.ok(await page.locator("#choose0").isDisabled(), "nobody chooses before hearing both");
    for (const sound of [0, 1]) {
      await page.keyboard.press(String(sound + 1));
      await page.locator(`#play${sound}[data-heard]`).waitFor();
    }
    await page.waitForFunction(() => !document.getElementById("choose0").disabled);
    await page.evaluate(() =>
      dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", altKey: true })),
    );
    assert.equal(
      await page.locator("#progress").textContent(),
      `Pair ${n + 1} of ${pairs}`,
      "shortcuts of the browser are no answers",
    );
    await page.keyboard.press(key);
  }
  await page.locator("#thanks").waitFor();
  if (listener !== "one") continue;
  await page.locator("#again").click();
  await page.locator("#listener").fill(listener);
  await page.keyboard.press("Enter");
  assert.ok(await page.locator("#trial").isHidden(), "nobody answers twice");
}
await page.evaluate(axe); // a script in the page would break its policy
const { violations } = await page.evaluate(() => window.axe.run());
const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
assert.deepEqual(
  serious.map(({ id }) => id),
  [],
);
const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#save").click()]);
await download.saveAs(`${folder}/answers.csv`);
assert.deepEqual(complaints, []);
await browser.close();
