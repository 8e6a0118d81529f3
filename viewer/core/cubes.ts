/** Outlines of the surface in the cells of a grid: marching cubes without a table of triangles. */

/** Offsets of a cell's corners along x, y and z: bit 0, 1 and 2 of their numbers. */
export const CORNERS = 8;

/** Cell edges: the lower corner and the axis. */
export const EDGES: readonly (readonly [corner: number, axis: number])[] = [0, 1, 2].flatMap((axis) =>
  [0, 1, 2, 3, 4, 5, 6, 7]
    .filter((corner) => !(corner & (1 << axis)))
    .map((corner) => [corner, axis] as const),
);

const EDGE_BETWEEN = new Map(
  EDGES.map(([corner, axis], edge) => [corner * 8 + (corner | (1 << axis)), edge]),
);

/** Corners of the faces, counter-clockwise seen from outside the cell. */
const FACES: readonly (readonly number[])[] = [
  [0, 4, 6, 2],
  [1, 3, 7, 5],
  [0, 1, 5, 4],
  [2, 6, 7, 3],
  [0, 2, 3, 1],
  [4, 5, 7, 6],
];

const edgeOf = (a: number, b: number): number => EDGE_BETWEEN.get(Math.min(a, b) * 8 + Math.max(a, b))!;

/** Return the ambiguous faces of a cell: two inside corners, diagonally opposed. */
export function ambiguousFaces(code: number): number[] {
  const inside = (corner: number) => (code >> corner) & 1;
  return FACES.flatMap((corners, face) => {
    const [a, b, c, d] = corners.map(inside);
    return a === c && b === d && a !== b ? [face] : [];
  });
}

/** Return whether the inside corners of an ambiguous face are joined across it, by bilinear interpolation. */
export function joined(face: number, values: ArrayLike<number>): boolean {
  const [a, b, c, d] = FACES[face].map((corner) => values[corner]);
  const separation = a * c - b * d;
  return a <= 0 ? separation > 0 : separation < 0;
}

/**
 * Return the closed loops of cell edges that the surface crosses, counter-clockwise seen from outside the
 * object.
 *
 * @param code bit n is set if corner n is inside
 * @param join tells of each ambiguous face whether its inside corners are joined
 */
export function outlines(code: number, join: (face: number) => boolean): number[][] {
  const next = new Map<number, number>();
  FACES.forEach((corners, face) => {
    const inside = corners.map((corner) => (code >> corner) & 1);
    const leaving: number[] = []; // places around the face where inside turns to outside
    const entering: number[] = [];
    for (let n = 0; n < 4; n++) {
      const after = (n + 1) % 4;
      if (inside[n] && !inside[after]) leaving.push(n);
      if (!inside[n] && inside[after]) entering.push(n);
    }
    const edge = (n: number) => edgeOf(corners[n], corners[(n + 1) % 4]);
    leaving.forEach((n) => {
      // The inside corners before the crossing end at the entering one before it, or at the other, if joined.
      const sorted = entering.map((m) => [(n - m + 4) % 4, m]).sort((a, b) => a[0] - b[0]);
      const partner = sorted.length === 2 && join(face) ? sorted[1][1] : sorted[0][1];
      next.set(edge(partner), edge(n));
    });
  });
  const loops: number[][] = [];
  while (next.size) {
    const [first] = next.keys();
    const loop: number[] = [];
    for (let edge = first; next.has(edge); ) {
      loop.push(edge);
      const after = next.get(edge)!;
      next.delete(edge);
      edge = after;
    }
    loops.push(loop);
  }
  return loops;
}
