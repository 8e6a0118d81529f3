import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import type { Material } from "../core/materials.ts";
import { Answers } from "../worker/answers.ts";

const SAMPLE = new URL("../../objectfolder/objectfile/samples/mug.safetensors", import.meta.url);
const IRON: Material = {
  name: "iron",
  density: 8000,
  youngs_modulus: 2.1e11,
  poisson_ratio: 0.28,
  alpha: 5,
  beta: 1e-7,
  loss_factor: [[1000, 5e-4]],
};

describe("a mug at a listener", () => {
  const mug = new Answers(new Uint8Array(readFileSync(SAMPLE)).buffer as ArrayBuffer);
  const struck = (material: Material | null, size: number) =>
    mug.strike([0.3, 0, 0], {
      impulse: [0.1, 0, 0],
      contact: 0,
      material,
      size,
      rate: 44100,
      duration: 0.05,
      response: "acceleration",
      silence: 0,
      listener: [2, 0, 0],
      reference: [2, 0, 0],
    })!;

  it("is heard in pascals in its own material, at any size", () => {
    for (const size of [1, 1.3]) expect(struck(null, size).notes.join()).not.toContain("Accelerations");
  });

  it("is not of iron, whose frequencies are not known well enough, as in the library", () => {
    const { notes } = struck(IRON, 1);
    expect(notes.some((note) => note.startsWith("Accelerations, not sound pressure"))).toBe(true);
  });

  it("clicks where no mode lies within hearing", () => {
    const { modes, samples, reference } = struck(null, 0.02);
    expect(modes).toBe(0);
    expect(Math.max(...samples)).toBeGreaterThan(0);
    expect(reference).toBeGreaterThan(0);
  });
});
