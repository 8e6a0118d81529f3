/** Random points of a surface, which stand for the surface around them, and the search for near ones. */

import type { Grid } from "./grid.ts";
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
  private readonly members = new Map<number, number[]>();

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
    for (let n = 0; n < count; n++) {
      const key = this.key(this.position[3 * n], this.position[3 * n + 1], this.position[3 * n + 2]);
      const found = this.members.get(key);
      if (found) found.push(n);
      else this.members.set(key, [n]);
    }
  }

  private key(x: number, y: number, z: number): number {
    const { cell } = this;
    return (
      (Math.floor(x / cell) + 512) * 2 ** 20 +
      (Math.floor(y / cell) + 512) * 2 ** 10 +
      Math.floor(z / cell) +
      512
    );
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
    const { cell, position, normal } = this;
    const last = place.length - 1;
    for (let reach = 1; reach < 8 && place[last] < 0; reach++)
      for (let i = -reach; i <= reach; i++)
        for (let j = -reach; j <= reach; j++)
          for (let k = -reach; k <= reach; k++) {
            if (reach > 1 && Math.max(Math.abs(i), Math.abs(j), Math.abs(k)) < reach) continue;
            const members = this.members.get(this.key(x + i * cell, y + j * cell, z + k * cell));
            if (!members) continue;
            for (const n of members) {
              const p = 3 * n;
              const square =
                (position[p] - x) ** 2 +
                (position[p + 1] - y) ** 2 +
                (position[p + 2] - z) ** 2 +
                TURN ** 2 * ((normal[p] - nx) ** 2 + (normal[p + 1] - ny) ** 2 + (normal[p + 2] - nz) ** 2);
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
