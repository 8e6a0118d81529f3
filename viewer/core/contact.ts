/** Geometry of a contact: its normal, the sensor's pose, and the heights of the object in the gel. */

import type { Grid } from "./grid.ts";
import type { Camera } from "./sensor.ts";
import type { Mesh } from "./surface.ts";
import { along, cross, dot, length, scaled, unit, type Vector } from "./vector.ts";

const GAP = 0.15; // thicknesses of the gel; wider gaps are not resolved
const NORMAL_RADIUS = 0.01; // unit frame
const UP: Vector = scaled(1 / Math.sqrt(21), [1, 2, 4]); // of the image at angle 0
const FREED = 0.05; // thicknesses that material may reach past the base of a sensor that is free
const NEAR = 1e-4; // metres in front of the camera; triangles that reach behind it are not drawn
const OVERLAP = -1e-5; // no cracks between triangles
const BEHIND = 16;

let probes: Vector[] | null = null;

/** 64 directions: a Fibonacci half sphere, balanced to a tight frame, and its mirror image. */
function directions(): Vector[] {
  if (probes) return probes;
  let half = Array.from({ length: 32 }, (_, k): Vector => {
    const height = (k + 0.5) / 32;
    const azimuth = k * Math.PI * (3 - Math.sqrt(5));
    const ring = Math.sqrt(1 - height * height);
    return [ring * Math.cos(azimuth), ring * Math.sin(azimuth), height];
  });
  for (let round = 0; round < 30; round++) {
    const root = inverseRoot(
      [0, 1, 2].map((i) => [0, 1, 2].map((j) => half.reduce((sum, u) => sum + u[i] * u[j], 0) / (32 / 3))),
    );
    half = half.map((u) =>
      unit([0, 1, 2].map((j) => u[0] * root[0][j] + u[1] * root[1][j] + u[2] * root[2][j]) as Vector),
    );
  }
  probes = [...half, ...half.map((u) => scaled(-1, u))];
  return probes;
}

/** Inverse square root of a 3 x 3 matrix near 1, by Newton's iteration. */
function inverseRoot(matrix: number[][]): number[][] {
  const product = (a: number[][], b: number[][]) =>
    a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
  let root = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ];
  for (let step = 0; step < 20; step++) {
    const rest = product(matrix, product(root, root)).map((row, i) =>
      row.map((e, j) => (i === j ? 3 : 0) - e),
    );
    root = product(root, rest).map((row) => row.map((e) => e / 2));
  }
  return root;
}

/** Outward contact normal at a point of the unit frame: the gradient of the distance, averaged over a sphere. */
export function contactNormal(grid: Grid, point: Vector): Vector {
  let normal: Vector = [0, 0, 0];
  for (const u of directions()) {
    const [x, y, z] = along(point, NORMAL_RADIUS, u);
    normal = along(normal, grid.smoothDistance(x, y, z), u);
  }
  return unit(normal);
}

/** Axes x, y and z of the sensor in the object frame; x points into the object, z is up in the image. */
export function sensorFrame(normal: Vector, angle: number): [Vector, Vector, Vector] {
  let up = along(UP, -dot(normal, UP), normal);
  if (length(up) < 1e-9) up = along([0, 1, 0], -normal[1], normal);
  up = unit(up);
  const left = cross(normal, up);
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [scaled(-1, normal), along(scaled(c, left), -s, up), along(scaled(c, up), s, left)];
}

export interface Heights {
  /** Of the object past the undeformed gel, metres; negative is a gap. */
  height: Float32Array;
  /** Share of the pixels with material nearer to the camera than the gel's base. */
  obstructed: number;
}

/** Pose of the sensor: contact point in metres, outward normal, axes, and press depth in metres. */
export interface Pose {
  point: Vector;
  normal: Vector;
  frame: [Vector, Vector, Vector];
  depth: number;
}

/** What the rays of the sensor's pixels meet. */
interface Seen {
  /** Of the first surface beyond the base, metres; 0 within the object. */
  depth: Float32Array;
  /** Pixels with material on the camera's side of the base. */
  blocked: number;
  /** How far material across the base reaches past it, metres. */
  overlap: number;
}

/**
 * Return the heights that the Python library finds by casting a ray through each pixel.
 *
 * Material across the gel's base meets the sensor's body: the sensor stops short by as much as it reaches past
 * the base, and leaves the gel untouched where that frees nothing.
 */
export function heights(mesh: Mesh, grid: Grid, camera: Camera, pose: Pose, scale: number): Heights {
  const { profile, gel } = camera;
  const gap = GAP * profile.elastomer_thickness;
  let back = profile.camera_to_gel - pose.depth;
  const seenFrom = () =>
    seen(mesh, grid, camera, pose, scaled(1 / scale, along(pose.point, back, pose.normal)), scale);
  let found = seenFrom();
  const obstructed = found.blocked / gel.length;
  if (found.overlap > 0 && found.overlap < profile.camera_to_gel) {
    back += found.overlap;
    found = seenFrom();
  }
  const { depth, overlap } = found;
  const free = overlap <= FREED * profile.elastomer_thickness;
  const height = depth.map((far, n) =>
    free ? Math.min(Math.max(gel[n] - far, -gap), profile.max_indentation) : -gap,
  );
  return { height, obstructed };
}

