/** Stored geometry: signed distances on a cubic grid, clipped to a band, trilinear between samples. */

import type { ObjectFile } from "./objectfile.ts";
import type { Vector } from "./vector.ts";
import { unxz } from "./xz.ts";

/** The grid spans [-BOUND, BOUND]^3 of the unit frame. */
export const BOUND = 0.52;
const EDGE = 0.519; // rays are clipped to a cube that is a little smaller
const BLOCK = 4; // voxels a side of the blocks whose distance to the surface is known
const FARTHEST = 8; // blocks, the largest distance

export class Grid {
  readonly spacing: number;
  private readonly side: number;
  private emptiness: Uint8Array | null = null;

  constructor(
    readonly values: Int8Array,
    readonly count: number,
    readonly band: number,
  ) {
    this.spacing = (2 * BOUND) / (count - 1);
    this.side = Math.ceil((count - 1) / BLOCK);
  }

  static read(file: ObjectFile): Grid {
    const { resolution: count, predictor, band } = file.header.geometry!;
    const packed = file.tensor("geometry.distances").bytes;
    const values = new Int8Array(unxz(packed, count ** 3).buffer);
    if (predictor === "planes") restore(values, count * count);
    return new Grid(values, count, band);
  }

  /** Distances of the blocks to the surface; the first use takes tens of milliseconds. */
  private get blocks(): Uint8Array {
    this.emptiness ??= emptiness(this.values, this.count, this.side);
    return this.emptiness;
  }

  /** Distance at a point of the unit frame; beyond the border, that of the border. */
  distance(x: number, y: number, z: number): number {
    const { values: v, count } = this;
    const last = count - 1;
    const s = 1 / this.spacing;
    const a = Math.min(Math.max((x + BOUND) * s, 0), last);
    const b = Math.min(Math.max((y + BOUND) * s, 0), last);
    const c = Math.min(Math.max((z + BOUND) * s, 0), last);
    const i = Math.min(a | 0, last - 1);
    const j = Math.min(b | 0, last - 1);
    const k = Math.min(c | 0, last - 1);
    const u = a - i;
    const w = b - j;
    const t = c - k;
    const n = count * count;
    const q = i * n + j * count + k;
    const r = q + count;
    const low = (v[q] * (1 - t) + v[q + 1] * t) * (1 - w) + (v[r] * (1 - t) + v[r + 1] * t) * w;
    const high =
      (v[q + n] * (1 - t) + v[q + n + 1] * t) * (1 - w) + (v[r + n] * (1 - t) + v[r + n + 1] * t) * w;
    return (low * (1 - u) + high * u) * (this.band / 127);
  }

  /** Write the outward unit normal, by tetrahedral differences half a voxel wide. */
  normal(x: number, y: number, z: number, out: { [index: number]: number }, at = 0): void {
    const h = this.spacing / 2;
    const a = this.distance(x + h, y - h, z - h);
    const b = this.distance(x - h, y - h, z + h);
    const c = this.distance(x - h, y + h, z - h);
    const d = this.distance(x + h, y + h, z + h);
    const p = a - b - c + d;
    const q = -a - b + c + d;
    const r = -a + b - c + d;
    const size = Math.sqrt(p * p + q * q + r * r) || 1;
    out[at] = p / size;
    out[at + 1] = q / size;
    out[at + 2] = r / size;
  }

  /** Project a point within the band to the surface, by Newton steps. */
  nearest(point: Vector): Vector {
    const moved: Vector = [...point];
    const normal: Vector = [0, 0, 0];
    for (let step = 0; step < 3; step++) {
      const distance = this.distance(moved[0], moved[1], moved[2]);
      this.normal(moved[0], moved[1], moved[2], normal);
      for (let axis = 0; axis < 3; axis++) moved[axis] -= distance * normal[axis];
    }
    return moved;
  }

  /** Distance by cubic convolution (Keys 1981), which contact normals use. */
  smoothDistance(x: number, y: number, z: number): number {
    const { values, count } = this;
    const s = 1 / this.spacing;
    const place = [(x + BOUND) * s, (y + BOUND) * s, (z + BOUND) * s];
    const first = place.map(Math.floor);
    const [wx, wy, wz] = place.map((p, axis) => keys(p - first[axis]));
    const clip = (n: number) => (n < 0 ? 0 : n >= count ? count - 1 : n);
    let total = 0;
    for (let i = 0; i < 4; i++) {
      let plane = 0;
      for (let j = 0; j < 4; j++) {
        const base = (clip(first[0] + i - 1) * count + clip(first[1] + j - 1)) * count;
        let line = 0;
        for (let k = 0; k < 4; k++) line += wz[k] * values[base + clip(first[2] + k - 1)];
        plane += wy[j] * line;
      }
      total += wx[i] * plane;
    }
    return total * (this.band / 127);
  }

