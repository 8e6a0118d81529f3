/** The overview: statistics, filters and a card for each object. */

import { data, type Row } from "./data.ts";
import { byId, draw, length, make, measure, short } from "./dom.ts";

/** Failures first, then warnings, then by name. */
const trouble = (row: Row) => (row.missing ? 0 : row.failed.length ? 1 : row.warnings.length ? 2 : 3);

const notBuilt = (row: Row) => row.missing === true && !row.failed.length;

function card(row: Row): HTMLElement {
  const state = row.failed.length ? "failed" : row.missing ? "missing" : "";
  const facts = [row.material, length(row.size)].filter(Boolean).join(" · ");
  const score = row.scores["vision.psnr"];
  const said = row.failed.length ? `${row.failed.length} failed: ${row.failed[0]}` : "";
  return make(
    "li",
    {},
    make(
      "a",
      { class: `card ${state}`, href: row.missing ? null : `#${row.key}` },
      row.thumbnail
        ? make("img", { class: "thumbnail", src: row.thumbnail, alt: "", loading: "lazy", decoding: "async" })
        : make("div", { class: "thumbnail none" }),
      make("strong", {}, row.key.replaceAll("_", " ")),
      make("small", {}, facts),
      ...(score === undefined ? [] : [make("small", {}, `views ${short(score, "dB")}`)]),
      ...(said ? [make("small", { class: "bad" }, said)] : []),
      ...row.warnings.slice(0, 1).map((text) => make("small", { class: "bad" }, text)),
    ),
  );
}

function histogram(title: string, values: number[], unit: string, logarithmic: boolean): HTMLElement | null {
  const found = values.filter((value) => Number.isFinite(value) && (!logarithmic || value > 0));
  if (!found.length) return null;
  const scale = logarithmic ? Math.log : (value: number) => value;
  const [low, high] = [Math.min(...found), Math.max(...found)];
  if (low === high)
    return make("div", {}, make("h3", {}, title), make("p", { class: "only" }, measure(low, unit)));
  const bins = new Array(16).fill(0);
  for (const value of found) {
    const place = (scale(value) - scale(low)) / (scale(high) - scale(low));
    bins[Math.min(15, Math.floor(place * 16))]++;
  }
  const most = Math.max(...bins);
  return make(
    "div",
    {},
    make("h3", {}, title),
    draw(
      "svg",
      {
        viewBox: "0 0 160 60",
        preserveAspectRatio: "none",
        role: "img",
        "aria-label": `${title}: histogram`,
      },
      ...bins.map((count, n) =>
        draw("rect", {
          class: "bar",
          x: n * 10 + 0.5,
          width: 9,
          y: 60 - (58 * count) / most,
          height: (58 * count) / most,
        }),
      ),
    ),
    make(
      "div",
      { class: "ends" },
      make("span", {}, measure(low, unit)),
      make("span", {}, measure(high, unit)),
    ),
  );
}

function materials(rows: Row[]): HTMLElement {
  const counts = new Map<string, number>();
  for (const { material } of rows) counts.set(material, (counts.get(material) ?? 0) + 1);
  const most = [...counts].sort((a, b) => b[1] - a[1]).slice(0, 5);
  return make(
    "div",
    {},
    make("h3", {}, "Materials"),
    ...most.map(([name, count]) => make("div", { class: "ends" }, make("span", {}, name), `${count}`)),
  );
}

export class Overview {
  /** Keys in the order that is shown. */
  keys: string[] = [];

  constructor() {
    const { rows, scores } = data;
    const built = rows.filter((row) => !row.missing);
    const failed = rows.filter((row) => row.failed.length).length;
    const missing = rows.filter(notBuilt).length;
    const bytes = built.reduce((sum, row) => sum + (row.bytes ?? 0), 0);
    byId("summary").textContent = [
      `${built.length} ${built.length === 1 ? "object" : "objects"}, ${short(bytes / 1e6, "MB")} of Object Files`,
      failed ? `${failed} with failed checks` : "all checks passed",
      missing ? `${missing} not built` : "",
    ]
      .filter(Boolean)
      .join(" · ");
    const charts = [
      materials(rows),
      histogram(
        "Size",
        rows.map((row) => (row.size ?? 0) * 1000),
        "mm",
        true,
      ),
      histogram(
        "Lowest mode",
        built.map((row) => row.lowest ?? Number.NaN),
        "Hz",
        true,
      ),
      histogram(
        "Modes",
        built.map((row) => row.modes ?? Number.NaN),
        "",
        false,
      ),
      ...scores.slice(0, 5).map(([name, title, unit]) =>
        histogram(
          `Score: ${title}`,
          built.map((row) => row.scores[name]),
          unit,
          false,
        ),
      ),
    ];
    byId("statistics").append(...charts.filter((chart) => chart !== null));
    const names = [...new Set(rows.map((row) => row.material))].sort();
    byId("material").append(
      make("option", { value: "" }, "all"),
      ...names.map((name) => make("option", {}, name)),
    );
    byId("order").append(
      make("option", { value: "" }, "failures first"),
      make("option", { value: "key" }, "name"),
      make("option", { value: "size" }, "size of the object"),
      ...scores.map(([name, title]) => make("option", { value: name }, `worst ${title}`)),
    );
    const filters = byId<HTMLFormElement>("filters");
    filters.addEventListener("input", () => this.show());
    filters.addEventListener("submit", (event) => event.preventDefault());
    this.show();
  }

  private show(): void {
    const value = (id: string) => byId<HTMLInputElement | HTMLSelectElement>(id).value;
    const words = value("search").toLowerCase().split(/\s+/).filter(Boolean);
    const [material, state, order] = [value("material"), value("state"), value("order")];
    const score = data.scores.find(([name]) => name === order);
    const shown = data.rows.filter((row) => {
      const text = `${row.key.replaceAll("_", " ")} ${row.material}`.toLowerCase();
      if (state === "failed" && !row.failed.length) return false;
      if (state === "warned" && !row.warnings.length) return false;
      if (state === "missing" && !notBuilt(row)) return false;
      return (!material || row.material === material) && words.every((word) => text.includes(word));
    });
    // Objects without the score come last.
    const rank = (row: Row) => {
      if (order === "size") return row.size ?? 0;
      if (!score) return order === "key" ? 0 : trouble(row);
      const found = row.scores[order] ?? Number.POSITIVE_INFINITY;
      return score[3] || found === Number.POSITIVE_INFINITY ? found : -found;
    };
    shown.sort((a, b) => rank(a) - rank(b) || a.key.localeCompare(b.key));
    this.keys = shown.filter((row) => !row.missing).map((row) => row.key);
    byId("count").textContent = `${shown.length} of ${data.rows.length}`;
    byId("cards").replaceChildren(...shown.map(card));
  }
}
