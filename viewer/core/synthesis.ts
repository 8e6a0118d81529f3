/** Modal sound: a sum of damped sinusoids, as objectfolder/sound/synthesis.py. */

import type { Modes } from "./tuning.ts";

type Complex = [number, number];

const SLOW = 1.5 * Math.PI; // radians of a mode during a contact beyond which its force counts as slow

const times = (a: Complex, b: Complex): Complex => [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
const minus = (a: Complex, b: Complex): Complex => [a[0] - b[0], a[1] - b[1]];
const over = (a: Complex, b: Complex): Complex => {
  const square = b[0] * b[0] + b[1] * b[1];
  return [(a[0] * b[0] + a[1] * b[1]) / square, (a[1] * b[0] - a[0] * b[1]) / square];
};
const exp = (a: Complex): Complex => {
  const size = Math.exp(a[0]);
  return [size * Math.cos(a[1]), size * Math.sin(a[1])];
};

/** (exp p - exp q) / (p - q), accurate near p = q, where the pulse resonates with the mode. */
function dividedDifference(p: Complex, q: Complex): Complex {
  const apart = minus(p, q);
  if (Math.hypot(apart[0], apart[1]) >= 0.2) return over(minus(exp(p), exp(q)), apart);
  const x = times([apart[0] / 2, apart[1] / 2], [apart[0] / 2, apart[1] / 2]);
  let series: Complex = [1, 0];
  for (const divisor of [42, 20, 6]) {
    const [re, im] = times([x[0] / divisor, x[1] / divisor], series);
    series = [1 + re, im];
  }
  return times(exp([(p[0] + q[0]) / 2, (p[1] + q[1]) / 2]), series);
}

/** Convolution of exp(s t) with the half sine of unit impulse, at a share of the contact. */
function stateAt(s: Complex, share: number, contact: number): Complex {
  const motion: Complex = [s[0] * share * contact, s[1] * share * contact];
  const turn = Math.PI * share;
  const [re, im] = minus(dividedDifference([0, turn], motion), dividedDifference([0, -turn], motion));
  return [(turn / 4) * im, (-turn / 4) * re];
}

export type Response = "displacement" | "velocity" | "acceleration";
const ORDER: Record<Response, number> = { displacement: 0, velocity: 1, acceleration: 2 };

export interface Strike {
  rate: number; // Hz
  duration: number; // s
  response: Response;
  contact: number; // s; 0 is an ideal impulse
  /** Modes end where their envelope is below this share of the loudest one's start; 0 never. */
  silence?: number;
}

/** A mode that rings after a strike as the imaginary part of start exp(s t), from the end of contact. */
interface Ringing {
  mode: number;
  s: Complex;
  start: Complex;
  gain: Complex;
}

/** Modes with complex gains: a gain turns its mode ahead. */
export interface Gained {
  frequency: Float64Array; // rad/s
  damping: Float64Array; // 1/s
  real: ArrayLike<number>;
  imaginary: ArrayLike<number> | null; // null: 0
  /** How many of the first ones are heard by their acceleration, and so is the force on them. */
  accelerated: number;
  /** How many of the last ones fade too fast to alias and are never left out. */
  certain: number;
}

/** Return modes with real gains. */
export function plain(modes: Modes, gains: ArrayLike<number>): Gained {
  const { frequency, damping } = modes;
  return { frequency, damping, real: gains, imaginary: null, accelerated: 0, certain: 0 };
}

/** Return how modes below half the sample rate ring. */
function ringing(modes: Gained, { rate, response, contact }: Strike): Ringing[] {
  const found: Ringing[] = [];
  for (let mode = 0; mode < modes.frequency.length; mode++) {
    const frequency = modes.frequency[mode];
    const gain: Complex = [modes.real[mode], modes.imaginary?.[mode] ?? 0];
    const aliases = frequency >= Math.PI * rate && mode < modes.frequency.length - modes.certain;
    if (aliases || (gain[0] === 0 && gain[1] === 0)) continue;
    const s: Complex = [-modes.damping[mode], frequency];
    let start: Complex = contact ? stateAt(s, 1, contact) : [1, 0];
    for (let o = 0; o < ORDER[response]; o++) start = times(start, s);
    const [re, im] = times(gain, start);
    found.push({ mode, s, start: [re / frequency, im / frequency], gain });
  }
  return found;
}

/** Amplitudes of the modes at the end of contact; 0 at or above half the sample rate. */
export function amplitudes(modes: Gained, strike: Strike): Float64Array {
  const found = new Float64Array(modes.frequency.length);
  for (const { mode, start } of ringing(modes, strike)) found[mode] = Math.hypot(...start);
  return found;
}

/** How a half sine and its derivative are heard while they act on a mode that is heard by its acceleration. */
function pressing(s: Complex, gain: Complex, contact: number): [number, number] {
  const turned = (s[1] * contact) ** 2;
  const share = turned / (turned + SLOW ** 2);
  const once = over(gain, s);
  return [once[1] / s[1], (share * over(once, s)[1]) / s[1]];
}

/** Return the sound of modes. Those at or above half the sample rate are left out. */
export function synthesise(modes: Gained, strike: Strike): Float32Array {
  const { rate, duration, contact, silence = 0 } = strike;
  const order = ORDER[strike.response];
  const out = new Float64Array(Math.round(rate * duration));
  const pressed = Math.min(Math.ceil(contact * rate - 1e-12), out.length);
  const heard = ringing(modes, strike);
  const loudest = heard.reduce((most, { start }) => Math.max(most, Math.hypot(...start)), 0);
  const turn = Math.PI / contact;
  for (const { mode, s, start, gain } of heard) {
    const [decay, frequency] = [-s[0], s[1]];
    const direct: [number, number] = order === 2 ? [gain[0], 0] : [0, 0];
    const [byForce, byChange] = mode < modes.accelerated ? pressing(s, gain, contact) : direct;
    for (let k = 0; k < pressed; k++) {
      const t = k / rate;
      let state = times(gain, stateAt(s, t / contact, contact));
      for (let o = 0; o < order; o++) state = times(state, s);
      const force = byForce * Math.sin(turn * t) + byChange * turn * Math.cos(turn * t);
      out[k] += state[1] / frequency + (turn / 2) * force;
    }
    const late = pressed / rate - contact;
    const [re, im] = times(start, exp([s[0] * late, s[1] * late]));
    let end = out.length;
    if (silence) {
      const lasting = Math.log(Math.hypot(re, im) / (silence * loudest)) / decay;
      end = Math.min(end, pressed + Math.ceil(Math.max(0, lasting) * rate));
    }
    // y[n] = 2 r cos(theta) y[n-1] - r^2 y[n-2]
    const shrink = Math.exp(-decay / rate);
    const first = 2 * shrink * Math.cos(frequency / rate);
    const second = shrink * shrink;
    const [c, d] = exp([-s[0] / rate, -s[1] / rate]);
    let now = im;
    let before = re * d + im * c;
    for (let k = pressed; k < end; k++) {
      out[k] += now;
      const next = first * now - second * before;
      before = now;
      now = next;
    }
  }
  return Float32Array.from(out);
}

/** Return the modal gains of an impulse (N s) from mode shapes (3, M). */
export function modalGains(modes: Modes, shapes: Float64Array, impulse: ArrayLike<number>): Float64Array {
  const count = shapes.length / 3;
  return Float64Array.from(modes.which, (mode) => {
    let sum = 0;
    for (let axis = 0; axis < 3; axis++) sum += shapes[axis * count + mode] * impulse[axis];
    return modes.shapeFactor * sum;
  });
}
