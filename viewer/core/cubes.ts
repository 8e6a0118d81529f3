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

/**
 * Triangles of the cells without ambiguous faces, by the bits of their inside corners: three edges each, hexadecimal.
 *
 * An outline of four or more edges can be divided in several ways. These are those of marching cubes (Lewiner
 * et al. 2003) in scikit-image, which the library calls: colours and normals are linear on each triangle.
 */
const DIVIDED = (
  " 048 095 489495 1a4 0181a8  1951a989a 15b  09b0b1 14b48b89b 45a5ba 0585b88ba 09a0a49ba " +
  "89a9ba 286 046062  296465569  0121621a6  1291951a22a6    14b24629b2b4  05b0620b66ba  " +
  "29669a9ba 279  025275 248274475    1a525a2752a8   02112b27b 14b27848b7b8   02707a0a47ba " +
  "27b2b88ba 678798 047079467 085567586 467475  01a0790a767a  1651a6567   08117b187678 " +
  "14b46747b    67b6ba 36a    134364 013038368  136169195689     35b365456 05606835b365 " +
  "06409b0b636b 36838b89b 28a2a3 03204a0a3  25a2952a34a5 124132284 013032  129132195     " +
  "28335b385458 03205335b  29339b                 37a79a8a9 04937a4794a7 07508a0a737a " +
  "37a4754a7 137178184798 013037079  137175       08437b 37b 3b7        157173  031073097 " +
  "148173187789 3a745747a 05707a0a83a7 0943a747a497 3a77a989a                 2393b9  " +
  "0230353b5 2383583b5485     123159192  023031 123142248 23a2592a545a  02303a0a4 23a2a8 " +
  "3863b88b9 04606b0b93b6 0650863563b5 3563b5465     159163196698  031083386 143346  0593a6  " +
  "3a6 6ab6b7    1b44764b7 0181781b7687   15616a576  07a0970a16a7  457476 058568576 074097476 " +
  "687789 28b2b78ab 04a0720a77ab   1b42874b878b 0121b22b7   15a25728a2a5   14a297 247284457 " +
  "052257  297 2696a99ab  02606b0b56ab  1b424b2642b9   1b5268 12a15919226a  02112616a  " +
  "269456596  026064 268 8a99ab 04a0a99ab 08558b8ab 4a55ab 1b44b88b9 01b0b9  1b5 15919a8a9  " +
  "08118a 14a 459498 059 084 "
).split(" ");

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

/** Return the triangles of a cell as numbers of edges, counter-clockwise from outside; null if faces are ambiguous. */
export function triangles(code: number): number[] | null {
  return DIVIDED[code] ? Array.from(DIVIDED[code], (edge) => Number.parseInt(edge, 16)) : null;
}
