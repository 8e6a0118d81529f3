/** Sound that reaches a listener, as objectfolder/sound/far_field.py: far fields of the modes, and the recoil. */

import type { ObjectFile } from "./objectfile.ts";
import { floats } from "./safetensors.ts";
import type { Gained } from "./synthesis.ts";
import type { Modes } from "./tuning.ts";
import { length, scaled, type Vector } from "./vector.ts";
import { unxz } from "./xz.ts";

const AIR_DENSITY = 1.204; // kg/m^3
const SOUND_SPEED = 343.2; // m/s
const ALIKE = 0.01; // relative change of wavelength over size at which the stored fields hold
const OUTSIDE = 1.01; // radii of the ball that holds the object, within which no listener is

export interface RadiationConfig {
  kind: string;
  radius: number; // of the ball about the origin, over the longest side
  recoil: { centre: Vector; axes: [Vector, Vector, Vector]; radii: Vector };
}

export class Radiation {
  private readonly config: RadiationConfig;
  private readonly volume: number;
  private readonly scale: number;
  private readonly orders: Uint8Array;
  private readonly steps: Float32Array;
  private readonly codes: Int8Array;
  private readonly starts: Int32Array;
  private readonly frequency: Float64Array;

  private constructor(file: ObjectFile, frequency: Float64Array) {
    this.config = file.header.radiation!;
    this.volume = file.header.solid!.volume;
    this.scale = file.header.scale;
    this.frequency = frequency;
    this.orders = file.tensor("radiation.orders").bytes;
    this.steps = floats(file.tensor("radiation.steps"));
    this.starts = new Int32Array(this.orders.length + 1);
    this.orders.forEach((order, n) => {
      this.starts[n + 1] = this.starts[n] + 2 * (order + 1) ** 2;
    });
    const bytes = unxz(file.tensor("radiation.coefficients").bytes, this.starts[this.orders.length]);
    this.codes = new Int8Array(bytes.buffer);
  }

  /** Read the radiation of a file whose modes have these frequencies (rad/s); null if it stores none. */
  static read(file: ObjectFile, frequency: Float64Array): Radiation | null {
    const { radiation, solid } = file.header;
    if (radiation?.kind !== "spherical_harmonics" || !solid) return null;
    const found = new Radiation(file, frequency);
    return found.orders.length === frequency.length ? found : null;
  }

  /** Whether the fields are those of the modes of a body of a size that is a multiple of the object's own. */
  holds(modes: Modes, size: number): boolean {
    const [least, most] = modes.bounds;
    return modes.frequency.every((w, n) => {
      const ratio = (w * size) / this.frequency[modes.which[n]];
      return ratio * most - 1 <= ALIKE && 1 - ratio * least <= ALIKE;
    });
  }

