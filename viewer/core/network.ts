/** Small ReLU networks. */

import type { ObjectFile } from "./objectfile.ts";
import { floats } from "./safetensors.ts";

interface Layer {
  /** By input, then by output. */
  weight: Float32Array;
  bias: Float32Array;
}

export class Network {
  private readonly layers: Layer[] = [];
  private readonly values: Float64Array[];

  /** @param name of the tensors, such as vision.appearance */
  constructor(file: ObjectFile, name: string) {
    for (let n = 0; file.has(`${name}.${n}.weight`); n += 2) {
      const bias = floats(file.tensor(`${name}.${n}.bias`));
      this.layers.push({ weight: transposed(floats(file.tensor(`${name}.${n}.weight`)), bias.length), bias });
    }
    this.values = this.layers.map(({ bias }) => new Float64Array(bias.length));
  }

  /** Evaluate the network; the result is overwritten by the next call. */
  run(inputs: Float64Array): Float64Array {
    let current = inputs;
    for (let n = 0; n < this.layers.length; n++) {
      const { weight, bias } = this.layers[n];
      const out = this.values[n];
      const rows = out.length;
      out.set(bias);
      for (let column = 0; column < current.length; column++) {
        const value = current[column];
        if (value === 0) continue; // half of the hidden ones are
        const at = column * rows;
        for (let row = 0; row < rows; row++) out[row] += value * weight[at + row];
      }
      if (n < this.layers.length - 1) for (let row = 0; row < rows; row++) if (out[row] < 0) out[row] = 0;
      current = out;
    }
    return current;
  }
}

/** Return a matrix of some rows by columns. */
function transposed(matrix: Float32Array, rows: number): Float32Array {
  const columns = matrix.length / rows;
  const out = new Float32Array(matrix.length);
  for (let row = 0; row < rows; row++)
    for (let column = 0; column < columns; column++)
      out[column * rows + row] = matrix[row * columns + column];
  return out;
}
