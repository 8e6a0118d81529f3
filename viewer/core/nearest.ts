/** Points on the triangles of the surface, where edges and thin walls are stored beside the grid. */

import type { Features } from "./features.ts";
import { BOUND, type Grid } from "./grid.ts";
import type { Mesh } from "./surface.ts";
import { along, cross, dot, type Vector } from "./vector.ts";

const REACH = 4.5; // voxels, of a triangle's first corner

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
    return this.refined.has((i * count + j) * count + k) ? (this.onTriangles(point) ?? by) : by;
  }

  /** Return the nearest point of the triangles around a point, if there are any. */
  private onTriangles(point: Vector): Vector | null {
    const { position, index } = this.mesh;
    const [x, y, z] = point;
    const reach = REACH * this.grid.spacing;
    let [least, best]: [number, Vector | null] = [Number.POSITIVE_INFINITY, null];
    for (let f = 0; f < index.length; f += 3) {
      const v = 3 * index[f];
      if (Math.abs(position[v] - x) > reach || Math.abs(position[v + 1] - y) > reach) continue;
      if (Math.abs(position[v + 2] - z) > reach) continue;
      const corners = [0, 1, 2].map((c) => [0, 1, 2].map((k) => position[3 * index[f + c] + k]));
      const found = closest(point, corners as Triangle);
      const distance = Math.hypot(...along(found, -1, point));
      if (distance < least) [least, best] = [distance, found];
    }
    return best;
  }
}

/** Return the nearest point of a triangle: the foot of the perpendicular, if it lies within, or of an edge. */
function closest(point: Vector, [a, b, c]: Triangle): Vector {
  const area = cross(along(b, -1, a), along(c, -1, a));
  const off = dot(along(point, -1, a), area) / Math.max(dot(area, area), 1e-300);
  const foot = along(point, -off, area);
  const edges: [Vector, Vector][] = [
    [a, b],
    [b, c],
    [c, a],
  ];
  const outside = edges.filter(
    ([from, to]) => dot(cross(along(to, -1, from), along(foot, -1, from)), area) < 0,
  );
  if (!outside.length) return foot;
  const near = outside.map(([from, to]) => {
    const edge = along(to, -1, from);
    const share = dot(along(point, -1, from), edge) / Math.max(dot(edge, edge), 1e-300);
    return along(from, Math.min(Math.max(share, 0), 1), edge);
  });
  const distances = near.map((one) => Math.hypot(...along(one, -1, point)));
  return near[distances.indexOf(Math.min(...distances))];
}