  /**
   * Return what a listener hears of modes with real gains, as modes whose displacements sum to pascals: the own
   * ones, turned, which are heard by their acceleration, and the recoil along three axes.
   *
   * The listener is in units of the longest side, the impulse (N s) in the object frame, the density in kg/m^3.
   */
  heard(
    modes: Modes,
    gains: ArrayLike<number>,
    listener: Vector,
    impulse: ArrayLike<number>,
    size: number,
    density: number,
  ): Gained {
    const side = this.scale * size;
    const least = this.config.radius * OUTSIDE;
    const place = scaled(side * Math.max(1, least / length(listener)), listener);
    const distance = length(place);
    const directions = harmonics(
      scaled(1 / distance, place),
      this.orders.reduce((a, b) => Math.max(a, b), 0),
    );
    const count = modes.frequency.length;
    const frequency = new Float64Array(count + 3);
    const damping = new Float64Array(count + 3);
    const found = {
      frequency,
      damping,
      real: new Float64Array(count + 3),
      imaginary: new Float64Array(count + 3),
      accelerated: count,
      certain: 3,
    };
    frequency.set(modes.frequency);
    damping.set(modes.damping);
    for (let n = 0; n < count; n++) {
      const [re, im] = this.pressure(
        modes.which[n],
        modes.frequency[n] / SOUND_SPEED,
        distance,
        directions,
        side,
      );
      // Phasors of the fields turn the other way; the pressure is that of the acceleration, s^2 times the motion,
      // and the fields are those of the stored mode shapes.
      const [c, w] = [-modes.damping[n], modes.frequency[n]];
      const [a, b] = [c * c - w * w, 2 * c * w];
      const gain = modes.shapeFactor * gains[n];
      found.real[n] = gain * (re * a + im * b);
      found.imaginary[n] = gain * (re * b - im * a);
    }
    const { centre, axes, radii } = this.config.recoil;
    const away = place.map((value, axis) => value - side * centre[axis]) as Vector;
    const far = length(away);
    const mass = density * this.volume * side ** 3;
    axes.forEach((axis, n) => {
      const dot = (v: ArrayLike<number>) => axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2];
      const radius = side * radii[n];
      const rate = SOUND_SPEED / radius;
      const strength =
        (((AIR_DENSITY * radius ** 3 * rate ** 2) / mass) * ((dot(away) / far) * dot(impulse))) / far ** 2;
      const reach = (rate * far) / SOUND_SPEED;
      frequency[count + n] = damping[count + n] = rate;
      found.real[count + n] = strength * (1 - reach);
      found.imaginary[count + n] = strength * reach;
    });
    return found;
  }

  /** Pressure per unit of modal acceleration, of waves that leave the ball at once; see FarField.pressure. */
  private pressure(
    mode: number,
    wavenumber: number,
    distance: number,
    directions: Float64Array,
    side: number,
  ): [number, number] {
    const order = this.orders[mode];
    const start = this.starts[mode];
    const width = (order + 1) ** 2;
    const z = wavenumber * distance;
    // g_0 = 1, g_1 = 1 + i / z, g_(l+1) = g_(l-1) + i (2 l + 1) / z g_l
    let [before, now] = [
      [1, 0],
      [1, 1 / z],
    ];
    let [re, im] = [0, 0];
    for (let degree = 0; degree <= order; degree++) {
      const g = degree === 0 ? before : now;
      let [a, b] = [0, 0];
      for (let k = degree ** 2; k < (degree + 1) ** 2; k++) {
        a += this.codes[start + k] * directions[k];
        b += this.codes[start + width + k] * directions[k];
      }
      re += g[0] * a - g[1] * b;
      im += g[0] * b + g[1] * a;
      if (degree > 0) {
        const turn = (2 * degree + 1) / z;
        [before, now] = [now, [before[0] - turn * now[1], before[1] + turn * now[0]]];
      }
    }
    const phase = wavenumber * this.config.radius * side;
    const size = (this.steps[mode] * side) / this.scale / (distance * (this.scale / side));
    const [c, s] = [Math.cos(phase) * size, Math.sin(phase) * size];
    return [re * c - im * s, re * s + im * c];
  }
}

/** Real orthonormal spherical harmonics of a unit vector up to an order, at l^2 + l + m. */
export function harmonics(direction: Vector, order: number): Float64Array {
  const [x, y, z] = direction;
  const flat = Math.hypot(x, y);
  const azimuth = Math.atan2(y, x);
  const found = new Float64Array((order + 1) ** 2);
  let top = Math.sqrt(1 / (4 * Math.PI)); // normalised Legendre function of degree and order m
  for (let m = 0; m <= order; m++) {
    if (m > 0) top *= Math.sqrt((2 * m + 1) / (2 * m)) * flat;
    const [cosine, sine] =
      m === 0 ? [1, 0] : [Math.SQRT2 * Math.cos(m * azimuth), Math.SQRT2 * Math.sin(m * azimuth)];
    let [below, value] = [0, top];
    for (let l = m; l <= order; l++) {
      if (l > m) {
        const a = Math.sqrt((4 * l * l - 1) / (l * l - m * m));
        const b = l - 1 > m ? Math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1)) : 0;
        [below, value] = [value, a * (z * value - b * below)];
      }
      found[l * l + l + m] = value * cosine;
      if (m > 0) found[l * l + l - m] = value * sine;
    }
  }
  return found;
}
