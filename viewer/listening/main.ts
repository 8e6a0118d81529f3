/** A listening test with two alternatives: which of two sounds is more real? */

import { csv, plan, type Trial } from "./plan.ts";

interface Study {
  id: string;
  seed: number;
  /** Of the two methods, ours first. */
  methods: [string, string];
  pairs: { name: string; material: string; sounds: [string, string] }[];
}

const HEAD = ["study", "listener", "trial", "pair", "material", "first", "second", "chosen", "ours"];
const byId = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
const study = JSON.parse(byId("study").textContent!) as Study;
const store = `objectfolder-listening-${study.id}`;
const players = [new Audio(), new Audio()];
const LEAST = 0.4; // seconds of a sound that count as heard
let trials: Trial[] = [];
let heard = [false, false];
let now = 0;
let listener = "";

type Answer = (string | number)[];

/** All answers, once the browser has refused to keep them. */
let unkept: Answer[] | null = null;

function kept(): Answer[] {
  if (unkept) return unkept;
  try {
    return JSON.parse(localStorage.getItem(store) ?? "[]");
  } catch {
    unkept = [];
    return unkept;
  }
}

function keep(answer: Answer): void {
  const answers = [...kept(), answer];
  if (unkept) unkept = answers;
  else
    try {
      localStorage.setItem(store, JSON.stringify(answers));
    } catch {
      unkept = answers;
    }
}

const plural = (count: number, word: string): string => `${count} ${word}${count === 1 ? "" : "s"}`;

function show(id: "welcome" | "trial" | "thanks"): void {
  for (const name of ["welcome", "trial", "thanks"]) byId(name).hidden = name !== id;
  byId("again").hidden = id !== "thanks";
  const rows = kept();
  byId<HTMLButtonElement>("save").disabled = !rows.length;
  const listeners = new Set(rows.map((row) => row[1])).size;
  const where = unkept ? "in this page alone: save them before you close it" : "in this browser";
  byId("kept").textContent = rows.length
    ? `${plural(rows.length, "answer")} of ${plural(listeners, "listener")}, kept ${where}`
    : "";
}

/** Methods of the sounds that are played first and second: 0 or 1 each. */
const sides = () => (trials[now].swapped ? [1, 0] : [0, 1]);

function next(): void {
  if (now === trials.length) return show("thanks");
  heard = [false, false];
  for (const n of [0, 1]) {
    players[n].src = study.pairs[trials[now].pair].sounds[sides()[n]];
    byId<HTMLButtonElement>(`choose${n}`).disabled = true;
    delete byId(`play${n}`).dataset.heard;
  }
  byId("progress").textContent = `Pair ${now + 1} of ${trials.length}`;
  show("trial");
  byId("play0").focus();
}

function play(n: number): void {
  for (const player of players) player.pause();
  players[n].currentTime = 0;
  // The other button may stop it before it began: then it was not heard.
  players[n].play().catch(() => {});
}

function hear(n: number): void {
  heard[n] = true;
  byId(`play${n}`).dataset.heard = "yes";
  if (heard[0] && heard[1]) for (const m of [0, 1]) byId<HTMLButtonElement>(`choose${m}`).disabled = false;
}

function choose(n: number): void {
  if (!(heard[0] && heard[1])) return;
  for (const player of players) player.pause();
  const { name, material } = study.pairs[trials[now].pair];
  const [first, second] = sides().map((side) => study.methods[side]);
  const row = [
    study.id,
    listener,
    now + 1,
    name,
    material,
    first,
    second,
    [first, second][n],
    study.methods[0],
  ];
  keep(row);
  now++;
  next();
}

byId("pairs").textContent = String(study.pairs.length);
byId("start").addEventListener("submit", (event) => {
  event.preventDefault();
  const field = byId<HTMLInputElement>("listener");
  listener = field.value.trim();
  trials = plan(study.pairs.length, listener, study.seed);
  // An interrupted test goes on: a listener's trials are always the same.
  now = kept().filter((row) => row[1] === listener).length;
  field.setCustomValidity(now >= trials.length ? "This listener has answered already." : "");
  if (!field.reportValidity() || !listener) return;
  next();
});
byId("listener").addEventListener("input", () => byId<HTMLInputElement>("listener").setCustomValidity(""));
for (const n of [0, 1]) {
  byId(`play${n}`).addEventListener("click", () => play(n));
  players[n].addEventListener("ended", () => hear(n));
  players[n].addEventListener("timeupdate", () => {
    if (players[n].currentTime >= LEAST) hear(n);
  });
  byId(`choose${n}`).addEventListener("click", () => choose(n));
}
addEventListener("keydown", (event) => {
  if (byId("trial").hidden || event.repeat) return;
  if (event.ctrlKey || event.metaKey || event.altKey) return; // shortcuts of the browser
  if (event.key === "1" || event.key === "2") play(+event.key - 1);
  if (event.key === "ArrowLeft") choose(0);
  if (event.key === "ArrowRight") choose(1);
});
byId("again").addEventListener("click", () => {
  byId<HTMLInputElement>("listener").value = "";
  show("welcome");
  byId("listener").focus();
});
byId("save").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([csv(HEAD, kept())], { type: "text/csv" }));
  link.download = `listening-${study.id}.csv`;
  link.click();
});
show("welcome");
