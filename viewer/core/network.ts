/** Small ReLU networks. */

import type { ObjectFile } from "./objectfile.ts";
import { floats } from "./safetensors.ts";

interface Layer {
  weight: Float32Array;
  bias: Float32Array;
}

export class Network {
  private readonly layers: Layer[] = [];
  private readonly values: Float64Array[];

  /** @param name of the tensors, such as vision.appearance */
  constructor(file: ObjectFile, name: string) {
    for (let n = 0; file.has(`${name}.${n}.weight`); n += 2)
      this.layers.push({
        weight: floats(file.tensor(`${name}.${n}.weight`)),
        bias: floats(file.tensor(`${name}.${n}.bias`)),
      });
    this.values = this.layers.map(({ bias }) => new Float64Array(bias.length));
  }

  /** Evaluate the network; the result is overwritten by the next call. */
  run(inputs: Float64Array): Float64Array {
    let current = inputs;
    this.layers.forEach(({ weight, bias }, n) => {
      const out = this.values[n];
      const last = n === this.layers.length - 1;
      for (let row = 0, k = 0; row < out.length; row++) {
        let sum = bias[row];
        for (let column = 0; column < current.length; column++) sum += weight[k++] * current[column];
        out[row] = sum > 0 || last ? sum : 0;
      }
      current = out;
    });
    return current;
  }
}
