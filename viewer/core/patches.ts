/** Random points of a surface, which stand for the surface around them, and the search for near ones. */

import { BOUND, type Grid } from "./grid.ts";
import type { Mesh } from "./surface.ts";

const TURN = 0.1; // distance in the unit frame that one radian between normals counts as

/** Uniform random numbers of a seed (mulberry32). */
export function randoms(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

export class Patches {
  readonly position: Float32Array;
  readonly normal: Float32Array;
  private readonly cell: number;
  private readonly side: number; // cells along each axis
  /** Where the members of each cell begin in their list. */
  private readonly first: Int32Array;
  private readonly members: Int32Array;

  /** Draw points uniformly by area. */
  constructor(
    grid: Grid,
    mesh: Mesh,
    readonly count: number,
    random: () => number,
  ) {
    const { position, index } = mesh;
    const sums = new Float64Array(index.length / 3);
    let total = 0;
    for (let f = 0; f < sums.length; f++) {
      const [a, b, c] = [3 * index[3 * f], 3 * index[3 * f + 1], 3 * index[3 * f + 2]];
      const u = [0, 1, 2].map((axis) => position[b + axis] - position[a + axis]);
      const v = [0, 1, 2].map((axis) => position[c + axis] - position[a + axis]);
      total +=
        Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]) / 2;
      sums[f] = total;
    }
    this.position = new Float32Array(3 * count);
    this.normal = new Float32Array(3 * count);
    let face = 0;
    for (let n = 0; n < count; n++) {
      const wanted = ((n + random()) / count) * total; // stratified along the list of triangles
      while (face < sums.length - 1 && sums[face] < wanted) face++;
      const root = Math.sqrt(random());
      const second = random();
      const weights = [1 - root, root * (1 - second), root * second];
      for (let axis = 0; axis < 3; axis++)
        for (let c = 0; c < 3; c++)
          this.position[3 * n + axis] += weights[c] * position[3 * index[3 * face + c] + axis];
      const [x, y, z] = this.position.subarray(3 * n, 3 * n + 3);
      grid.normal(x, y, z, this.normal, 3 * n);
    }
    this.cell = 2 * Math.sqrt(total / count);
    this.side = Math.ceil((2 * BOUND) / this.cell) + 1;
    this.first = new Int32Array(this.side ** 3 + 1);
    this.members = new Int32Array(count);
    const cells = Int32Array.from({ length: count }, (_, n) => {
      const [i, j, k] = [0, 1, 2].map((axis) => this.place(this.position[3 * n + axis]));
      return (i * this.side + j) * this.side + k;
    });
    for (const cell of cells) this.first[cell + 1]++;
    for (let cell = 0; cell < this.side ** 3; cell++) this.first[cell + 1] += this.first[cell];
    const next = this.first.slice();
    cells.forEach((cell, n) => {
      this.members[next[cell]++] = n;
    });
  }

  /** Return the number of a coordinate's cell along an axis. */
  private place(coordinate: number): number {
    return Math.min(Math.max(Math.floor((coordinate + BOUND) / this.cell), 0), this.side - 1);
  }

  /**
   * Find near patches that face nearly the same way.
   *
   * @param place their numbers, nearest first; -1 beyond the last
   * @param apart squares of their distances
   */
  nearest(
    x: number,
    y: number,
    z: number,
    nx: number,
    ny: number,
    nz: number,
    place: Int32Array,
    apart: Float64Array,
  ): void {
    place.fill(-1);
    apart.fill(Number.POSITIVE_INFINITY);
    const { side, position, normal, first, members } = this;
    const last = place.length - 1;
    const [ci, cj, ck] = [this.place(x), this.place(y), this.place(z)];
    for (let reach = 1; reach < 8 && place[last] < 0; reach++)
      for (let i = Math.max(ci - reach, 0); i <= Math.min(ci + reach, side - 1); i++)
        for (let j = Math.max(cj - reach, 0); j <= Math.min(cj + reach, side - 1); j++)
          for (let k = Math.max(ck - reach, 0); k <= Math.min(ck + reach, side - 1); k++) {
            const inner =
              Math.abs(i - ci) < reach && Math.abs(j - cj) < reach && Math.abs(k - ck) < reach && reach > 1;
            if (inner) continue;
            const cell = (i * side + j) * side + k;
            for (let m = first[cell]; m < first[cell + 1]; m++) {
              const n = members[m];
              const p = 3 * n;
              const dx = position[p] - x;
              const dy = position[p + 1] - y;
              const dz = position[p + 2] - z;
              const tx = normal[p] - nx;
              const ty = normal[p + 1] - ny;
              const tz = normal[p + 2] - nz;
              const square = dx * dx + dy * dy + dz * dz + TURN ** 2 * (tx * tx + ty * ty + tz * tz);
              if (square >= apart[last]) continue;
              let at = last;
              for (; at > 0 && apart[at - 1] > square; at--) {
                apart[at] = apart[at - 1];
                place[at] = place[at - 1];
              }
              apart[at] = square;
              place[at] = n;
            }
          }
  }
}
