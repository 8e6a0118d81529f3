/** Camera images of the deformed gel, as objectfolder/touch/optics.py and shading.py. */

import { residualLevels } from "./residual.ts";
import type { Camera } from "./sensor.ts";

const MAX_STEP = 2; // pixel pitches between the depths of neighbouring pixels of one surface
const DIELECTRIC = 0.04;
const LEAST_COSINE = 0.001;

function gaussian(deviation: number): number[] {
  if (deviation === 0) return [1];
  const length = Math.ceil(2 * deviation) + 1;
  const weights = Array.from({ length }, (_, i) => Math.exp(-(i * i) / (2 * deviation * deviation)));
  const sum = 2 * weights.reduce((a, b) => a + b) - 1;
  return weights.map((weight) => weight / sum);
}

/** Convolve an image in place with a symmetric filter; beyond the border it is 0, or its mirror image. */
function filter(
  image: Float32Array,
  rows: number,
  columns: number,
  weights: number[],
  mirror: boolean,
): void {
  const reach = weights.length - 1;
  if (!reach) return;
  const line = new Float64Array(Math.max(rows, columns) + 2 * reach);
  const pass = (count: number, length: number, step: number, next: number) => {
    for (let n = 0; n < count; n++) {
      const at = n * next;
      for (let i = 0; i < length; i++) line[reach + i] = image[at + i * step];
      for (let i = 1; i <= reach; i++) {
        line[reach - i] = mirror ? line[reach + i] : 0;
        line[reach + length - 1 + i] = mirror ? line[reach + length - 1 - i] : 0;
      }
      for (let i = 0; i < length; i++) {
        let sum = weights[0] * line[reach + i];
        for (let d = 1; d <= reach; d++) sum += weights[d] * (line[reach + i - d] + line[reach + i + d]);
        image[at + i * step] = sum;
      }
    }
  };
  pass(rows, columns, 1, columns);
  pass(columns, rows, columns, 1);
}

export class Optics {
  private readonly background: Float32Array;
  private readonly still: Float32Array;
  private readonly gelAlongY: Float64Array;
  private readonly gelAlongZ: Float64Array;

  /** @param background (H, W, 3) picture of the untouched sensor; default: synthetic */
  constructor(
    private readonly camera: Camera,
    background?: Uint8Array,
  ) {
    this.gelAlongY = camera.gradient(camera.gel, false);
    this.gelAlongZ = camera.gradient(camera.gel, true);
    const zero = new Float32Array(camera.gel.length);
    this.still = this.display(zero, zero, zero, null);
    this.background = background ? Float32Array.from(background) : glow(camera);
  }

  /** Return the RGBA picture of the gel; it rests where the displacement is 0. */
  render(displacement: Float32Array): Uint8ClampedArray {
    const { camera } = this;
    const { width, height, gain, image_smoothing: blur } = camera.profile;
    const count = width * height;
    const [alongY, alongZ] = this.slopes(displacement);
    const display = this.display(displacement, alongY, alongZ, displacement);
    const { residual } = camera.profile;
    const rest = residual?.length ? residualLevels(camera, alongY, alongZ) : null;
    const out = new Uint8ClampedArray(4 * count).fill(255);
    const change = new Float32Array(count);
    for (let channel = 0; channel < 3; channel++) {
      const at = channel * count;
      for (let n = 0; n < count; n++) {
        const brighter = (display[at + n] - this.still[at + n]) * 255 * gain + (rest ? rest[at + n] : 0);
        change[n] = displacement[n] !== 0 ? brighter : 0;
      }
      filter(change, height, width, gaussian(blur / camera.pitch), true);
      for (let n = 0; n < count; n++) out[4 * n + channel] = change[n] + this.background[3 * n + channel];
    }
    return out;
  }

  /** Smoothed slopes of the displacement inside the contact, along y and z. */
  private slopes(displacement: Float32Array): [Float32Array, Float32Array] {
    const { camera } = this;
    const { width, height, slope_smoothing: smoothing } = camera.profile;
    const count = width * height;
    const weights = gaussian(smoothing / camera.pitch);
    const inside = Float32Array.from(displacement, (d) => (d !== 0 ? 1 : 0));
    const along = (step: number, pitch: number): Float32Array => {
      const total = new Float32Array(count);
      const terms = new Uint8Array(count);
      for (let n = 0; n + step < count; n++) {
        if (step === 1 && n % width === width - 1) continue;
        const difference = displacement[n] - displacement[n + step];
        const steep = !(Math.abs(difference) < MAX_STEP * camera.pitch);
        if (!inside[n] || !inside[n + step] || steep) continue;
        for (const at of [n, n + step]) {
          total[at] += difference;
          terms[at]++;
        }
      }
      for (let n = 0; n < count; n++) total[n] /= Math.max(terms[n], 1) * pitch;
      filter(total, height, width, weights, false);
      return total;
    };
    const alongY = along(1, camera.y[0] - camera.y[1]);
    const alongZ = along(width, camera.z[0] - camera.z[width]);
    filter(inside, height, width, weights, false);
    for (const slope of [alongY, alongZ])
      for (let n = 0; n < count; n++) slope[n] /= Math.min(Math.max(inside[n], 1e-12), 1);
    return [alongY, alongZ];
  }

