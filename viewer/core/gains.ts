/** Audio net `gains`: mode shapes at a point of the surface. */

import type { AudioConfig, ObjectFile } from "./objectfile.ts";
import { doubles, floats, signedBytes } from "./safetensors.ts";

interface Layer {
  weight: Float32Array;
  bias: Float32Array;
}

export class Gains {
  /** Damped angular frequencies, rad/s. */
  readonly frequency: Float64Array;
  /** Decay rates, 1/s. */
  readonly damping: Float64Array;
  private readonly amplitude: Float32Array;
  private readonly row: Int32Array;
  private readonly table: Float32Array;
  private readonly sines: Layer[];
  private readonly output: Layer;
  private readonly config: AudioConfig;

  constructor(file: ObjectFile) {
    const tensor = (name: string) => file.tensor(`audio.${name}`);
    const coded = (name: string): Float32Array => {
      const codes = signedBytes(tensor(name));
      const exponents = signedBytes(tensor(`${name}_exponent`));
      const columns = codes.length / exponents.length;
      return Float32Array.from(codes, (code, n) => code * 2 ** exponents[Math.floor(n / columns)]);
    };
    this.config = file.header.audio!.net;
    this.frequency = doubles(tensor("damped_frequency"));
    this.damping = doubles(tensor("damping"));
    this.amplitude = floats(tensor("amplitude"));
    const used = tensor("grid.used").bytes;
    this.row = new Int32Array((this.config.resolution + 2) ** 3).fill(-1);
    let rows = 0;
    for (let i = 0; i < this.row.length; i++) if ((used[i >> 3] >> (7 - (i & 7))) & 1) this.row[i] = rows++;
    this.table = coded("grid.table");
    this.sines = [
      { weight: floats(tensor("sines.layers.0.weight")), bias: floats(tensor("sines.layers.0.bias")) },
      { weight: coded("sines.layers.1.weight"), bias: floats(tensor("sines.layers.1.bias")) },
    ];
    this.output = { weight: coded("output.weight"), bias: floats(tensor("output.bias")) };
  }

  get count(): number {
    return this.frequency.length;
  }

  /** Mass-normalised mode shapes, (3, M), kg^-1/2, at a point of the unit frame. */
  shapes(point: ArrayLike<number>): Float64Array {
    const { resolution, channels, frequency } = this.config;
    const side = resolution + 2;
    const inputs = new Float64Array(3 + channels);
    const cell: number[] = [];
    const weights: number[][] = [];
    for (let axis = 0; axis < 3; axis++) {
      inputs[axis] = 2 * point[axis];
      const place = Math.min(Math.max(point[axis] + 0.5, 0), 1) * resolution;
      const first = Math.min(Math.floor(place), resolution - 1);
      const t = place - first;
      cell.push(first);
      weights.push([(1 - t) ** 2 / 2, 0.5 + t - t * t, (t * t) / 2]); // quadratic B-spline
    }
    for (let i = 0; i < 3; i++)
      for (let j = 0; j < 3; j++)
        for (let k = 0; k < 3; k++) {
          const row = this.row[((cell[0] + i) * side + cell[1] + j) * side + cell[2] + k];
          const weight = weights[0][i] * weights[1][j] * weights[2][k];
          if (row >= 0)
            for (let c = 0; c < channels; c++) inputs[3 + c] += weight * this.table[row * channels + c];
        }
    let hidden: Float64Array = inputs;
    for (const layer of this.sines)
      hidden = linear(layer, hidden).map((value) => Math.sin(frequency * value));
    return linear(this.output, hidden).map((value, n) => value * this.amplitude[n % this.count]);
  }
}

function linear({ weight, bias }: Layer, inputs: Float64Array): Float64Array {
  const outputs = new Float64Array(bias.length);
  for (let row = 0, k = 0; row < outputs.length; row++) {
    let sum = bias[row];
    for (let column = 0; column < inputs.length; column++, k++) sum += weight[k] * inputs[column];
    outputs[row] = sum;
  }
  return outputs;
}
