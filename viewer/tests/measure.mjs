// Ask a page in Chromium what perf/viewer.py wants to know: node measure.mjs PAGE QUESTIONS.json OUT
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { open } from "./browser.mjs";

const [, , file, questions, out] = process.argv;
const { strikes, touches, pictured, views } = JSON.parse(readFileSync(questions, "utf8"));
mkdirSync(out, { recursive: true });
const { browser, page, complaints } = await open(file);
await page.waitForFunction(() => window.objectfolder?.times.bounced, null, { timeout: 300_000 });
const times = await page.evaluate(() => ({ ...window.objectfolder.times }));

/** Call a function in the page with each question; write its answers as float32 to a file. */
async function answers(name, list, ask) {
  const took = [];
  const parts = [];
  for (const question of list) {
    const [text, milliseconds] = await page.evaluate(ask, question);
    parts.push(Buffer.from(text, "base64"));
    took.push(milliseconds);
  }
  writeFileSync(`${out}/${name}.f32`, Buffer.concat(parts));
  return took;
}

await page.evaluate(() => {
  window.encoded = (values) => {
    const bytes = new Uint8Array(Float32Array.from(values).buffer);
    let text = "";
    for (let n = 0; n < bytes.length; n += 0x8000)
      text += String.fromCharCode(...bytes.subarray(n, n + 0x8000));
    return btoa(text);
  };
});
const touch = async ({ point, settings }) => {
  const app = window.objectfolder;
  await app.query({ point }, null, settings);
  return [window.encoded(app.lastTouch.image), app.lastTouch.milliseconds];
};
const took = {
  strikes: await answers("strikes", strikes, async ({ point, settings }) => {
    const app = window.objectfolder;
    await app.query({ point }, settings, null);
    return [window.encoded(app.lastSound.samples), app.lastSound.milliseconds];
  }),
  touches: await answers("touches", touches, touch),
  pictured: await answers("pictured", pictured, touch),
  views: await answers("views", views, async ({ camera, light, size }) => {
    const app = window.objectfolder;
    const start = performance.now();
    await app.settle(camera, [{ position: light, color: [1, 1, 1] }]);
    return [window.encoded(app.view.capture(size)), performance.now() - start];
  }),
};
writeFileSync(`${out}/times.json`, JSON.stringify({ times, took, complaints }));
await browser.close();
