/** Modes of an object of another material or size, as objectfolder/audio/tuning.py. */

import type { Gains } from "./gains.ts";
import { damping, type Material } from "./materials.ts";
import type { Header } from "./objectfile.ts";

export const HEARING: [number, number] = [20, 20000];

export interface Modes {
  /** Damped angular frequencies, rad/s. */
  frequency: Float64Array;
  /** Decay rates, 1/s. */
  damping: Float64Array;
  /** Which of the stored modes they are. */
  which: Int32Array;
  /** Multiplies the stored mode shapes. */
  shapeFactor: number;
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
      notes: [],
    };
  const density = wanted.density / own.density;
  const factor = wanted.youngs_modulus / own.youngs_modulus / density / size ** 2;
  const [low, high] = HEARING.map((hertz) => (2 * Math.PI * hertz) ** 2);
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
    notes: notes(band, own, wanted),
  };
}

function notes(band: [number, number], own: Material, wanted: Material): string[] {
  const found: string[] = [];
  const [old, now] = [own.poisson_ratio, wanted.poisson_ratio];
  if (old !== now) {
    const shear = Math.sqrt((1 + old) / (1 + now));
    const bulk = Math.sqrt((1 - 2 * old) / (1 - 2 * now));
    const [least, most] = [Math.min(shear, bulk), Math.max(shear, bulk)].map((ratio) => ratio.toFixed(3));
    found.push(
      `Approximate: the modes were solved with Poisson ratio ${old}, ${wanted.name} has ${now}. ` +
        `True frequencies are ${least} to ${most} times these.`,
    );
  }
  const [low, high] = HEARING;
  if (band[1] < high * (1 - 1e-9))
    found.push(`Incomplete: modes above ${band[1].toFixed(0)} Hz were not solved and are missing.`);
  if (band[0] > low * (1 + 1e-9))
    found.push(`Incomplete: modes below ${band[0].toFixed(0)} Hz were not solved and are missing.`);
  return found;
}
