// Milliseconds that the overview of a report takes, in headless Chromium: node overview.mjs INDEX
import assert from "node:assert/strict";
import { open } from "./browser.mjs";

const [, , file] = process.argv;
const { browser, page, complaints } = await open(file);
await page.locator("#cards li").first().waitFor();
const found = await page.evaluate(async () => {
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  const shown = performance.getEntriesByType("navigation")[0].domContentLoadedEventEnd;
  const search = document.getElementById("search");
  const start = performance.now();
  search.value = "9";
  search.dispatchEvent(new Event("input", { bubbles: true }));
  document.body.getBoundingClientRect();
  const filtered = performance.now() - start;
  search.value = "";
  search.dispatchEvent(new Event("input", { bubbles: true }));
  const steps = [];
  for (let n = 0; n < 30; n++) {
    const before = performance.now();
    scrollBy(0, 100);
    await frame();
    steps.push(performance.now() - before);
  }
  steps.sort((a, b) => a - b);
  return { cards: document.querySelectorAll("#cards li").length, shown, filtered, scroll: steps[15] };
});
assert.deepEqual(complaints, []);
console.log(JSON.stringify(found));
await browser.close();
