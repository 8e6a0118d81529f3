/** The report: an overview, and a page for each object behind its fragment of the address. */

import { data, detailOf } from "./data.ts";
import { byId, failure, make } from "./dom.ts";
import { objectPage } from "./object.ts";
import { Overview } from "./overview.ts";

const overview = new Overview();
let scrolled = 0;

const asked = (): string => decodeURIComponent(location.hash.slice(1));
const title = document.title;
let last = "";

async function route(): Promise<void> {
  const key = asked();
  const row = data.rows.find((found) => found.key === key && !found.missing);
  if (!byId("overview").hidden) scrolled = scrollY;
  byId("overview").hidden = row !== undefined;
  byId("object").hidden = row === undefined;
  document.querySelector<HTMLElement>("body > header")!.hidden = row !== undefined;
  const body = byId("body");
  body.replaceChildren();
  document.title = row ? `${key} – ${title}` : title;
  if (!row) {
    scrollTo(0, scrolled);
    if (last)
      document.querySelector<HTMLElement>(`a[href="#${CSS.escape(last)}"]`)?.focus({ preventScroll: true });
    return;
  }
  last = key;
  const here = overview.keys.indexOf(key);
  for (const [id, step] of [
    ["previous", -1],
    ["next", 1],
  ] as const) {
    const other = here < 0 ? undefined : overview.keys[here + step];
    byId(id).hidden = other === undefined;
    byId<HTMLAnchorElement>(id).href = `#${other}`;
  }
  body.append(make("p", { class: "quiet", role: "status" }, `Reading ${key} …`));
  try {
    const detail = await detailOf(key);
    if (asked() !== key) return; // another was asked for meanwhile
    body.replaceChildren(...objectPage(row, detail));
    scrollTo(0, 0);
    body.querySelector("h1")!.focus({ preventScroll: true });
  } catch (error) {
    if (asked() !== key) return;
    body.replaceChildren(failure(error as Error));
  }
}

addEventListener("hashchange", () => void route());
void route();
