/** Principled BSDF of an opaque surface under a point light, as objectfolder/vision/bsdf.py. page/shaders.ts has it in GLSL. */

import { dot, unit, type Vector } from "./vector.ts";

const REFRACTIVE_INDEX = 1.5;
const LEAST_ALPHA = 0.001;

function schlick(cosine: number): number {
  return Math.min(Math.max(1 - cosine, 0), 1) ** 5;
}

function dielectric(cosine: number): number {
  const c = Math.min(Math.max(cosine, 0), 1);
  const inside = Math.sqrt(1 - (1 - c * c) / REFRACTIVE_INDEX ** 2);
  const across = (c - REFRACTIVE_INDEX * inside) / (c + REFRACTIVE_INDEX * inside);
  const parallel = (inside - REFRACTIVE_INDEX * c) / (inside + REFRACTIVE_INDEX * c);
  return 0.5 * (across ** 2 + parallel ** 2);
}

/** Fresnel reflectance of a base colour. */
export function fresnel(cosine: number, color: Vector, metallic: number): Vector {
  const plain = (1 - metallic) * dielectric(cosine);
  const edge = schlick(cosine);
  return color.map((c) => plain + metallic * (c + (1 - c) * edge)) as Vector;
}

const masking = (cosine: number, squared: number): number =>
  (2 * cosine) / (cosine + Math.sqrt(squared + (1 - squared) * cosine ** 2));

/** Return pi times BSDF times cosine; 0 where the camera or the light is behind the surface. */
export function principled(
  normal: Vector,
  view: Vector,
  light: Vector,
  color: Vector,
  roughness: number,
  metallic: number,
): Vector {
  let seen = -dot(normal, view);
  let received = dot(normal, light);
  if (seen <= 0 || received <= 0) return [0, 0, 0];
  seen = Math.max(seen, 1e-4);
  received = Math.max(received, 1e-6);
  const half = unit([light[0] - view[0], light[1] - view[1], light[2] - view[2]]);
  const grazing = dot(half, light);
  const squared = Math.max(LEAST_ALPHA, roughness ** 2) ** 2;
  const cosine = dot(normal, half);
  const rest = Math.max(1 - cosine ** 2, 0);
  const distribution = squared / (Math.PI * (squared * cosine ** 2 + rest) ** 2);
  const lobe = ((Math.PI / 4) * distribution * masking(seen, squared) * masking(received, squared)) / seen;
  const [atLight, atEye, retro] = [schlick(received), schlick(seen), 2 * roughness * grazing ** 2];
  const diffuse =
    (1 - 0.5 * atLight) * (1 - 0.5 * atEye) + retro * (atLight + atEye + atLight * atEye * (retro - 1));
  const reflected = fresnel(grazing, color, metallic);
  return color.map((c, n) => reflected[n] * lobe + (1 - metallic) * c * received * diffuse) as Vector;
}
