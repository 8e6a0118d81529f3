/** Lights of the page. */

import type { PointLight } from "../core/indirect.ts";
import { scaled, type Vector } from "../core/vector.ts";

const KEY = 2.4; // distance of the studio's main light
const degree = Math.PI / 180;

function direction(azimuth: number, elevation: number): Vector {
  const flat = Math.cos(elevation * degree);
  return [Math.cos(azimuth * degree) * flat, Math.sin(azimuth * degree) * flat, Math.sin(elevation * degree)];
}

/** A main light, a weaker one from the other side, and one from behind; angles in degrees are the main light's. */
export function studio(azimuth: number, elevation: number): PointLight[] {
  const light = (turn: number, height: number, strength: number, tint: Vector): PointLight => ({
    position: scaled(KEY, direction(azimuth + turn, height)),
    color: scaled(strength * KEY ** 2, tint),
  });
  return [
    light(0, elevation, 0.82, [1, 0.985, 0.96]),
    light(-100, 20, 0.34, [0.94, 0.97, 1]),
    light(150, 45, 0.5, [1, 1, 1]),
  ];
}

/** The light of a query: one point, of which a white surface at distance 1 has radiance 1. */
export function single(azimuth: number, elevation: number, distance: number): PointLight[] {
  return [{ position: scaled(distance, direction(azimuth, elevation)), color: [1, 1, 1] }];
}