  /** Display values, three planes, of a gel with a displacement and its slopes; only where a mask is not 0. */
  private display(
    moved: Float32Array,
    slopeY: Float32Array,
    slopeZ: Float32Array,
    mask: Float32Array | null,
  ): Float32Array {
    const { camera } = this;
    const { profile } = camera;
    const count = moved.length;
    const out = new Float32Array(3 * count);
    const f0 = DIELECTRIC * (1 - profile.metallic) + profile.albedo * profile.metallic;
    const diffuse = (profile.albedo * (1 - DIELECTRIC) * (1 - profile.metallic)) / Math.PI;
    const alpha2 = profile.roughness ** 4;
    const k = (profile.roughness + 1) ** 2 / 8;
    for (let n = 0; n < count; n++) {
      if (mask && mask[n] === 0) continue;
      const [y, z] = [camera.y[n], camera.z[n]];
      const x = camera.gel[n] - moved[n];
      const alongY = this.gelAlongY[n] - slopeY[n];
      const alongZ = this.gelAlongZ[n] - slopeZ[n];
      let nx = -(x + y * alongY + z * alongZ);
      const size = Math.sqrt(nx * nx + alongY * alongY + alongZ * alongZ);
      nx /= size;
      const [ny, nz] = [alongY / size, alongZ / size];
      const [py, pz] = [y * x, z * x];
      const square = x * x + py * py + pz * pz;
      const far = Math.sqrt(square);
      const height = nx * x + ny * py + nz * pz;
      const facing = -height / far;
      const seen = Math.min(Math.max(Math.abs(facing), LEAST_COSINE), 1);
      const shadowed = (seen / (seen * (1 - k) + k)) * (alpha2 / Math.PI);
      let [red, green, blue] = [profile.ambient, profile.ambient, profile.ambient];
      for (const { position, color, intensity } of profile.lights) {
        const [lx, ly, lz] = position;
        const product = x * lx + py * ly + pz * lz;
        const distance = Math.sqrt(square - 2 * product + lx * lx + ly * ly + lz * lz);
        const onePlus = Math.min(Math.max((far - product / far) / distance + 1, 1e-12), 2);
        const lit = (nx * lx + ny * ly + nz * lz - height) / distance;
        const received = Math.min(Math.max(lit, LEAST_COSINE), 1);
        const twice = Math.min(Math.max(lit + facing, 0), 2);
        const spread = Math.min(Math.max(((twice * twice) / onePlus) * ((alpha2 - 1) / 2) + 1, alpha2), 1);
        const fresnel = (Math.sqrt(onePlus * 0.5) - 1) ** 5 * (f0 - 1) + f0;
        const below = (received * 4 * seen + 0.001) * spread * spread * (received * (1 - k) + k);
        const specular = (received * shadowed) / below;
        const reflected =
          ((((specular - diffuse) * fresnel + diffuse) * received) / distance / distance) * intensity;
        red += reflected * color[0];
        green += reflected * color[1];
        blue += reflected * color[2];
      }
      const shown = (value: number) => Math.min(Math.max(value, 1e-30), 1) ** (1 / profile.gamma);
      out[n] = shown(red);
      out[count + n] = shown(green);
      out[2 * count + n] = shown(blue);
    }
    return out;
  }
}

/** Picture of the untouched sensor: a dim grey with each light's glow on its side. */
function glow(camera: Camera): Float32Array {
  const { profile, gel, y, z } = camera;
  const out = new Float32Array(3 * gel.length);
  for (let n = 0; n < gel.length; n++) out.set(profile.background_color, 3 * n);
  for (const { position, color } of profile.lights) {
    const distance = gel.map((depth, n) =>
      Math.hypot(position[1] - y[n] * depth, position[2] - z[n] * depth),
    );
    const least = distance.reduce((a, b) => Math.min(a, b));
    distance.forEach((d, n) => {
      const value = profile.background_glow / (1 + ((d - least) / profile.background_falloff) ** 2);
      for (let channel = 0; channel < 3; channel++) out[3 * n + channel] += value * color[channel];
    });
  }
  return out.map((value) => Math.min(Math.max(Math.round(255 * value), 0), 255));
}
