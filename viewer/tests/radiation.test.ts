import { describe, expect, it } from "vitest";
import type { ObjectFile } from "../core/objectfile.ts";
import { harmonics, Radiation } from "../core/radiation.ts";
import { synthesise } from "../core/synthesis.ts";
import type { Modes } from "../core/tuning.ts";
import type { Vector } from "../core/vector.ts";
import truth from "./heard.json" with { type: "json" }; // written by tests/viewer/test_heard.py

const bytes = (array: { buffer: ArrayBufferLike }) => new Uint8Array(array.buffer);
const coefficients = Uint8Array.from(atob(truth.coefficients), (char) => char.charCodeAt(0));
const tensors: Record<string, { dtype: string; shape: number[]; bytes: Uint8Array }> = {
  "radiation.orders": { dtype: "U8", shape: [3], bytes: Uint8Array.from(truth.orders) },
  "radiation.steps": { dtype: "F32", shape: [3], bytes: bytes(Float32Array.from(truth.steps)) },
  "radiation.coefficients": { dtype: "U8", shape: [coefficients.length], bytes: coefficients },
};
const { radius, recoil, scale, volume } = truth;
const file = {
  header: { scale, solid: { volume }, radiation: { kind: "spherical_harmonics", radius, recoil } },
  tensor: (name: string) => tensors[name],
} as unknown as ObjectFile;
const modes: Modes = {
  frequency: Float64Array.from(truth.frequency),
  damping: Float64Array.from(truth.damping),
  which: Int32Array.from([0, 1, 2]),
  shapeFactor: truth.factor,
  bounds: [1, 1],
  notes: [],
};
const radiation = Radiation.read(file, Float64Array.from(truth.own))!;
const heard = (listener: Vector) =>
  radiation.heard(modes, truth.gains, listener, truth.impulse, truth.size, truth.density);

describe("at a listener", () => {
  it.each(truth.sounds)(
    "the sound is the library's, after a contact of $contact s",
    ({ contact, samples }) => {
      const strike = {
        rate: truth.rate,
        duration: samples.length / truth.rate,
        contact,
        response: "displacement" as const,
      };
      const found = synthesise(heard(truth.listener as Vector), strike);
      const peak = samples.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
      samples.forEach((value, n) => {
        expect(Math.abs(found[n] - value) / peak).toBeLessThan(2e-5);
      });
    },
  );

  it("nobody is inside the ball that holds the object", () => {
    const [near, there] = [heard([0.01, 0, 0]), heard([1.01 * radius, 0, 0])];
    for (let n = 0; n < 6; n++) expect(near.real[n] / there.real[n]).toBeCloseTo(1, 9);
  });

  it("another size keeps the ratio of wavelength to size, another material does not", () => {
    expect(radiation.holds(modes, truth.size)).toBe(true);
    expect(radiation.holds(modes, 1)).toBe(false);
    // Of another Poisson ratio the frequencies are not known to a hundredth.
    expect(radiation.holds({ ...modes, bounds: [0.9, 1] }, truth.size)).toBe(false);
    expect(radiation.holds({ ...modes, bounds: [1, 1.1] }, truth.size)).toBe(false);
  });

  it("a file without radiation has none", () => {
    expect(Radiation.read({ header: {} } as unknown as ObjectFile, new Float64Array(3))).toBe(null);
  });
});

describe("harmonics", () => {
  it("of the first degrees are those of textbooks", () => {
    const [x, y, z] = [0.48, -0.6, 0.64];
    const found = harmonics([x, y, z], 2);
    const one = Math.sqrt(3 / (4 * Math.PI));
    const two = Math.sqrt(15 / (4 * Math.PI));
    const expected = [
      Math.sqrt(1 / (4 * Math.PI)),
      ...[one * y, one * z, one * x],
      ...[two * x * y, two * y * z, Math.sqrt(5 / (16 * Math.PI)) * (3 * z * z - 1), two * z * x],
      (two / 2) * (x * x - y * y),
    ];
    expected.forEach((value, k) => {
      expect(found[k]).toBeCloseTo(value, 12);
    });
  });
});
