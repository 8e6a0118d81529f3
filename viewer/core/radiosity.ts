/** Diffuse interreflection (Goral et al. 1984) between patches of the surface, as objectfolder/vision/radiosity.py. */

import type { Grid } from "./grid.ts";
import { Patches, randoms } from "./patches.ts";
import type { Mesh } from "./surface.ts";
import { along, type Vector } from "./vector.ts";

const PATCHES = 8192;
const SIDE = 9; // each patch casts SIDE x SIDE rays over its hemisphere
const BOUNCES = 2;
const NEIGHBOURS = 4; // patches from which values at a vertex are interpolated
const START = 0.3; // voxels along the normal where rays start
const HORIZON = 0.035; // sine of the angle behind a surface from which light may still reach it
const SHADOW_START = 0.3; // voxels; the trilinear surface lies beside the triangles

/** Light that reaches the patches from others, as if they were white, and what they give off; (P, 3) each. */
export interface Solution {
  gathered: Float32Array;
  outgoing: Float32Array;
  lit: Uint8Array;
}

export class Radiosity {
  readonly patches: Patches;
  /** Patches that each ray of each patch meets; -1 if none. */
  private readonly met: Int32Array;
  private readonly random = randoms(1);
  private readonly facing = [0, 0, 0];
  private readonly place = new Int32Array(1);
  private readonly apart = new Float64Array(1);

  constructor(
    private readonly grid: Grid,
    mesh: Mesh,
  ) {
    this.patches = new Patches(grid, mesh, PATCHES, this.random);
    this.met = new Int32Array(PATCHES * SIDE * SIDE).fill(-1);
  }

  get count(): number {
    return PATCHES;
  }

  /** Cast the rays of the patches from one number up to another. */
  connect(from: number, to: number): void {
    const { normal } = this.patches;
    for (let n = from; n < to; n++) {
      const up: Vector = [normal[3 * n], normal[3 * n + 1], normal[3 * n + 2]];
      const start = this.lifted(n, START);
      const [across, along] = basis(up);
      for (let ray = 0; ray < SIDE * SIDE; ray++) {
        const square = (Math.floor(ray / SIDE) + this.random()) / SIDE;
        const azimuth = (2 * Math.PI * ((ray % SIDE) + this.random())) / SIDE;
        const [a, b, c] = [
          Math.sqrt(square) * Math.cos(azimuth),
          Math.sqrt(square) * Math.sin(azimuth),
          Math.sqrt(1 - square),
        ];
        const direction = [0, 1, 2].map((i) => a * across[i] + b * along[i] + c * up[i]) as Vector;
        this.met[n * SIDE * SIDE + ray] = this.hit(start, direction);
      }
    }
  }

  /** Return which patches see others. */
  sees(): Uint8Array {
    const found = new Uint8Array(PATCHES);
    this.met.forEach((other, ray) => {
      if (other >= 0) found[Math.floor(ray / SIDE ** 2)] = 1;
    });
    return found;
  }

  /** Return the patch that a ray meets, or -1. */
  private hit(start: Vector, direction: Vector): number {
    const at = this.seen(start, direction);
    if (!at) return -1;
    const [x, y, z] = at;
    const [nx, ny, nz] = this.facing;
    this.patches.nearest(x, y, z, nx, ny, nz, this.place, this.apart);
    return this.place[0];
  }

  /** Return the point that a ray meets, if any; its normal is in `facing`. */
  private seen(start: Vector, direction: Vector): Vector | null {
    const distance = this.grid.cast(start, direction);
    if (distance === Number.POSITIVE_INFINITY) return null;
    const at = along(start, distance, direction);
    this.grid.normal(at[0], at[1], at[2], this.facing);
    return at;
  }

  /** Find what a mirrored ray meets, and connect it to patches; return whether it meets anything. */
  reflect(n: number, to: Interpolation, point: Vector, outward: Vector, direction: Vector): boolean {
    const at = this.seen(along(point, START * this.grid.spacing, outward), direction);
    if (at) to.connect(n, at, this.facing, 0);
    return at !== null;
  }

  /** Return a patch's place, some voxels along its normal. */
  private lifted(n: number, voxels: number): Vector {
    const { position, normal } = this.patches;
    const h = voxels * this.grid.spacing;
    return [0, 1, 2].map((axis) => position[3 * n + axis] + h * normal[3 * n + axis]) as Vector;
  }

