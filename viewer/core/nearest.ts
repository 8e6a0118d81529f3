/** Points on the triangles of the surface, where edges and thin walls are stored beside the grid. */

import type { Features } from "./features.ts";
import { BOUND, type Grid } from "./grid.ts";
import type { Mesh } from "./surface.ts";
import { along, dot, type Vector } from "./vector.ts";

const SEEN = 2.5; // voxels, greatest distance of a triangle

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

  private onTriangles(point: Vector): Vector | null {
    const { position, index } = this.mesh;
    let best: Vector | null = null;
    let least = (SEEN * this.grid.spacing) ** 2;
    const reach = 4 * this.grid.spacing; // of a triangle's first corner
    const corner = (v: number): Vector => [position[3 * v], position[3 * v + 1], position[3 * v + 2]];
    for (let f = 0; f < index.length; f += 3) {
      const v = 3 * index[f];
      if (Math.abs(position[v] - point[0]) > reach || Math.abs(position[v + 1] - point[1]) > reach) continue;
      if (Math.abs(position[v + 2] - point[2]) > reach) continue;
      const found = closest(point, corner(index[f]), corner(index[f + 1]), corner(index[f + 2]));
      const apart = along(found, -1, point);
      if (dot(apart, apart) >= least) continue;
      least = dot(apart, apart);
      best = found;
    }
    return best;
  }
}

/** Return the point of a triangle that is nearest to a point (Ericson 2005, section 5.1.5). */
function closest(p: Vector, a: Vector, b: Vector, c: Vector): Vector {
  const [ab, ac] = [along(b, -1, a), along(c, -1, a)];
  const at = (q: Vector): [number, number] => {
    const from = along(p, -1, q);
    return [dot(ab, from), dot(ac, from)];
  };
  const [[d1, d2], [d3, d4], [d5, d6]] = [at(a), at(b), at(c)];
  if (d1 <= 0 && d2 <= 0) return a;
  if (d3 >= 0 && d4 <= d3) return b;
  if (d6 >= 0 && d5 <= d6) return c;
  const vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return along(a, d1 / (d1 - d3), ab);
  const vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return along(a, d2 / (d2 - d6), ac);
  const va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 >= d3 && d5 >= d6) return along(b, (d4 - d3) / (d4 - d3 + d5 - d6), along(c, -1, b));
  const sum = va + vb + vc;
  return along(along(a, vb / sum, ab), vc / sum, ac);
}
