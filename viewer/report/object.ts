/** The page of one object. */

import { type Data, type Detail, data, type Row, type Strip, viewerProgram } from "./data.ts";
import { column, draw, failure, length, make, measure, short, table } from "./dom.ts";

const THREE = ["ground truth", "Object File", "difference"];
const ENLARGED = " × 4"; // differences of pictures
const EQUAL = 150; // dB from which pictures are equal

const compared = ({ score }: Strip) => score !== undefined;
const alone = (strip: Strip) => !compared(strip);

function shown({ title, score, source }: Strip, kind: string, ...more: Node[]): HTMLElement {
  const compared = score !== undefined || kind === "compared";
  const names = THREE.map((name, n) => (n === 2 && score !== undefined ? name + ENLARGED : name));
  return make(
    "figure",
    { class: compared ? null : "single" },
    make(
      "figcaption",
      {},
      score === undefined ? title : `${title}, ${score < EQUAL ? short(score, "dB") : "equal"}`,
    ),
    make("img", { src: source, alt: compared ? `${title}: ${names.join(", ")}` : title, loading: "lazy" }),
    ...(compared ? [make("div", { class: "columns" }, ...names.map((text) => make("span", {}, text)))] : []),
    ...more,
  );
}

function sound(given: Detail["sounds"][number]): HTMLElement {
  const players: [string, string][] = given.truth
    ? [
        ["Ground truth", given.truth],
        ["Object File", given.answer],
      ]
    : [["Object File", given.answer]];
  const figure = shown(
    given,
    given.truth ? "compared" : "alone",
    make("p", { class: "axes" }, given.axes),
    make(
      "div",
      { class: given.truth ? "players" : "players single" },
      ...players.map(([name, source]) =>
        make(
          "label",
          {},
          name,
          make("audio", { controls: true, src: source, preload: "none", "aria-label": name }),
        ),
      ),
    ),
  );
  figure.classList.add("spectrogram");
  return figure;
}

/** A score of the object among those of all. */
function place(row: Row, [name, title, unit, more]: Data["scores"][number]): HTMLElement | null {
  const own = row.scores[name];
  const all = data.rows.map((other) => other.scores[name]).filter((value) => value !== undefined);
  if (own === undefined || all.length < 2) return null;
  const [low, high] = [Math.min(...all), Math.max(...all)];
  const x = (value: number) => (high > low ? 4 + (192 * (value - low)) / (high - low) : 100);
  const better = all.filter((value) => (more ? value > own : value < own)).length;
  return make(
    "div",
    { class: "score" },
    make("h3", {}, `${title}: ${measure(own, unit)}`),
    draw(
      "svg",
      {
        viewBox: "0 0 200 22",
        preserveAspectRatio: "none",
        role: "img",
        "aria-label": `${title}: place ${better + 1} of ${all.length}`,
      },
      ...all.map((value) => draw("rect", { class: "dot", x: x(value) - 0.4, y: 5, width: 0.8, height: 12 })),
      draw("rect", { class: "own", x: x(own) - 0.8, y: 1, width: 1.6, height: 20 }),
    ),
    make(
      "div",
      { class: "ends" },
      make("span", {}, measure(low, unit)),
      make("span", {}, `${better + 1} of ${all.length}`),
      make("span", {}, measure(high, unit)),
    ),
  );
}

/** The live viewer of the object. */
async function live(detail: Detail): Promise<HTMLElement> {
  const parts: Record<string, string> = {
    title: detail.key,
    objects: `<script type="text/plain" data-object="${detail.key}">${detail.file}</script>`,
    script: await viewerProgram(),
  };
  return make("iframe", {
    srcdoc: data.frame.replace(/\{\{(\w+)\}\}/g, (_, name: string) => parts[name]),
    sandbox: "allow-scripts",
    title: `Live viewer of ${detail.key}`,
    allow: "autoplay",
  });
}

