/** Elements of the page. */

type Attributes = Record<string, string | number | boolean | null | undefined>;

function fill<T extends Element>(made: T, attributes: Attributes, children: (Node | string)[]): T {
  for (const [name, value] of Object.entries(attributes))
    if (value !== null && value !== undefined && value !== false)
      made.setAttribute(name, value === true ? "" : String(value));
  made.append(...children);
  return made;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  return fill(document.createElement(tag), attributes, children);
}

export function draw(tag: string, attributes: Attributes = {}, ...children: (Node | string)[]): SVGElement {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

export const byId = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;

/** What is shown in place of what cannot be read. */
export const failure = (error: Error): HTMLElement =>
  make("p", { class: "bad", role: "alert" }, error.message);

const LONG = 40; // rows of a table that scrolls in its box

/** A table with numbers on the right. */
export function table(heads: string[], rows: (string | Node)[][], numbers: number): HTMLElement {
  const cell = (tag: "th" | "td", value: string | Node, n: number) =>
    make(
      tag,
      { class: n >= heads.length - numbers ? "number" : null, scope: tag === "th" ? "col" : null },
      value,
    );
  return make(
    "div",
    {
      class: rows.length > LONG ? "scroll long" : "scroll",
      tabindex: 0,
      role: "group",
      "aria-label": "table",
    },
    make(
      "table",
      {},
      make("thead", {}, make("tr", {}, ...heads.map((text, n) => cell("th", text, n)))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map((value, n) => cell("td", value, n))))),
    ),
  );
}

export const short = (value: number | null | undefined, unit = ""): string =>
  value === null || value === undefined ? "–" : `${+value.toPrecision(3)}${unit && ` ${unit}`}`;

/** A frequency to a tenth of a hertz, from 1 kHz on to a hertz. */
const hertz = (value: number): string => `${value.toFixed(value < 1000 ? 1 : 0)} Hz`;

/** Units of stored values: factor and name of the shown one. */
const SHOWN: Record<string, [number, string]> = { bytes: [1e-3, "kB"], share: [100, "%"] };

/** A value in its unit; bytes as kB, a share as per cent. */
export function measure(value: number, unit: string): string {
  if (unit === "Hz") return hertz(value);
  const [factor, name] = SHOWN[unit] ?? [1, unit];
  return short(value * factor, name);
}

/** Numbers of a column, with as many decimals as the smallest needs to show so many digits, but no more than `most`. */
export function column(values: (number | null)[], digits: number, most = 4): string[] {
  const least = Math.min(...(values.filter((value) => value !== null && value > 0) as number[]));
  const decimals = Number.isFinite(least) ? digits - 1 - Math.floor(Math.log10(least)) : 0;
  return values.map((value) => value?.toFixed(Math.min(Math.max(decimals, 0), most)) ?? "–");
}

export function length(metres: number | null): string {
  if (metres === null) return "";
  return metres < 1 ? short(metres * 1000, "mm") : short(metres, "m");
}
