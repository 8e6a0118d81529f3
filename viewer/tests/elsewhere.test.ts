import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import type { Material } from "../core/materials.ts";
import { parse } from "../core/safetensors.ts";
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

const NOTHING = Uint8Array.from(atob("/Td6WFoAAATm1rRGAAAAABzfRCEftvN9AQAAAAAEWVo="), (char) =>
  char.charCodeAt(0),
); // packed by xz

/** Return a file without its modes, as of an object whose modes all lie above hearing. */
function withoutModes(file: ArrayBuffer): ArrayBuffer {
  const { metadata, tensors } = parse(file);
  const modal = /^audio\.(amplitude|damped_frequency|damping|output\..*)$|^radiation\.(orders|steps)$/;
  let size = 0;
  const header: Record<string, unknown> = { __metadata__: metadata };
  const contents: Uint8Array[] = [];
  for (const [name, { dtype, shape, bytes }] of tensors) {
    const packed = name === "radiation.coefficients";
    const kept = packed ? NOTHING : modal.test(name) ? new Uint8Array() : bytes;
    const rows = packed ? NOTHING.length : modal.test(name) ? 0 : shape[0];
    header[name] = { dtype, shape: [rows, ...shape.slice(1)], data_offsets: [size, size + kept.length] };
    contents.push(kept);
    size += kept.length;
  }
  const head = new TextEncoder().encode(JSON.stringify(header));
  const start = new Uint8Array(new BigUint64Array([BigInt(head.length)]).buffer);
  return Uint8Array.from(Buffer.concat([start, head, ...contents])).buffer;
}

describe("a mug at a listener", () => {
  const file = new Uint8Array(readFileSync(SAMPLE)).buffer as ArrayBuffer;
  const mug = new Answers(file);
  const struck = (material: Material | null, size: number, struck = mug) =>
    struck.strike([0.3, 0, 0], {
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

  it("clicks without modes, as it does where they are not heard", () => {
    const click = struck(null, 1, new Answers(withoutModes(file)));
    expect(click.modes).toBe(0);
    expect(click.reference).toBeGreaterThan(0);
    const small = struck(null, 0.02);
    const peak = (samples: Float32Array) => Math.max(...samples.map(Math.abs));
    expect(peak(click.samples)).toBeGreaterThan(0);
    expect(peak(click.samples)).toBeLessThan(peak(small.samples)); // a heavier mug moves less
  });
});
