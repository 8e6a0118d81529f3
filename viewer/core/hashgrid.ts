/** Multiresolution hash grid (Mueller et al. 2022) over [-BOUND, BOUND]^3. */

import { BOUND } from "./grid.ts";
import type { ObjectFile } from "./objectfile.ts";
import { floats } from "./safetensors.ts";
import { unxz } from "./xz.ts";

export interface GridSize {
  levels: number;
  features: number;
  table_bits: number;
  coarsest: number;
  finest: number;
}

export class HashGrid {
  readonly width: number;
  private readonly resolutions: number[] = [];
  private readonly hashed: boolean[] = [];
  private readonly offsets = [0];
  private readonly mask: number;
  private readonly features: number;
  private readonly codes: Int8Array;
  private readonly factors: Float32Array;

  constructor(file: ObjectFile, name: string, size: GridSize) {
    const { levels, features, table_bits: bits, coarsest, finest } = size;
    const growth = (finest / coarsest) ** (1 / Math.max(levels - 1, 1));
    const capacity = 2 ** bits;
    for (let level = 0; level < levels; level++) {
      const resolution = Math.floor(coarsest * growth ** level + 1e-9);
      const vertices = (resolution + 1) ** 3;
      this.resolutions.push(resolution);
      this.hashed.push(vertices > capacity);
      this.offsets.push(this.offsets[level] + Math.min(vertices, capacity));
    }
    this.mask = capacity - 1;
    this.features = features;
    this.width = levels * features;
    const packed = file.tensor(`vision.${name}.table`).bytes;
    this.codes = new Int8Array(unxz(packed, this.offsets[levels] * features).buffer);
    this.factors = floats(file.tensor(`vision.${name}.factors`));
  }

  /** Write the features at a point of the unit frame. */
  lookup(x: number, y: number, z: number, out: Float64Array | Float32Array, at = 0): void {
    const { features, codes, mask } = this;
    for (let level = 0; level < this.resolutions.length; level++) {
      const resolution = this.resolutions[level];
      const side = resolution + 1;
      const a = Math.min(Math.max((x / BOUND + 1) / 2, 0), 1) * resolution;
      const b = Math.min(Math.max((y / BOUND + 1) / 2, 0), 1) * resolution;
      const c = Math.min(Math.max((z / BOUND + 1) / 2, 0), 1) * resolution;
      const i = Math.min(a | 0, resolution - 1);
      const j = Math.min(b | 0, resolution - 1);
      const k = Math.min(c | 0, resolution - 1);
      const hashed = this.hashed[level];
      const offset = this.offsets[level];
      const u = a - i;
      const v = b - j;
      const w = c - k;
      const first = at + level * features;
      for (let f = 0; f < features; f++) out[first + f] = 0;
      for (let corner = 0; corner < 8; corner++) {
        const p = i + (corner & 1);
        const q = j + ((corner >> 1) & 1);
        const r = k + (corner >> 2);
        const weight = (corner & 1 ? u : 1 - u) * (corner & 2 ? v : 1 - v) * (corner & 4 ? w : 1 - w);
        const row = hashed
          ? (p ^ Math.imul(q, 2654435761) ^ Math.imul(r, 805459861)) & mask
          : p + side * (q + side * r);
        const entry = (offset + row) * features;
        for (let f = 0; f < features; f++) out[first + f] += weight * codes[entry + f];
      }
      for (let f = 0; f < features; f++) out[first + f] *= this.factors[level];
    }
  }
}
