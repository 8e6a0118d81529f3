/** What a fitted light model leaves over, as objectfolder/touch/residual.py. */

import type { Camera } from "./sensor.ts";

const DEGREE = 3; // of the polynomial in the tilt; it is linear in the place

/** Return grey levels, three planes, for the slopes of the displacement along y and z. */
export function residualLevels(camera: Camera, alongY: Float32Array, alongZ: Float32Array): Float32Array {
  const { gel, y, z, half, profile } = camera;
  const count = gel.length;
  const out = new Float32Array(3 * count);
  const longer = Math.max(...half);
  for (let n = 0; n < count; n++) {
    const [a, b] = [alongY[n] / gel[n], alongZ[n] / gel[n]];
    const size = Math.hypot(a, b, 1);
    const places = [1, y[n] / longer, z[n] / longer];
    let term = 0;
    for (let total = 1; total <= DEGREE; total++)
      for (let power = 0; power <= total; power++) {
        const tilted = (a / size) ** (total - power) * (b / size) ** power;
        for (const place of places) {
          for (let c = 0; c < 3; c++) out[c * count + n] += profile.residual![c][term] * tilted * place;
          term++;
        }
      }
  }
  return out;
}