  /** Solve for a point light. @param reflectance (P, 3), diffuse */
  solve(light: Vector, reflectance: Float32Array): Solution {
    const { position, normal } = this.patches;
    const received = new Float32Array(PATCHES);
    const lit = new Uint8Array(PATCHES);
    for (let n = 0; n < PATCHES; n++) {
      const to = [0, 1, 2].map((axis) => light[axis] - position[3 * n + axis]) as Vector;
      const far = Math.hypot(to[0], to[1], to[2]);
      const cosine = (to[0] * normal[3 * n] + to[1] * normal[3 * n + 1] + to[2] * normal[3 * n + 2]) / far;
      if (cosine <= -HORIZON) continue;
      const start = this.lifted(n, SHADOW_START);
      const ray = [0, 1, 2].map((axis) => light[axis] - start[axis]) as Vector;
      const length = Math.hypot(ray[0], ray[1], ray[2]);
      const free =
        this.grid.cast(start, ray.map((c) => c / length) as Vector, length) === Number.POSITIVE_INFINITY;
      lit[n] = free ? 1 : 0;
      if (free) received[n] = Math.max(cosine, 0) / far ** 2;
    }
    const outgoing = (gathered: Float32Array) =>
      gathered.map((value, k) => reflectance[k] * (received[Math.floor(k / 3)] + value));
    let gathered: Float32Array = new Float32Array(3 * PATCHES);
    for (let bounce = 0; bounce < BOUNCES; bounce++) gathered = this.spread(outgoing(gathered));
    return { gathered, outgoing: outgoing(gathered), lit };
  }

  private spread(from: Float32Array): Float32Array {
    const rays = SIDE * SIDE;
    const to = new Float32Array(3 * PATCHES);
    for (let n = 0; n < PATCHES; n++) {
      let [red, green, blue] = [0, 0, 0];
      for (let ray = n * rays; ray < (n + 1) * rays; ray++) {
        const other = 3 * this.met[ray];
        if (other < 0) continue;
        red += from[other];
        green += from[other + 1];
        blue += from[other + 2];
      }
      to[3 * n] = red / rays;
      to[3 * n + 1] = green / rays;
      to[3 * n + 2] = blue / rays;
    }
    return to;
  }
}

/** Weights by which values at patches are interpolated at points. */
export class Interpolation {
  private readonly patch: Int32Array;
  private readonly weight: Float32Array;
  private readonly apart = new Float64Array(NEIGHBOURS);

  constructor(
    private readonly patches: Patches,
    readonly count: number,
  ) {
    this.patch = new Int32Array(NEIGHBOURS * count);
    this.weight = new Float32Array(NEIGHBOURS * count);
  }

  /** Find the patches of a point; arrays hold points and normals of many, and this one at a place. */
  connect(n: number, position: ArrayLike<number>, normal: ArrayLike<number>, k: number): void {
    const place = this.patch.subarray(NEIGHBOURS * n, NEIGHBOURS * (n + 1));
    const { apart } = this;
    this.patches.nearest(
      position[k],
      position[k + 1],
      position[k + 2],
      normal[k],
      normal[k + 1],
      normal[k + 2],
      place,
      apart,
    );
    let sum = 0;
    for (let m = 0; m < NEIGHBOURS; m++) {
      const weight = place[m] < 0 ? 0 : 1 / (apart[m] + 1e-6);
      this.weight[NEIGHBOURS * n + m] = weight;
      sum += weight;
      place[m] = Math.max(place[m], 0);
    }
    for (let m = 0; m < NEIGHBOURS; m++) this.weight[NEIGHBOURS * n + m] /= sum;
  }

  /** Return whether any of the patches of a point is marked. */
  any(n: number, marks: Uint8Array): boolean {
    for (let m = NEIGHBOURS * n; m < NEIGHBOURS * (n + 1); m++) if (marks[this.patch[m]]) return true;
    return false;
  }

  /** Interpolate one value of a patch at a point. */
  at(n: number, values: Float32Array, width: number, column: number): number {
    let sum = 0;
    for (let m = NEIGHBOURS * n; m < NEIGHBOURS * (n + 1); m++)
      sum += this.weight[m] * values[width * this.patch[m] + column];
    return sum;
  }
}

/** Two unit vectors that are perpendicular to a third and to each other (Duff et al. 2017). */
function basis([x, y, z]: Vector): [Vector, Vector] {
  const sign = z < 0 ? -1 : 1;
  const a = -1 / (sign + z);
  const b = x * y * a;
  return [
    [1 + sign * x * x * a, sign * b, -sign * x],
    [b, sign + y * y * a, -y],
  ];
}
