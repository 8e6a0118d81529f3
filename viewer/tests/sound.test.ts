import { describe, expect, it } from "vitest";
import type { Gains } from "../core/gains.ts";
import { contactTime, damping, type Material } from "../core/materials.ts";
import type { Header } from "../core/objectfile.ts";
import { plain as gained, synthesise } from "../core/synthesis.ts";
import { type Modes, tuned } from "../core/tuning.ts";

const STEEL: Material = {
  name: "steel",
  density: 7850,
  youngs_modulus: 2e11,
  poisson_ratio: 0.29,
  alpha: 5,
  beta: 3e-8,
};

const gains = (hertz: number[]): Gains =>
  ({
    frequency: Float64Array.from(hertz, (f) => 2 * Math.PI * f),
    damping: new Float64Array(hertz.length).fill(10),
    count: hertz.length,
  }) as unknown as Gains;

const header = (band: [number, number]): Header => {
  const { name, ...properties } = STEEL;
  return {
    format: "1.2",
    key: "a",
    material: name,
    scale: 0.1,
    material_properties: properties,
    audio: { kind: "gains", net: { resolution: 1, channels: 1, frequency: 1 }, band_hz: band },
  };
};

const modes = (hertz: number[], rate = 10): Modes => ({
  frequency: Float64Array.from(hertz, (f) => 2 * Math.PI * f),
  damping: new Float64Array(hertz.length).fill(rate),
  which: Int32Array.from(hertz.keys()),
  shapeFactor: 1,
  bounds: [1, 1],
  notes: [],
});

describe("synthesis", () => {
  const plain = { rate: 44100, duration: 0.5, contact: 0, silence: 0 };

  it("of an impulse is a damped sinusoid", () => {
    const sound = synthesise(gained(modes([440]), [2]), { ...plain, response: "displacement" });
    const w = 2 * Math.PI * 440;
    sound.forEach((value, n) => {
      const t = n / 44100;
      expect(value).toBeCloseTo((2 / w) * Math.exp(-10 * t) * Math.sin(w * t), 9);
    });
  });

  it("of a strike of finite duration is the convolution with its force", () => {
    const contact = 2e-3;
    const sound = synthesise(gained(modes([440]), [1]), { ...plain, contact, response: "displacement" });
    const w = 2 * Math.PI * 440;
    for (const n of [20, 60, 200, 5000]) {
      const t = n / 44100;
      let sum = 0;
      const steps = 4000;
      for (let k = 0; k < steps; k++) {
        const at = ((k + 0.5) / steps) * contact;
        if (at > t) break;
        const force = (Math.PI / (2 * contact)) * Math.sin((Math.PI * at) / contact);
        sum += (force * Math.exp(-10 * (t - at)) * Math.sin(w * (t - at)) * contact) / steps / w;
      }
      expect(sound[n] / sum).toBeCloseTo(1, 3);
    }
  });

  it("leaves out modes that would alias", () => {
    const strike = { ...plain, response: "acceleration" as const };
    expect(synthesise(gained(modes([23000]), [1]), strike).every((value) => value === 0)).toBe(true);
  });

  it("is hardly changed by the end of quiet modes", () => {
    const strike = { ...plain, response: "acceleration" as const };
    const whole = synthesise(gained(modes([440, 3000], 60), [1, 0.01]), strike);
    const cut = synthesise(gained(modes([440, 3000], 60), [1, 0.01]), { ...strike, silence: 1e-5 });
    const norm = (a: Float32Array) => Math.hypot(...a);
    expect(norm(whole.map((value, n) => value - cut[n])) / norm(whole)).toBeLessThan(1e-4);
  });
});

describe("another material or size", () => {
  it("of twice the size sounds an octave lower, and misses what was not solved", () => {
    const found = tuned(gains([1000, 4000]), header([0, 20000]), null, 2);
    expect(found.frequency[0] / (2 * Math.PI)).toBeCloseTo(500, 0);
    expect(found.shapeFactor).toBeCloseTo(2 ** -1.5);
    expect(found.notes).toEqual(["Incomplete: modes above 10000 Hz were not solved and are missing."]);
  });

  it("tells that the sound is marked uncertain, by how much if that is known", () => {
    const marked = (error?: number): Header => {
      const plain = header([0, 20000]);
      return { ...plain, audio: { ...plain.audio!, uncertain: true, frequency_uncertainty: error } };
    };
    for (const size of [1, 0.5])
      expect(tuned(gains([1000]), marked(0.48), null, size).notes[0]).toContain("may be 48% wrong");
    expect(tuned(gains([1000]), marked(), null, 1).notes).toHaveLength(1);
    expect(tuned(gains([1000]), marked(), null, 1).notes[0]).toContain("not known");
    expect(tuned(gains([1000]), header([0, 20000]), null, 1).notes).toEqual([]);
  });

  it("tells that another Poisson ratio is approximate", () => {
    const found = tuned(gains([1000]), header([0, 1e6]), { ...STEEL, name: "cork", poisson_ratio: 0 }, 1);
    expect(found.notes[0]).toContain("Poisson ratio 0.29, cork has 0");
    expect(found.bounds[0]).toBeCloseTo(Math.sqrt(0.42), 9); // in compression
    expect(found.bounds[1]).toBeCloseTo(Math.sqrt(1.29), 9); // in shear
  });

  it("tells what the own material lacks, too", () => {
    const own = tuned(gains([1000]), header([0, 7000]), null, 1);
    expect(own.notes).toEqual(["Incomplete: modes above 7000 Hz were not solved and are missing."]);
    expect(own.bounds).toEqual([1, 1]);
    expect(tuned(gains([1000]), header([0, 20000 * (1 - 1e-7)]), null, 1).notes).toEqual([]);
  });

  it("damps by a loss factor where one is given", () => {
    const eigenvalue = (2 * Math.PI * 1500) ** 2;
    const lossy: Material = {
      ...STEEL,
      loss_factor: [
        [1000, 0.01],
        [2000, 0.03],
      ],
    };
    expect(damping(lossy, eigenvalue)).toBeCloseTo((0.02 * 2 * Math.PI * 1500) / 2);
    expect(damping(STEEL, eigenvalue)).toBeCloseTo((5 + 3e-8 * eigenvalue) / 2);
  });
});

describe("a strike", () => {
  it("lasts as long as the library's", () => {
    const striker = { youngs_modulus: 2e11, poisson_ratio: 0.29, radius: 0.005, mass: 0.01, speed: 1 };
    expect(contactTime(striker, STEEL, 0.36)).toBeCloseTo(4.98660436389e-5, 9);
    expect(contactTime(striker, STEEL, Number.POSITIVE_INFINITY)).toBeCloseTo(5.04155607567e-5, 9);
  });
});
