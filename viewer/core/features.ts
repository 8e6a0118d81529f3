/** Places that are stored beside the grid where the surface has sharp edges or thin walls. */

import type { ObjectFile } from "./objectfile.ts";
import { damaged } from "./safetensors.ts";
import { unxz } from "./xz.ts";

const STEPS = 255;
const MARGIN = 0.25; // voxels by which a point may lie outside its cell
const REACH = 1; // voxels by which a vertex of a thin wall may lie off the middle of its edge
const ORIGIN = 127;

export interface Features {
  /** Crossing of grid edges, from the lower sample (0) to the upper one (1), by 3 times the sample plus the axis. */
  crossings: Map<number, number>;
  /** Points of cells, in voxels, by the number of the lowest sample. */
  points: Map<number, [number, number, number]>;
  /** Samples that count as inside, in walls under a voxel. */
  sheets: number[];
  /** Vertices on the edges from those to samples outside, in voxels, by the number of the edge. */
  moved: Map<number, [number, number, number]>;
}

/** Read the features of a file, if it has any. */
export function readFeatures(file: ObjectFile): Features | null {
  const { edges = 0, cells = 0, sheets = 0, moved = 0, resolution: count } = file.header.geometry!;
  if (edges + cells + sheets + moved === 0) return null;
  const size = 5 * edges + 7 * cells + 4 * sheets + 7 * moved;
  const raw = unxz(file.tensor("geometry.features").bytes, size);
  const crossings = new Map<number, number>();
  numbers(raw, 0, edges, 3 * count ** 3).forEach((edge, n) => {
    crossings.set(edge, raw[4 * edges + n] / STEPS);
  });
  const low = (sample: number) => [
    Math.floor(sample / count ** 2),
    Math.floor(sample / count) % count,
    sample % count,
  ];
  /** Read numbers, each with a place in three bytes. */
  const places = (
    start: number,
    many: number,
    end: number,
    at: (n: number, byte: number, axis: number) => number,
  ) =>
    new Map(
      numbers(raw, start, many, end).map((number, n) => {
        const place = [0, 1, 2].map((axis) => at(number, raw[start + (4 + axis) * many + n], axis));
        return [number, place as [number, number, number]];
      }),
    );
  const points = places(
    5 * edges,
    cells,
    count ** 3,
    (cell, byte, axis) => low(cell)[axis] + (byte / STEPS) * (1 + 2 * MARGIN) - MARGIN,
  );
  const listed = 5 * edges + 7 * cells;
  return {
    crossings,
    points,
    sheets: numbers(raw, listed, sheets, count ** 3),
    moved: places(
      listed + 4 * sheets,
      moved,
      3 * count ** 3,
      (edge, byte, axis) =>
        low(Math.floor(edge / 3))[axis] + (edge % 3 === axis ? 0.5 : 0) + REACH * (byte / ORIGIN - 1),
    ),
  };
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
      throw damaged("its surface features are out of order, or outside the grid");
    found.push(sum);
  }
  return found;
}
