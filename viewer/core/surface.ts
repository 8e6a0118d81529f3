/** The surface of a distance grid as triangles: marching cubes, refined by stored features. */

import { ambiguousFaces, EDGES, joined, outlines, triangles } from "./cubes.ts";
import type { Features } from "./features.ts";
import { BOUND, type Grid } from "./grid.ts";
import { joinFans, sharpNormals } from "./sharpen.ts";

const BESIDE = -0.05; // with features, samples of 0 count as this: vertices lie off the samples

/** Triangles in the unit frame, counter-clockwise from outside. */
export interface Mesh {
  position: Float32Array;
  normal: Float32Array;
  index: Uint32Array;
}

const DIVIDED = Array.from({ length: 256 }, (_, code) => triangles(code));
const PLAIN = Array.from({ length: 256 }, (_, code) =>
  ambiguousFaces(code).length ? null : outlines(code, () => false),
);

class Growing<T extends Float32Array | Uint32Array> {
  size = 0;
  constructor(public data: T) {}
  /** Make room for more entries and return where they begin. */
  add(count: number): number {
    const at = this.size;
    this.size += count;
    if (this.size > this.data.length) {
      const larger = new (this.data.constructor as new (length: number) => T)(2 * this.size);
      larger.set(this.data);
      this.data = larger;
    }
    return at;
  }
}

/** Extract the zero level set, with shading normals. */
export function surface(grid: Grid, features: Features | null = null): Mesh {
  const { count, spacing } = grid;
  const values = features?.sheets.length ? grid.values.slice() : grid.values;
  for (const sample of features?.sheets ?? []) values[sample] = -127; // deep: they join across diagonals
  const n = count * count;
  const zero = features ? BESIDE : 0;
  const position = new Growing(new Float32Array(1 << 19));
  const index = new Growing(new Uint32Array(1 << 20));
  const fans: number[] = []; // triples: a border edge and the point of its cell
  const thin: number[] = []; // vertices of walls under a voxel
  const vertex = (x: number, y: number, z: number): number => {
    const at = position.add(3);
    position.data[at] = x * spacing - BOUND;
    position.data[at + 1] = y * spacing - BOUND;
    position.data[at + 2] = z * spacing - BOUND;
    return at / 3;
  };
  // Vertices on the grid's edges, of the cells' lower and upper layer of samples.
  const layers = [new Int32Array(3 * n).fill(-1), new Int32Array(3 * n).fill(-1)];
  const steps = [n, count, 1];
  const found = new Int32Array(12);
  const corner = new Float64Array(8);
  const offset = [0, 1, 2, 3, 4, 5, 6, 7].map((c) => (c & 1) * n + ((c >> 1) & 1) * count + (c >> 2));
  const crossing = (i: number, node: number, edge: number): number => {
    const [c, axis] = EDGES[edge];
    const layer = layers[c & 1];
    const local = node + ((c >> 1) & 1) * count + (c >> 2);
    const slot = 3 * local + axis;
    if (layer[slot] >= 0) return layer[slot];
    const at = i * n + node + offset[c];
    const moved = features?.moved.get(3 * at + axis);
    if (moved) {
      layer[slot] = vertex(moved[0], moved[1], moved[2]);
      thin.push(layer[slot]);
      return layer[slot];
    }
    const low = values[at] || zero;
    const high = values[at + steps[axis]] || zero;
    const share = features?.crossings.get(3 * at + axis) ?? low / (low - high);
    const place = [i + (c & 1), Math.floor(local / count), local % count];
    place[axis] += share;
    layer[slot] = vertex(place[0], place[1], place[2]);
    return layer[slot];
  };
  for (let i = 0; i < count - 1; i++) {
    for (let j = 0; j < count - 1; j++) {
      let at = i * n + j * count;
      let code = below(values, at, n, count);
      for (let k = 0; k < count - 1; k++, at++) {
        const above = below(values, at + 1, n, count);
        const cell = code | (above << 4);
        code = above;
        if (cell === 0 || cell === 255) continue;
        const node = j * count + k;
        const point = features?.points.get(at);
        const divided = point ? null : DIVIDED[cell];
        if (divided) {
          const to = index.add(divided.length);
          for (let e = 0; e < divided.length; e++) index.data[to + e] = crossing(i, node, divided[e]);
          continue;
        }
        let loops = PLAIN[cell];
        if (!loops) {
          for (let c = 0; c < 8; c++) corner[c] = values[at + offset[c]] || zero;
          loops = outlines(cell, (face) => joined(face, corner));
        }
        const centre = point ? vertex(point[0], point[1], point[2]) : -1;
        for (const loop of loops) {
          for (let e = 0; e < loop.length; e++) found[e] = crossing(i, node, loop[e]);
          if (centre >= 0)
            for (let e = 0; e < loop.length; e++) fans.push(found[e], found[(e + 1) % loop.length], centre);
          else
            for (let e = 2; e < loop.length; e++) {
              const to = index.add(3);
              index.data[to] = found[0];
              index.data[to + 1] = found[e - 1];
              index.data[to + 2] = found[e];
            }
        }
      }
    }
    layers.reverse();
    layers[1].fill(-1);
  }
  return shaded(grid, position.data.slice(0, position.size), index.data.slice(0, index.size), fans, thin);
}

/** Bits of the four corners of a cell whose z is that of its lowest sample: 1 inside. */
function below(values: Int8Array, at: number, n: number, count: number): number {
  return (
    (values[at] <= 0 ? 1 : 0) |
    (values[at + n] <= 0 ? 2 : 0) |
    (values[at + count] <= 0 ? 4 : 0) |
    (values[at + n + count] <= 0 ? 8 : 0)
  );
}

function shaded(grid: Grid, position: Float32Array, flat: Uint32Array, fans: number[], thin: number[]): Mesh {
  const normal = new Float32Array(position.length);
  for (let p = 0; p < position.length; p += 3)
    grid.normal(position[p], position[p + 1], position[p + 2], normal, p);
  if (!fans.length && !thin.length) return { position, normal, index: flat };
  const sharp = joinFans(position, Uint32Array.from(fans));
  const index = new Uint32Array(flat.length + sharp.length);
  index.set(flat);
  index.set(sharp, flat.length);
  return sharpNormals({ position, normal, index }, flat.length, thin);
}