function section(title: string, ...content: (Node | null)[]): HTMLElement | null {
  const found = content.filter((node) => node !== null);
  return found.length ? make("section", {}, make("h2", {}, title), ...found) : null;
}

/** Rows of a table whose columns of numbers are these. */
const across = (...columns: string[][]) => columns[0].map((_, n) => columns.map((texts) => texts[n]));

function modes(rows: Detail["modes"]): HTMLElement {
  const [f, time, quality, error] = [0, 1, 2, 3].map((n) => rows.map((row) => row[n]));
  const percent = error.map((value) => (value === null ? null : value * 100));
  return table(
    ["frequency, Hz", "decay by 60 dB, s", "quality", "estimated error, %"],
    across(column(f, 4, 1), column(time, 2), column(quality, 2), column(percent, 2, 2)),
    4,
  );
}

/** What the stages took where the object was built. */
function costs(rows: Detail["costs"]): HTMLElement {
  const total = rows.reduce((sum, [, cpu]) => sum + cpu, 0);
  const [cpu, wall, memory] = [1, 2, 3].map((n) => rows.map((row) => row[n] as number));
  return table(
    ["stage", "processor, s", "wall, s", "peak memory, MB"],
    across(
      [...rows.map(([stage]) => stage), "all"],
      column([...cpu, total], 1, 1),
      [...column(wall, 1, 1), ""],
      [...column(memory, 1, 0), ""],
    ),
    3,
  );
}

/** Pictures beside each other; those without a truth need less room. */
const strips = (given: Strip[], kind = "") =>
  given.length ? make("div", { class: `strips ${kind}` }, ...given.map((strip) => shown(strip, ""))) : null;

export function objectPage(row: Row, detail: Detail): Node[] {
  const stage = make("div", {}, make("button", { type: "button" }, "See, strike and touch it"));
  stage.querySelector("button")!.addEventListener("click", async () => {
    const shown = await live(detail).catch(failure);
    stage.replaceChildren(shown);
    shown.focus();
  });
  const passed = detail.checks.filter((check) => check.passed).length;
  const scores = data.scores.map((score) => place(row, score)).filter((chart) => chart !== null);
  const facts = [
    row.material,
    length(row.size),
    measure(row.bytes ?? 0, "bytes"),
    `${row.modes ?? 0} modes`,
    row.lowest ? `from ${measure(row.lowest, "Hz")}` : "",
  ];
  const parts = [
    make("h1", { tabindex: -1 }, row.key.replaceAll("_", " ")),
    make("p", { class: "quiet" }, facts.filter(Boolean).join(" · ")),
    ...row.warnings.map((text) => make("p", { class: "bad" }, text)),
    stage,
    section(
      `Certificate: ${passed} of ${detail.checks.length} checks passed`,
      table(
        ["check", "", "found", "expected"],
        detail.checks.map(({ name, figure, limit, passed: ok }) => [
          name,
          make("span", { class: ok ? "good" : "bad" }, ok ? "passed" : "failed"),
          figure,
          limit,
        ]),
        2,
      ),
    ),
    section("Look", strips(detail.views.filter(alone), "three"), strips(detail.views.filter(compared))),
    section(
      "Sound",
      detail.sounds.length ? make("div", { class: "strips" }, ...detail.sounds.map(sound)) : null,
    ),
    section("Touch", strips(detail.touches.filter(alone), "small"), strips(detail.touches.filter(compared))),
    section(
      "Among the other objects",
      scores.length ? make("div", { class: "statistics" }, ...scores) : null,
    ),
    section("Modes", detail.modes.length ? modes(detail.modes) : null),
    section(
      "Provenance",
      table(
        ["part", "SHA-256 of its input, or kind"],
        Object.entries(detail.provenance).map(([name, text]) => [name, make("code", {}, text)]),
        0,
      ),
    ),
    section("Cost of the build", detail.costs.length ? costs(detail.costs) : null),
  ];
  return parts.filter((part) => part !== null);
}
