/** Vision net `surface`: what depends on a point of the surface alone. */

import { HashGrid } from "./hashgrid.ts";
import { Network } from "./network.ts";
import type { ObjectFile, VisionConfig } from "./objectfile.ts";
import type { Mesh } from "./surface.ts";

export const toLinear = (value: number): number =>
  value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;

/** Base colour, linear, and unit shading normal of points; (P, 3) each. */
export interface Appearance {
  color: Float32Array;
  normal: Float32Array;
}

export class Look {
  readonly config: VisionConfig;
  private readonly grid: HashGrid;
  private readonly network: Network;

  constructor(file: ObjectFile) {
    this.config = file.header.vision!.net;
    this.grid = new HashGrid(file, "grid", this.config);
    this.network = new Network(file, "vision.appearance");
  }

  /** Evaluate points from one number up to another into arrays of all points. */
  bake(mesh: Pick<Mesh, "position" | "normal">, from: number, to: number, into: Appearance): void {
    const { position, normal } = mesh;
    const width = this.grid.width;
    const inputs = new Float64Array(width + 3);
    for (let n = from; n < to; n++) {
      const at = 3 * n;
      this.grid.lookup(position[at], position[at + 1], position[at + 2], inputs);
      for (let axis = 0; axis < 3; axis++) inputs[width + axis] = position[at + axis];
      const found = this.network.run(inputs);
      const x = normal[at] + found[3];
      const y = normal[at + 1] + found[4];
      const z = normal[at + 2] + found[5];
      const size = Math.sqrt(x * x + y * y + z * z) || 1;
      into.normal[at] = x / size;
      into.normal[at + 1] = y / size;
      into.normal[at + 2] = z / size;
      for (let axis = 0; axis < 3; axis++)
        into.color[at + axis] = toLinear(Math.min(Math.max(found[axis] + 0.5, 0), 1));
    }
  }
}
