// What gets into a page is not run, and neither loads nor sends anything: node policy.mjs PAGE
import assert from "node:assert/strict";
import { open } from "./browser.mjs";

const { browser, page, complaints } = await open(process.argv[2]);
await page.waitForFunction(() => document.readyState === "complete");
assert.deepEqual(complaints, [], "its words are shown and not obeyed");
const found = await page.evaluate(async () => {
  const blocked = new Set();
  addEventListener("securitypolicyviolation", (event) => blocked.add(event.effectiveDirective));
  const add = (tag, given) => {
    const added = document.createElement(tag);
    for (const [name, value] of Object.entries(given)) added.setAttribute(name, value);
    return document.body.appendChild(added);
  };
  const away = "https://objectfolder.invalid/";
  document.body.append(Object.assign(document.createElement("script"), { textContent: "window.ran = 1" }));
  add("img", { src: "data:,", onerror: "window.ran = 2" });
  add("script", { src: "data:text/javascript,window.ran=3" });
  add("script", { src: away });
  add("a", { href: "javascript:window.ran=4" }).click();
  add("img", { src: away });
  add("link", { rel: "stylesheet", href: away });
  add("p", { style: "color: red" });
  add("iframe", { src: away });
  add("object", { data: away });
  add("audio", { src: away });
  document.head.append(Object.assign(document.createElement("base"), { href: away }));
  add("form", { action: away, method: "post" }).submit();
  await fetch(away).catch(() => {});
  // Later, since a debugger's own evaluations may evaluate.
  setTimeout(() => Function("window.ran = 5")());
  await new Promise((done) => setTimeout(done, 500));
  return { ran: window.ran ?? null, blocked: [...blocked].sort() };
});
assert.equal(found.ran, null);
assert.deepEqual(found.blocked, [
  ...["base-uri", "connect-src", "form-action", "frame-src", "img-src", "media-src", "object-src"],
  ...["script-src", "script-src-attr", "script-src-elem", "style-src-attr", "style-src-elem"],
]);
await browser.close();
