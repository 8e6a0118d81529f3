/** Pictures of untouched sensors in the page's settings, as objectfolder/viewer/background.py packs them. */

import { fromBase64 } from "./base64.ts";
import { unxz } from "./xz.ts";

const STEP = 5; // levels of 255 between the values that are kept

/** Unpack a picture, (height, width, 3). */
export function unpackBackground(packed: string, height: number, width: number): Uint8Array {
  const row = 3 * width;
  const steps = unxz(fromBase64(packed), row * height);
  for (let n = row; n < steps.length; n++) steps[n] += steps[n - row];
  return steps.map((step) => STEP * step);
}