/** Draw the triangles into the sensor's camera at a place of the unit frame. */
function seen(mesh: Mesh, grid: Grid, camera: Camera, pose: Pose, eye: Vector, scale: number): Seen {
  const { profile, gel } = camera;
  const { width, height: rows } = profile;
  const count = width * rows;
  const { column, row, inverse, side } = projected(mesh, camera, pose, eye, scale);
  // Inverse depths of the nearest front and back face beyond the base, and of the last face before it.
  const front = new Float32Array(count);
  const back = new Float32Array(count);
  const before = new Float32Array(count).fill(Number.POSITIVE_INFINITY);
  const base = Float32Array.from(gel, (depth) => 1 / (depth - profile.elastomer_thickness));
  const { index } = mesh;
  for (let t = 0; t < index.length; t += 3) {
    const a = index[t];
    const b = index[t + 1];
    const c = index[t + 2];
    if (side[a] & side[b] & side[c] || (side[a] | side[b] | side[c]) & BEHIND) continue;
    const ia = inverse[a];
    const ib = inverse[b];
    const ic = inverse[c];
    const ax = column[a];
    const ay = row[a];
    const bx = column[b];
    const by = row[b];
    const cx = column[c];
    const cy = row[c];
    const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx)));
    const right = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx)));
    if (left > right) continue;
    const top = Math.max(0, Math.ceil(Math.min(ay, by, cy)));
    const bottom = Math.min(rows - 1, Math.floor(Math.max(ay, by, cy)));
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    if (area === 0) continue;
    const nearest = area > 0 ? back : front; // pixels grow to the right and down
    for (let y = top; y <= bottom; y++)
      for (let x = left; x <= right; x++) {
        const wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area;
        const wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area;
        const wc = 1 - wa - wb;
        if (wa < OVERLAP || wb < OVERLAP || wc < OVERLAP) continue;
        const i = wa * ia + wb * ib + wc * ic;
        const pixel = y * width + x;
        if (i > base[pixel]) before[pixel] = Math.min(before[pixel], i);
        else if (i > nearest[pixel]) nearest[pixel] = i;
      }
  }
  const enclosed = grid.distance(eye[0], eye[1], eye[2]) < 0;
  const depth = new Float32Array(count);
  let blocked = 0;
  let overlap = 0;
  for (let n = 0; n < count; n++) {
    const met = before[n] < Number.POSITIVE_INFINITY;
    if (met || enclosed) blocked++;
    depth[n] = front[n] > 0 ? 1 / front[n] : Number.POSITIVE_INFINITY;
    // At silhouettes, back faces are as near as front faces: they count behind blocking material only.
    if (!(met || enclosed) || back[n] <= front[n]) continue;
    depth[n] = 0;
    overlap = Math.max(overlap, met ? 1 / base[n] - 1 / before[n] : Number.POSITIVE_INFINITY);
  }
  return { depth, blocked, overlap };
}

interface Projected {
  column: Float32Array;
  row: Float32Array;
  /** 1 / depth in metres. */
  inverse: Float32Array;
  /** Bits of the sides of the picture beyond which vertices lie; `BEHIND` if not in front of the camera. */
  side: Uint8Array;
}

/** Project the vertices into the camera. */
function projected(mesh: Mesh, camera: Camera, pose: Pose, eye: Vector, scale: number): Projected {
  const { position } = mesh;
  const { width, height } = camera.profile;
  const [vertical, horizontal] = camera.half;
  const [fx, fy, fz] = pose.frame;
  const [ex, ey, ez] = eye;
  const count = position.length / 3;
  const column = new Float32Array(count);
  const row = new Float32Array(count);
  const inverse = new Float32Array(count);
  const side = new Uint8Array(count);
  for (let v = 0, k = 0; v < count; v++, k += 3) {
    const a = position[k] - ex;
    const b = position[k + 1] - ey;
    const c = position[k + 2] - ez;
    const depth = a * fx[0] + b * fx[1] + c * fx[2];
    if (depth < NEAR / scale) {
      side[v] = BEHIND;
      continue;
    }
    inverse[v] = 1 / depth / scale;
    const x = (1 - (a * fy[0] + b * fy[1] + c * fy[2]) / depth / horizontal) * 0.5 * width - 0.5;
    const y = (1 - (a * fz[0] + b * fz[1] + c * fz[2]) / depth / vertical) * 0.5 * height - 0.5;
    column[v] = x;
    row[v] = y;
    side[v] = (x < 0 ? 1 : 0) | (x > width - 1 ? 2 : 0) | (y < 0 ? 4 : 0) | (y > height - 1 ? 8 : 0);
  }
  return { column, row, inverse, side };
}
