/** Points on the triangles of the surface, where edges and thin walls are stored beside the grid. */

import type { Features } from "./features.ts";
import { BOUND, type Grid } from "./grid.ts";
import type { Mesh } from "./surface.ts";
import { along, cross, dot, unit, type Vector } from "./vector.ts";

const SEEN = 2.5; // voxels, length of rays that look for the nearest triangle
/** To the neighbours of a sample. */
const WAYS = Array.from(
  { length: 27 },
  (_, n): Vector => [Math.floor(n / 9) - 1, (Math.floor(n / 3) % 3) - 1, (n % 3) - 1],
)
  .filter((_, n) => n !== 13)
  .map(unit);

type Triangle = [Vector, Vector, Vector];

/** Projects points of the unit frame to the surface, as objectfolder/mesh/isosurface.py. */
export class Nearest {
  /** Samples around which distances of the grid are not those to the surface. */
  private readonly refined = new Set<number>();

  constructor(
    private readonly grid: Grid,
    private readonly mesh: Mesh,
    features: Features | null,
  ) {
    const { count } = grid;
    const listed = features
      ? [...[...features.crossings.keys()].map((e) => Math.floor(e / 3)), ...features.sheets]
      : [];
    for (const sample of listed)
      for (let n = 0; n < 27; n++) {
        const [i, j, k] = [Math.floor(n / 9) - 1, (Math.floor(n / 3) % 3) - 1, (n % 3) - 1];
        this.refined.add(sample + (i * count + j) * count + k);
      }
  }

  to(point: Vector): Vector {
    const { count, spacing } = this.grid;
    const [i, j, k] = point.map((c) => Math.min(Math.max(Math.round((c + BOUND) / spacing), 0), count - 1));
    const by = this.grid.nearest(point);
    return this.refined.has((i * count + j) * count + k) ? (this.seen(point) ?? by) : by;
  }

  /** Return the point of the nearest triangle that rays around a point meet, if any does. */
  private seen(point: Vector): Vector | null {
    const { position, index } = this.mesh;
    const [x, y, z] = point;
    let least = SEEN * this.grid.spacing;
    const reach = least + 2 * this.grid.spacing; // of a triangle's first corner
    const near: Triangle[] = [];
    for (let f = 0; f < index.length; f += 3) {
      const v = 3 * index[f];
      if (Math.abs(position[v] - x) > reach || Math.abs(position[v + 1] - y) > reach) continue;
      if (Math.abs(position[v + 2] - z) > reach) continue;
      near.push([0, 1, 2].map((c) => [0, 1, 2].map((k) => position[3 * index[f + c] + k])) as Triangle);
    }
    let best: { way: Vector; triangle: Triangle } | null = null;
    for (const way of WAYS)
      for (const triangle of near) {
        const distance = met(point, way, triangle);
        if (distance >= least) continue;
        least = distance;
        best = { way, triangle };
      }
    return best && (foot(point, best.triangle) ?? along(point, least, best.way));
  }
}

/** Return how far a ray goes until it meets a triangle, from either side; Infinity if it does not. */
function met(origin: Vector, direction: Vector, [a, b, c]: Triangle): number {
  const [ab, ac] = [along(b, -1, a), along(c, -1, a)];
  const across = cross(direction, ac);
  const volume = dot(ab, across);
  const from = along(origin, -1, a);
  const turned = cross(from, ab);
  const [u, v] = [dot(from, across) / volume, dot(direction, turned) / volume];
  const distance = dot(ac, turned) / volume;
  return u >= 0 && v >= 0 && u + v <= 1 && distance >= 0 ? distance : Number.POSITIVE_INFINITY;
}

/** Return the foot of the perpendicular from a point on a triangle, if it lies within. */
function foot(point: Vector, [a, b, c]: Triangle): Vector | null {
  const area = cross(along(b, -1, a), along(c, -1, a));
  const off = dot(along(point, -1, a), area) / Math.max(dot(area, area), 1e-300);
  const found = along(point, -off, area);
  const sides: [Vector, Vector][] = [
    [a, b],
    [b, c],
    [c, a],
  ];
  const within = sides.every(
    ([from, to]) => dot(cross(along(to, -1, from), along(found, -1, from)), area) >= 0,
  );
  return within ? found : null;
}
