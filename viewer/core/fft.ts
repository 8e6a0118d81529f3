/** Complex Fourier transforms of lengths 2^a 3^b 5^c (Stockham), with real and imaginary parts apart. */

export class Fft {
  private readonly factors: number[] = [];
  private readonly cos: Float64Array;
  private readonly sin: Float64Array;
  private readonly spareRe: Float64Array;
  private readonly spareIm: Float64Array;

  constructor(readonly length: number) {
    let rest = length;
    for (const factor of [4, 2, 3, 5]) for (; rest % factor === 0; rest /= factor) this.factors.push(factor);
    if (rest !== 1) throw new Error(`a transform of length ${length} has factors other than 2, 3 and 5`);
    const angle = (k: number) => (2 * Math.PI * k) / length;
    this.cos = Float64Array.from({ length }, (_, k) => Math.cos(angle(k)));
    this.sin = Float64Array.from({ length }, (_, k) => -Math.sin(angle(k)));
    this.spareRe = new Float64Array(length);
    this.spareIm = new Float64Array(length);
  }

  /** Transform in place. The inverse, without the division by the length, swaps the arguments. */
  run(re: Float64Array, im: Float64Array): void {
    let [ar, ai, br, bi] = [re, im, this.spareRe, this.spareIm];
    let rest = this.length;
    let done = 1;
    for (const factor of this.factors) {
      rest /= factor;
      const pass = factor === 4 ? this.four : factor === 2 ? this.two : this.odd;
      pass.call(this, ar, ai, br, bi, rest, done, factor);
      done *= factor;
      [ar, ai, br, bi] = [br, bi, ar, ai];
    }
    if (ar !== re) {
      re.set(ar);
      im.set(ai);
    }
  }

  private two(
    ar: Float64Array,
    ai: Float64Array,
    br: Float64Array,
    bi: Float64Array,
    rest: number,
    done: number,
  ): void {
    for (let j = 0; j < rest; j++) {
      const wr = this.cos[j * done];
      const wi = this.sin[j * done];
      for (let k = 0; k < done; k++) {
        const p = j * done + k;
        const q = p + rest * done;
        const o = 2 * j * done + k;
        const dr = ar[p] - ar[q];
        const di = ai[p] - ai[q];
        br[o] = ar[p] + ar[q];
        bi[o] = ai[p] + ai[q];
        br[o + done] = wr * dr - wi * di;
        bi[o + done] = wr * di + wi * dr;
      }
    }
  }

  private four(
    ar: Float64Array,
    ai: Float64Array,
    br: Float64Array,
    bi: Float64Array,
    rest: number,
    done: number,
  ): void {
    const { cos, sin } = this;
    const s = rest * done;
    for (let j = 0; j < rest; j++) {
      const q = j * done;
      const [w1r, w1i, w2r, w2i, w3r, w3i] = [cos[q], sin[q], cos[2 * q], sin[2 * q], cos[3 * q], sin[3 * q]];
      for (let k = 0; k < done; k++) {
        const p = q + k;
        const o = 4 * q + k;
        const ur = ar[p] + ar[p + 2 * s];
        const ui = ai[p] + ai[p + 2 * s];
        const vr = ar[p] - ar[p + 2 * s];
        const vi = ai[p] - ai[p + 2 * s];
        const tr = ar[p + s] + ar[p + 3 * s];
        const ti = ai[p + s] + ai[p + 3 * s];
        const sr = ar[p + s] - ar[p + 3 * s];
        const si = ai[p + s] - ai[p + 3 * s];
        br[o] = ur + tr;
        bi[o] = ui + ti;
        let yr = vr + si;
        let yi = vi - sr;
        br[o + done] = w1r * yr - w1i * yi;
        bi[o + done] = w1r * yi + w1i * yr;
        yr = ur - tr;
        yi = ui - ti;
        br[o + 2 * done] = w2r * yr - w2i * yi;
        bi[o + 2 * done] = w2r * yi + w2i * yr;
        yr = vr - si;
        yi = vi + sr;
        br[o + 3 * done] = w3r * yr - w3i * yi;
        bi[o + 3 * done] = w3r * yi + w3i * yr;
      }
    }
  }

  private odd(
    ar: Float64Array,
    ai: Float64Array,
    br: Float64Array,
    bi: Float64Array,
    rest: number,
    done: number,
    factor: number,
  ): void {
    const { cos, sin, length } = this;
    const step = length / factor;
    for (let j = 0; j < rest; j++)
      for (let k = 0; k < done; k++)
        for (let t = 0; t < factor; t++) {
          let yr = 0;
          let yi = 0;
          for (let u = 0; u < factor; u++) {
            const e = ((t * u) % factor) * step;
            const p = (u * rest + j) * done + k;
            yr += cos[e] * ar[p] - sin[e] * ai[p];
            yi += cos[e] * ai[p] + sin[e] * ar[p];
          }
          const e = (j * done * t) % length;
          const o = (j * factor + t) * done + k;
          br[o] = cos[e] * yr - sin[e] * yi;
          bi[o] = cos[e] * yi + sin[e] * yr;
        }
  }
}

/** Return the least length with factors 2, 3 and 5 that is at least as long. */
export function fastLength(least: number): number {
  for (let length = least; ; length++) {
    let rest = length;
    for (const factor of [2, 3, 5]) while (rest % factor === 0) rest /= factor;
    if (rest === 1) return length;
  }
}