  /**
   * Return how far a ray of unit direction goes until it enters the object; Infinity if it does not.
   *
   * Blocks of voxels without surface are crossed at once.
   */
  cast(origin: Vector, direction: Vector, longest = Number.POSITIVE_INFINITY): number {
    let begin = 0;
    let end = longest;
    for (let axis = 0; axis < 3; axis++) {
      if (direction[axis] === 0) {
        if (Math.abs(origin[axis]) > EDGE) return Number.POSITIVE_INFINITY;
        continue;
      }
      const one = (-EDGE - origin[axis]) / direction[axis];
      const other = (EDGE - origin[axis]) / direction[axis];
      begin = Math.max(begin, Math.min(one, other));
      end = Math.min(end, Math.max(one, other));
    }
    const { side, blocks, spacing } = this;
    const cell = spacing * BLOCK;
    const steepest = Math.max(Math.abs(direction[0]), Math.abs(direction[1]), Math.abs(direction[2]));
    const least = spacing * 0.15;
    let before = begin;
    for (let t = begin; t < end; ) {
      const x = origin[0] + t * direction[0];
      const y = origin[1] + t * direction[1];
      const z = origin[2] + t * direction[2];
      const i = Math.min(((x + BOUND) / cell) | 0, side - 1);
      const j = Math.min(((y + BOUND) / cell) | 0, side - 1);
      const k = Math.min(((z + BOUND) / cell) | 0, side - 1);
      const free = blocks[(i * side + j) * side + k];
      if (free > 1) {
        before = t;
        t += ((free - 1) * cell) / steepest;
        continue;
      }
      const distance = this.distance(x, y, z);
      if (distance <= 0) return t === begin ? t : this.bisect(origin, direction, before, t);
      before = t;
      t += Math.max(distance * 0.8, least);
    }
    return Number.POSITIVE_INFINITY;
  }

  private bisect(origin: Vector, direction: Vector, outside: number, inside: number): number {
    let [low, high] = [outside, inside];
    for (let step = 0; step < 12; step++) {
      const t = (low + high) / 2;
      const x = origin[0] + t * direction[0];
      const y = origin[1] + t * direction[1];
      const z = origin[2] + t * direction[2];
      if (this.distance(x, y, z) > 0) low = t;
      else high = t;
    }
    return high;
  }
}

/** Add the extrapolation of the two planes before each plane, clipped, modulo 256. */
function restore(values: Int8Array, plane: number): void {
  for (let k = plane; k < 2 * plane; k++) values[k] += values[k - plane];
  for (let k = 2 * plane; k < values.length; k++) {
    const guess = 2 * values[k - plane] - values[k - 2 * plane];
    values[k] += Math.min(Math.max(guess, -127), 127);
  }
}

/** Weights of the samples at -1, 0, 1 and 2. */
function keys(t: number): number[] {
  return [
    (t * (t * (2 - t) - 1)) / 2,
    (t * t * (3 * t - 5) + 2) / 2,
    (t * (t * (4 - 3 * t) + 1)) / 2,
    (t * t * (t - 1)) / 2,
  ];
}

/** Return each block's distance, in blocks and in the maximum norm, to a block that is not all outside. */
function emptiness(values: Int8Array, count: number, side: number): Uint8Array {
  const far = new Uint8Array(side ** 3).fill(255);
  for (let x = 0; x < count; x++)
    for (let y = 0; y < count; y++) {
      const row = (x * count + y) * count;
      for (let z = 0; z < count; z++)
        if (values[row + z] < 127) {
          const [i, j, k] = [x, y, z].map((n) => Math.min(Math.floor(n / BLOCK), side - 1));
          far[(i * side + j) * side + k] = 0;
          z = Math.min((k + 1) * BLOCK, count) - 1;
        }
    }
  // A block's last samples belong to its neighbour: distances count from one block less.
  let reached: Uint8Array = far;
  for (let level = 1; level <= FARTHEST; level++) {
    let grown: Uint8Array = reached;
    for (const step of [side * side, side, 1]) grown = dilated(grown, side, step);
    for (let n = 0; n < far.length; n++) if (far[n] === 255 && grown[n] !== 255) far[n] = level;
    reached = grown;
  }
  for (let n = 0; n < far.length; n++) far[n] = Math.min(far[n], FARTHEST + 1);
  return far;
}

/** Return which blocks, or neighbours of them along an axis, are marked by anything but 255. */
function dilated(marks: Uint8Array, side: number, step: number): Uint8Array {
  const grown = marks.slice();
  for (let n = 0; n < marks.length; n++) {
    if (marks[n] === 255) continue;
    const place = Math.floor(n / step) % side;
    if (place > 0) grown[n - step] = Math.min(grown[n - step], marks[n]);
    if (place < side - 1) grown[n + step] = Math.min(grown[n + step], marks[n]);
  }
  return grown;
}
