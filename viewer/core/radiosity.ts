/** Diffuse interreflection (Goral et al. 1984) between patches of the surface, as objectfolder/vision/radiosity.py. */

import type { Grid } from "./grid.ts";
import { Patches, randoms } from "./patches.ts";
import type { Mesh } from "./surface.ts";
import type { Vector } from "./vector.ts";

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

  /** Return the patch that a ray meets, or -1. */
  hit(start: Vector, direction: Vector): number {
    const distance = this.grid.cast(start, direction);
    if (distance === Number.POSITIVE_INFINITY) return -1;
    const [x, y, z] = [0, 1, 2].map((axis) => start[axis] + distance * direction[axis]);
    this.grid.normal(x, y, z, this.facing);
    const [nx, ny, nz] = this.facing;
    this.patches.nearest(x, y, z, nx, ny, nz, this.place, this.apart);
    return this.place[0];
  }

  /** Return a patch's place, some voxels along its normal. */
  lifted(n: number, voxels: number): Vector {
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

/** Weights by which values at patches are interpolated at vertices. */
export class Interpolation {
  private readonly patch: Int32Array;
  private readonly weight: Float32Array;

  constructor(
    private readonly patches: Patches,
    private readonly mesh: Mesh,
  ) {
    this.patch = new Int32Array((NEIGHBOURS * mesh.position.length) / 3);
    this.weight = new Float32Array(this.patch.length);
  }

  get count(): number {
    return this.mesh.position.length / 3;
  }

  /** Find the patches of the vertices from one number up to another. */
  connect(from: number, to: number): void {
    const { position, normal } = this.mesh;
    const apart = new Float64Array(NEIGHBOURS);
    for (let v = from; v < to; v++) {
      const k = 3 * v;
      const place = this.patch.subarray(NEIGHBOURS * v, NEIGHBOURS * (v + 1));
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
      for (let n = 0; n < NEIGHBOURS; n++) {
        const weight = place[n] < 0 ? 0 : 1 / (apart[n] + 1e-6);
        this.weight[NEIGHBOURS * v + n] = weight;
        sum += weight;
        place[n] = Math.max(place[n], 0);
      }
      for (let n = 0; n < NEIGHBOURS; n++) this.weight[NEIGHBOURS * v + n] /= sum;
    }
  }

  /** Interpolate one value of a patch at a vertex. */
  at(vertex: number, values: Float32Array, width: number, column: number): number {
    let sum = 0;
    for (let n = NEIGHBOURS * vertex; n < NEIGHBOURS * (vertex + 1); n++)
      sum += this.weight[n] * values[width * this.patch[n] + column];
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
