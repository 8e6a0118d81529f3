/** What one listener hears: pairs in random order, each method first in half of them. */

export interface Trial {
  pair: number;
  /** Whether the sound of the other method is played first. */
  swapped: boolean;
}

/** Numbers in [0, 1) that a text determines (FNV-1a, then mulberry32). */
export function generator(text: string): () => number {
  let state = 0x811c9dc5;
  for (const letter of text) state = Math.imul(state ^ letter.codePointAt(0)!, 0x01000193);
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

function shuffled<T>(values: T[], random: () => number): T[] {
  const out = [...values];
  for (let n = out.length - 1; n > 0; n--) {
    const other = Math.floor(random() * (n + 1));
    [out[n], out[other]] = [out[other], out[n]];
  }
  return out;
}

export function plan(pairs: number, listener: string, seed: number): Trial[] {
  const random = generator(`${seed}/${listener}`);
  // Of an odd number, chance says which method comes first once more.
  const first = random() < 0.5;
  const sides = shuffled(
    Array.from({ length: pairs }, (_, n) => (n % 2 === 0) === first),
    random,
  );
  const order = shuffled(
    Array.from({ length: pairs }, (_, n) => n),
    random,
  );
  return order.map((pair, n) => ({ pair, swapped: sides[n] }));
}

/** Where spreadsheets would take a text for a formula; objectfolder/base/text.py takes the apostrophes away again. */
const FORMULA = /(^|[,;])(?=['"\s]*[=+\-@\t\r\n＝＋－＠])/g;

const cell = (value: string | number) => {
  const text = typeof value === "string" ? value.replace(FORMULA, "$1'") : String(value);
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

/** Rows as CSV with a head. */
export function csv(head: string[], rows: (string | number)[][]): string {
  return [head, ...rows].map((row) => `${row.map(cell).join(",")}\n`).join("");
}
