/** Places that are stored beside the grid where the surface has sharp edges or thin walls. */

import type { ObjectFile } from "./objectfile.ts";
import { FormatError } from "./safetensors.ts";
import { unxz } from "./xz.ts";

const STEPS = 255;
const MARGIN = 0.25; // voxels by which a point may lie outside its cell

export interface Features {
  /** Crossing of grid edges, from the lower sample (0) to the upper one (1), by 3 times the sample plus the axis. */
  crossings: Map<number, number>;
  /** Points of cells, in voxels, by the number of the lowest sample. */
  points: Map<number, [number, number, number]>;
}

/** Read the features of a file, if it has any. */
export function readFeatures(file: ObjectFile): Features | null {
  const { edges = 0, cells = 0, resolution: count } = file.header.geometry!;
  if (edges + cells === 0) return null;
  const raw = unxz(file.tensor("geometry.features").bytes, 5 * edges + 7 * cells);
  const crossings = new Map<number, number>();
  numbers(raw, 0, edges, 3 * count ** 3).forEach((edge, n) => {
    crossings.set(edge, raw[4 * edges + n] / STEPS);
  });
  const start = 5 * edges;
  const points = new Map<number, [number, number, number]>();
  numbers(raw, start, cells, count ** 3).forEach((cell, n) => {
    const low = [Math.floor(cell / count ** 2), Math.floor(cell / count) % count, cell % count];
    const at = (axis: number) =>
      low[axis] + (raw[start + (4 + axis) * cells + n] / STEPS) * (1 + 2 * MARGIN) - MARGIN;
    points.set(cell, [at(0), at(1), at(2)]);
  });
  return { crossings, points };
}

/** Return ascending numbers from their differences, whose lowest bytes come first, then the second ones. */
function numbers(raw: Uint8Array, start: number, count: number, end: number): number[] {
  const found: number[] = [];
  let sum = 0;
  for (let n = 0; n < count; n++) {
    const step =
      raw[start + n] +
      raw[start + count + n] * 2 ** 8 +
      raw[start + 2 * count + n] * 2 ** 16 +
      raw[start + 3 * count + n] * 2 ** 24;
    sum += step;
    if (sum >= end || (n > 0 && step === 0))
      throw new FormatError("features of the geometry are out of order, or outside the grid");
    found.push(sum);
  }
  return found;
}
