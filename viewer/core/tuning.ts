/** Modes of an object of another material or size, as objectfolder/sound/tuning.py. */

import type { Gains } from "./gains.ts";
import { damping, type Material } from "./materials.ts";
import type { Header } from "./objectfile.ts";

export const HEARING: [number, number] = [20, 20000];

/** Relative; the solved band may end at 20 kHz itself. */
const ROUNDING = 1e-6;

export interface Modes {
  /** Damped angular frequencies, rad/s. */
  frequency: Float64Array;
  /** Decay rates, 1/s. */
  damping: Float64Array;
  /** Which of the stored modes they are. */
  which: Int32Array;
  /** Multiplies the stored mode shapes. */
  shapeFactor: number;
  /** True frequencies are these multiples of `frequency`, at least and at most: of another Poisson ratio. */
  bounds: [number, number];
  /** Gaps and approximations, for people. */
  notes: string[];
}

/** The material that the modes were solved for; null if the file does not tell. */
export function ownMaterial(header: Header): Material | null {
  const properties = header.material_properties;
  return properties && header.audio?.band_hz ? { name: header.material, ...properties } : null;
}

/** Return the modes of the shape in a material, and of a size that is a multiple of the object's own. */
export function tuned(gains: Gains, header: Header, material: Material | null, size: number): Modes {
  const own = ownMaterial(header);
  const wanted = material ?? own;
  if (!own || !wanted || (wanted.name === own.name && size === 1))
    return {
      frequency: gains.frequency,
      damping: gains.damping,
      which: Int32Array.from(gains.frequency, (_, n) => n),
      shapeFactor: 1,
      bounds: [1, 1],
      notes: [
        ...uncertainty(header),
        ...(header.audio?.band_hz ? missingAbove(header.audio.band_hz[1]) : []),
      ],
    };
  const density = wanted.density / own.density;
  const factor = wanted.youngs_modulus / own.youngs_modulus / density / size ** 2;
  const top = Math.max(HEARING[1], header.audio!.band_hz![1]);
  const [low, high] = [HEARING[0], top].map((hertz) => (2 * Math.PI * hertz) ** 2);
  const kept = { frequency: [] as number[], damping: [] as number[], which: [] as number[] };
  for (let n = 0; n < gains.count; n++) {
    const eigenvalue = (gains.frequency[n] ** 2 + gains.damping[n] ** 2) * factor;
    const rate = damping(wanted, eigenvalue);
    if (eigenvalue <= Math.max(rate * rate, low) || eigenvalue >= high) continue;
    kept.frequency.push(Math.sqrt(eigenvalue - rate * rate));
    kept.damping.push(rate);
    kept.which.push(n);
  }
  const band = header.audio!.band_hz!.map((hertz) => hertz * Math.sqrt(factor)) as [number, number];
  return {
    frequency: Float64Array.from(kept.frequency),
    damping: Float64Array.from(kept.damping),
    which: Int32Array.from(kept.which),
    shapeFactor: 1 / Math.sqrt(density * size ** 3),
    bounds: bounds(own, wanted),
    notes: [...uncertainty(header), ...notes(band, own, wanted)],
  };
}

/** Between which multiples of the scaled frequencies those of another Poisson ratio lie. */
function bounds(own: Material, wanted: Material): [number, number] {
  const [old, now] = [own.poisson_ratio, wanted.poisson_ratio];
  const shear = Math.sqrt((1 + old) / (1 + now));
  const bulk = Math.sqrt((1 - 2 * old) / (1 - 2 * now));
  return [Math.min(shear, bulk), Math.max(shear, bulk)];
}

function notes(band: [number, number], own: Material, wanted: Material): string[] {
  const found: string[] = [];
  const [old, now] = [own.poisson_ratio, wanted.poisson_ratio];
  if (old !== now) {
    const [least, most] = bounds(own, wanted).map((ratio) => ratio.toFixed(3));
    found.push(
      `Approximate: the modes were solved with Poisson ratio ${old}, ${wanted.name} has ${now}. ` +
        `True frequencies are ${least} to ${most} times these.`,
    );
  }
  found.push(...missingAbove(band[1]));
  if (band[0] > HEARING[0] * (1 + ROUNDING))
    found.push(`Incomplete: modes below ${band[0].toFixed(0)} Hz were not solved and are missing.`);
  return found;
}

/** What is to be said of a sound that is marked uncertain. */
function uncertainty(header: Header): string[] {
  if (!header.audio?.uncertain) return [];
  const error = header.audio.frequency_uncertainty;
  const wrong =
    error === undefined
      ? "how wrong its frequencies are is not known"
      : `its lowest frequencies may be ${(100 * error).toFixed(0)}% wrong`;
  return [
    `Uncertain: ${wrong}, since walls or joints are thin for the grid that they were solved on. ` +
      "Thicken them and build again, or raise modal.fine.max_degrees_of_freedom.",
  ];
}

/** The gap between the end of the solved band (Hz) and that of hearing. */
function missingAbove(top: number): string[] {
  if (top >= HEARING[1] * (1 - ROUNDING)) return [];
  return [`Incomplete: modes above ${top.toFixed(0)} Hz were not solved and are missing.`];
}
