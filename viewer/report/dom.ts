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
    { class: "scroll", tabindex: 0, role: "group", "aria-label": "table" },
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

export function length(metres: number | null): string {
  if (metres === null) return "";
  return metres < 1 ? short(metres * 1000, "mm") : short(metres, "m");
}
