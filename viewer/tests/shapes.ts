/** Distance grids of simple shapes. */

import { BOUND, Grid } from "../core/grid.ts";

/** Sample a signed distance of the unit frame. */
export function gridOf(count: number, distance: (x: number, y: number, z: number) => number): Grid {
  const spacing = (2 * BOUND) / (count - 1);
  const band = Math.max(2.5 * spacing, 0.0102);
  const values = new Int8Array(count ** 3);
  for (let n = 0; n < values.length; n++) {
    const [i, j, k] = [Math.floor(n / count ** 2), Math.floor(n / count) % count, n % count];
    const d = distance(i * spacing - BOUND, j * spacing - BOUND, k * spacing - BOUND);
    values[n] = Math.round(Math.min(Math.max((127 * d) / band, -127), 127));
  }
  return new Grid(values, count, band);
}

export const RADIUS = 0.4;

export const ball = (count = 96): Grid => gridOf(count, (x, y, z) => Math.hypot(x, y, z) - RADIUS);

/** A box with sides along the axes; exact inside only. */
export const box = (count: number, half: [number, number, number]): Grid =>
  gridOf(count, (x, y, z) => Math.max(Math.abs(x) - half[0], Math.abs(y) - half[1], Math.abs(z) - half[2]));
