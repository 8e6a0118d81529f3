/** Deformation of the gel by a contact, as objectfolder/touch/gel.py. */

import { type Layer, Response } from "./layer.ts";
import type { Camera } from "./sensor.ts";

const TOLERANCE = 8e-3; // gap under pressure and overlap without it, of the deepest overlap
const MAX_STEPS = 300;
const COARSEST = 40; // pixels along the shorter side of the coarsest grid
const STEP = 0.7;
const STEPS: [number, number] = [0.2, 3];

export interface Deformed {
  /** Metres towards the camera. */
  displacement: Float32Array;
  /** Pa; null for a rigid gel. */
  pressure: Float32Array | null;
}

/** Press heights into the gel: the exact imprint of a rigid one, or unilateral contact with an elastic layer. */
export function deform(height: Float32Array, camera: Camera): Deformed {
  const { profile, pitch } = camera;
  if (profile.gel === "rigid") return { displacement: height.map((h) => Math.max(h, 0)), pressure: null };
  const layer = {
    thickness: profile.elastomer_thickness,
    youngModulus: profile.young_modulus,
    poissonRatio: profile.poisson_ratio,
  };
  let [least, most] = [0, 0];
  for (const h of height) {
    least = Math.min(least, h);
    most = Math.max(most, h);
  }
  const count = height.length;
  if (most <= 0) return { displacement: new Float32Array(count), pressure: new Float32Array(count) };
  const reachable = Uint8Array.from(height, (h) => (h > least ? 1 : 0));
  const { pressure, moved } = solve(height, reachable, profile.height, profile.width, pitch, layer);
  // Remove the gaps and overlaps that the tolerance leaves.
  const displacement = moved.map((d, n) =>
    (pressure[n] > 0 || d < height[n]) && reachable[n] ? height[n] : d,
  );
  return { displacement, pressure };
}

const responses = new Map<string, Response>();

function responseOf(rows: number, columns: number, pitch: number, layer: Layer): Response {
  const key = [rows, columns, pitch, ...Object.values(layer)].join();
  let found = responses.get(key);
  if (!found) {
    found = new Response(rows, columns, pitch, layer);
    responses.set(key, found);
  }
  return found;
}

/** Preconditioned projected gradients with the steps of Barzilai and Borwein, from coarse to fine grids. */
function solve(
  height: Float32Array,
  reachable: Uint8Array,
  rows: number,
  columns: number,
  pitch: number,
  layer: Layer,
): { pressure: Float32Array; moved: Float32Array } {
  const count = rows * columns;
  const response = responseOf(rows, columns, pitch, layer);
  let pressure: Float32Array = new Float32Array(count);
  const moved = new Float32Array(count);
  if (Math.min(rows, columns) >= 2 * COARSEST) {
    const [halfRows, halfColumns] = [(rows + 1) >> 1, (columns + 1) >> 1];
    const reach = halved(Float32Array.from(reachable), rows, columns);
    const coarse = solve(
      halved(height, rows, columns),
      Uint8Array.from(reach, (share) => (share > 0 ? 1 : 0)),
      halfRows,
      halfColumns,
      2 * pitch,
      layer,
    );
    pressure = doubled(coarse.pressure, halfRows, halfColumns, rows, columns);
    for (let n = 0; n < count; n++) pressure[n] *= reachable[n];
    response.run(pressure, moved);
  }
  let most = 0;
  for (const h of height) most = Math.max(most, h);
  const residual = new Float32Array(count);
  const next = new Float32Array(count);
  let step = STEP;
  for (let round = 0; round < MAX_STEPS; round++) {
    let worst = 0;
    for (let n = 0; n < count; n++) {
      const gap = moved[n] - height[n];
      residual[n] = (pressure[n] > 0 || gap < 0) && reachable[n] ? gap : 0;
      worst = Math.max(worst, Math.abs(residual[n]));
    }
    if (worst <= TOLERANCE * most) return { pressure, moved };
    const after = descended(
      pressure,
      moved,
      height,
      reachable,
      residual,
      rows,
      columns,
      step,
      response.stencil,
    );
    response.run(after, next);
    let work = 0;
    let gained = 0;
    for (let n = 0; n < count; n++) {
      const change = after[n] - pressure[n];
      work += change * (next[n] - moved[n]);
      gained += change * residual[n];
    }
    pressure = after;
    moved.set(next);
    if (work > 0) step = Math.min(Math.max((-step * gained) / work, STEPS[0]), STEPS[1]);
  }
  throw new Error("the contact of the gel did not converge; press elsewhere, or less deep");
}

/** Return the pressure after one step along the preconditioned residual, not below 0. */
function descended(
  pressure: Float32Array,
  moved: Float32Array,
  height: Float32Array,
  reachable: Uint8Array,
  residual: Float32Array,
  rows: number,
  columns: number,
  step: number,
  [centre, side, corner]: [number, number, number],
): Float32Array {
  const after = new Float32Array(pressure.length);
  const at = (r: number, c: number) =>
    r < 0 || c < 0 || r >= rows || c >= columns ? 0 : residual[r * columns + c];
  for (let r = 0, n = 0; r < rows; r++)
    for (let c = 0; c < columns; c++, n++) {
      if (!((pressure[n] > 0 || moved[n] < height[n]) && reachable[n])) {
        after[n] = pressure[n];
        continue;
      }
      const edges = at(r, c - 1) + at(r, c + 1) + at(r - 1, c) + at(r + 1, c);
      const corners = at(r - 1, c - 1) + at(r - 1, c + 1) + at(r + 1, c - 1) + at(r + 1, c + 1);
      const descent = centre * residual[n] + side * edges + corner * corners;
      after[n] = Math.max(pressure[n] - step * descent, 0);
    }
  return after;
}

/** Means of 2 x 2 pixels. */
function halved(image: Float32Array, rows: number, columns: number): Float32Array {
  const [height, width] = [(rows + 1) >> 1, (columns + 1) >> 1];
  const out = new Float32Array(height * width);
  for (let r = 0; r < height; r++)
    for (let c = 0; c < width; c++) {
      const below = Math.min(2 * r + 1, rows - 1) * columns;
      const right = Math.min(2 * c + 1, columns - 1);
      const above = 2 * r * columns;
      out[r * width + c] =
        (image[above + 2 * c] + image[above + right] + image[below + 2 * c] + image[below + right]) / 4;
    }
  return out;
}

/** Interpolate between the centres of 2 x 2 pixels. */
function doubled(
  image: Float32Array,
  height: number,
  width: number,
  rows: number,
  columns: number,
): Float32Array {
  const out = new Float32Array(rows * columns);
  const at = (r: number, c: number) =>
    image[Math.min(Math.max(r, 0), height - 1) * width + Math.min(Math.max(c, 0), width - 1)];
  for (let r = 0; r < rows; r++)
    for (let c = 0; c < columns; c++) {
      const [i, j] = [r >> 1, c >> 1];
      const [u, v] = [r & 1 ? i + 1 : i - 1, c & 1 ? j + 1 : j - 1];
      out[r * columns + c] = 0.5625 * at(i, j) + 0.1875 * (at(u, j) + at(i, v)) + 0.0625 * at(u, v);
    }
  return out;
}
