/** Sharp edges of the triangles: extended marching cubes (Kobbelt et al. 2001), as objectfolder/mesh/sharpen.py. */

import type { Mesh } from "./surface.ts";

const MIXED = Math.cos((3 * Math.PI) / 180); // to the faces' normal; from there on a normal of the grid is wrong
const FOLDED = 0.2; // least cosine between the normals of faces before and after an edge is flipped
const CREASE = Math.cos((40 * Math.PI) / 180);

/** Write the normal of a face, as long as twice its area. */
function areaVector(p: Float32Array, a: number, b: number, c: number, out: Float64Array, at = 0): void {
  const i = 3 * a;
  const j = 3 * b;
  const k = 3 * c;
  const ux = p[j] - p[i];
  const uy = p[j + 1] - p[i + 1];
  const uz = p[j + 2] - p[i + 2];
  const vx = p[k] - p[i];
  const vy = p[k + 1] - p[i + 1];
  const vz = p[k + 2] - p[i + 2];
  out[at] = uy * vz - uz * vy;
  out[at + 1] = uz * vx - ux * vz;
  out[at + 2] = ux * vy - uy * vx;
}

function cosine(a: ArrayLike<number>, i: number, b: ArrayLike<number>, j: number): number {
  const product = a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];
  const sizes =
    (a[i] * a[i] + a[i + 1] * a[i + 1] + a[i + 2] * a[i + 2]) *
    (b[j] * b[j] + b[j + 1] * b[j + 1] + b[j + 2] * b[j + 2]);
  return sizes > 0 ? product / Math.sqrt(sizes) : 0;
}

/** Flip the edges that two fans share, so that they join their points, unless the new faces would fold. */
export function joinFans(position: Float32Array, fans: Uint32Array): Uint32Array {
  const count = position.length / 3;
  const first = new Map<number, number>();
  const flipped = fans.slice();
  const areas = new Float64Array(12);
  for (let f = 0; f < fans.length; f += 3) {
    const [a, b] = [fans[f], fans[f + 1]];
    const key = Math.min(a, b) * count + Math.max(a, b);
    const other = first.get(key);
    if (other === undefined) {
      first.set(key, f);
      continue;
    }
    if (fans[other] !== b) continue;
    const [p, q] = [fans[other + 2], fans[f + 2]];
    areaVector(position, b, a, p, areas, 0);
    areaVector(position, a, b, q, areas, 3);
    for (let axis = 0; axis < 3; axis++) areas[axis] += areas[3 + axis];
    areaVector(position, p, b, q, areas, 6);
    areaVector(position, q, a, p, areas, 9);
    if (Math.min(cosine(areas, 6, areas, 0), cosine(areas, 9, areas, 0)) <= FOLDED) continue;
    flipped.set([p, b, q], other);
    flipped.set([q, a, p], f);
  }
  return flipped;
}

/**
 * Give vertices the normals of their faces where those of the grid are wrong, split at creases.
 *
 * Within a voxel of an edge, distances are those to several faces; their gradient belongs to none. The same
 * holds at the vertices of thin walls.
 */
export function sharpNormals(mesh: Mesh, firstFan: number, thin: number[] = []): Mesh {
  const { position, normal, index } = mesh;
  const vertices = position.length / 3;
  const areas = new Float64Array(index.length);
  const mean = new Float64Array(position.length);
  for (let f = 0; f < index.length; f += 3) {
    areaVector(position, index[f], index[f + 1], index[f + 2], areas, f);
    for (let c = 0; c < 3; c++)
      for (let axis = 0; axis < 3; axis++) mean[3 * index[f + c] + axis] += areas[f + axis];
  }
  const own = new Uint8Array(vertices);
  for (let v = 0; v < vertices; v++) own[v] = cosine(mean, 3 * v, normal, 3 * v) < MIXED ? 1 : 0;
  for (let f = firstFan; f < index.length; f++) own[index[f]] = 1;
  const walls = new Set(thin);
  for (let f = 0; walls.size && f < index.length; f += 3)
    if ([0, 1, 2].some((c) => walls.has(index[f + c]))) for (let c = 0; c < 3; c++) own[index[f + c]] = 1;
  const around = new Map<number, number[]>(); // faces at vertices with normals of their own
  for (let f = 0; f < index.length; f += 3)
    if (own[index[f]] || own[index[f + 1]] || own[index[f + 2]])
      for (let c = 0; c < 3; c++) {
        const v = index[f + c];
        if (!own[v]) continue;
        const faces = around.get(v);
        if (faces) faces.push(f);
        else around.set(v, [f]);
      }
  return split(mesh, areas, around);
}

/** Give each corner at the listed vertices the mean normal of the faces on its side of creases. */
function split(mesh: Mesh, areas: Float64Array, around: Map<number, number[]>): Mesh {
  const index = mesh.index.slice();
  const normal = [...around.keys()].length ? mesh.normal.slice() : mesh.normal;
  const extraPosition: number[] = [];
  const extraNormal: number[] = [];
  const vertices = mesh.position.length / 3;
  for (const [v, faces] of around) {
    const given: [x: number, y: number, z: number, vertex: number][] = [];
    for (const f of faces) {
      let [x, y, z] = [0, 0, 0];
      for (const g of faces)
        if (cosine(areas, f, areas, g) > CREASE) {
          x += areas[g];
          y += areas[g + 1];
          z += areas[g + 2];
        }
      const size = Math.hypot(x, y, z);
      const [nx, ny, nz] = size > 0 ? [x / size, y / size, z / size] : [0, 0, 1];
      let one = given.find(
        (known) => Math.abs(known[0] - nx) + Math.abs(known[1] - ny) + Math.abs(known[2] - nz) < 1e-6,
      );
      if (!one) {
        one = [nx, ny, nz, given.length ? vertices + extraPosition.length / 3 : v];
        if (given.length) {
          for (let axis = 0; axis < 3; axis++) extraPosition.push(mesh.position[3 * v + axis]);
          extraNormal.push(nx, ny, nz);
        } else normal.set([nx, ny, nz], 3 * v);
        given.push(one);
      }
      for (let c = 0; c < 3; c++) if (mesh.index[f + c] === v) index[f + c] = one[3];
    }
  }
  return {
    position: joinedArray(mesh.position, extraPosition),
    normal: joinedArray(normal, extraNormal),
    index,
  };
}

function joinedArray(first: Float32Array, more: number[]): Float32Array {
  const all = new Float32Array(first.length + more.length);
  all.set(first);
  all.set(more, first.length);
  return all;
}
