/** The gel as an elastic layer on a rigid base: its displacement under a pressure. */

import { Fft, fastLength } from "./fft.ts";

const SPACING = 2.5; // thicknesses between the copies of the contact that Fourier transforms imply
const SOFTEST = 0.06; // least stiffness of the preconditioner, of that of the stiffest wave

export interface Layer {
  thickness: number; // m
  youngModulus: number; // Pa
  poissonRatio: number;
}

/** Displacement of the surface per unit of a sinusoidal pressure, m/Pa, for a wavenumber in rad/m. */
function compliance(wavenumber: number, layer: Layer): number {
  const { thickness, youngModulus: E, poissonRatio: nu } = layer;
  if (!(wavenumber > 0)) return (((1 + nu) * (1 - 2 * nu)) / (1 - nu) / E) * thickness;
  const phase = wavenumber * thickness;
  const decay = Math.exp(-2 * phase);
  const sinh = (1 - decay * decay) / 2;
  const cosh = (1 + decay * decay) / 2;
  const above = (3 - 4 * nu) * sinh - 2 * phase * decay;
  const below = (3 - 4 * nu) * cosh + (2 * phase * phase + 5 - 12 * nu + 8 * nu * nu) * decay;
  return (((((2 * (1 - nu * nu)) / E) * thickness) / phase) * above) / below;
}

/** Response of a layer on a grid of pixels. */
export class Response {
  /** Weights of a pixel, its edge neighbours and its corner neighbours: an approximate inverse, Pa/m. */
  readonly stencil: [number, number, number];
  private readonly rows: number;
  private readonly columns: number;
  private readonly half: number;
  private readonly factor: Float64Array;
  private readonly alongRows: Fft;
  private readonly alongColumns: Fft;
  private readonly re: Float64Array;
  private readonly im: Float64Array;

  constructor(
    readonly height: number,
    readonly width: number,
    pitch: number,
    layer: Layer,
  ) {
    const margin = Math.round((SPACING * layer.thickness) / pitch);
    this.rows = fastLength(height + margin);
    this.columns = fastLength(width + margin);
    this.half = (this.rows >> 1) + 1;
    this.alongRows = new Fft(this.rows);
    this.alongColumns = new Fft(this.columns);
    const { rows, columns, half } = this;
    this.factor = new Float64Array(half * columns);
    for (let r = 0; r < half; r++)
      for (let c = 0; c < columns; c++) {
        const wave = Math.hypot(r / (rows * pitch), Math.min(c, columns - c) / (columns * pitch));
        this.factor[r * columns + c] = compliance(2 * Math.PI * wave, layer) / (rows * columns);
      }
    this.re = new Float64Array(half * columns);
    this.im = new Float64Array(half * columns);
    this.stencil = stencil(pitch, layer);
  }

  /** Write the displacement under a pressure. */
  run(pressure: Float32Array, out: Float32Array): void {
    const { height, width, rows, columns, half } = this;
    const re = new Float64Array(rows);
    const im = new Float64Array(rows);
    this.re.fill(0);
    this.im.fill(0);
    for (let c = 0; c < width; c += 2) {
      // Two real columns are the parts of one complex column.
      let any = false;
      re.fill(0);
      im.fill(0);
      for (let r = 0; r < height; r++) {
        re[r] = pressure[r * width + c];
        im[r] = c + 1 < width ? pressure[r * width + c + 1] : 0;
        any ||= re[r] !== 0 || im[r] !== 0;
      }
      if (!any) continue;
      this.alongRows.run(re, im);
      for (let r = 0; r < half; r++) {
        const mirror = r ? rows - r : 0;
        const at = r * columns + c;
        this.re[at] = (re[r] + re[mirror]) / 2;
        this.im[at] = (im[r] - im[mirror]) / 2;
        this.re[at + 1] = (im[r] + im[mirror]) / 2;
        this.im[at + 1] = (re[mirror] - re[r]) / 2;
      }
    }
    this.filter();
    for (let c = 0; c < width; c += 2) {
      const two = c + 1 < width;
      for (let r = 0; r < half; r++) {
        const at = r * columns + c;
        const real = r === 0 || (rows % 2 === 0 && r === half - 1);
        const otherRe = two ? this.re[at + 1] : 0;
        const otherIm = two && !real ? this.im[at + 1] : 0;
        const ownIm = real ? 0 : this.im[at];
        re[r] = this.re[at] - otherIm;
        im[r] = ownIm + otherRe;
        if (real) continue;
        re[rows - r] = this.re[at] + otherIm;
        im[rows - r] = otherRe - ownIm;
      }
      this.alongRows.run(im, re);
      for (let r = 0; r < height; r++) {
        out[r * width + c] = re[r];
        if (two) out[r * width + c + 1] = im[r];
      }
    }
  }

  private filter(): void {
    const { columns, half, factor } = this;
    for (let r = 0; r < half; r++) {
      const at = r * columns;
      const re = this.re.subarray(at, at + columns);
      const im = this.im.subarray(at, at + columns);
      this.alongColumns.run(re, im);
      for (let c = 0; c < columns; c++) {
        re[c] *= factor[at + c];
        im[c] *= factor[at + c];
      }
      this.alongColumns.run(im, re);
    }
  }
}

function stencil(pitch: number, layer: Layer): [number, number, number] {
  const axis = 1 / compliance(Math.PI / pitch, layer);
  const diagonal = 1 / compliance((Math.PI / pitch) * Math.SQRT2, layer);
  const [low, high] = [Math.log(0.01 / layer.thickness), Math.log(Math.PI / pitch)];
  let most = 0;
  for (let i = 0; i < 200; i++)
    most = Math.max(most, compliance(Math.exp(low + ((high - low) * i) / 199), layer));
  const long = Math.max(1 / most, SOFTEST * diagonal);
  const centre = (long + 2 * axis + diagonal) / 4;
  return [centre, (long - diagonal) / 8, (centre - axis) / 4];
}
