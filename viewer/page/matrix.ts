/** 4 x 4 matrices by columns, as WebGL takes them. */

import { cross, dot, unit, type Vector } from "../core/vector.ts";

export type Matrix = Float32Array;

export function product(a: Matrix, b: Matrix): Matrix {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++)
      for (let k = 0; k < 4; k++) out[4 * column + row] += a[4 * k + row] * b[4 * column + k];
  return out;
}

/** Perspective projection. @param tangent of half the vertical field of view */
export function perspective(tangent: number, aspect: number, near: number, far: number): Matrix {
  const out = new Float32Array(16);
  out[0] = 1 / (tangent * aspect);
  out[5] = 1 / tangent;
  out[10] = (far + near) / (near - far);
  out[11] = -1;
  out[14] = (2 * far * near) / (near - far);
  return out;
}

/** Axes of a camera (right, up, backward) at a point that looks at another, with z up. */
export function axes(eye: Vector, target: Vector): [Vector, Vector, Vector] {
  const back = unit([eye[0] - target[0], eye[1] - target[1], eye[2] - target[2]]);
  const upright: Vector = Math.abs(back[2]) > 0.9999 ? [0, 1, 0] : [0, 0, 1];
  const right = unit(cross(upright, back));
  return [right, cross(back, right), back];
}

/** World to camera. */
export function lookAt(eye: Vector, target: Vector): Matrix {
  const out = new Float32Array(16);
  axes(eye, target).forEach((axis, row) => {
    for (let k = 0; k < 3; k++) out[4 * k + row] = axis[k];
    out[12 + row] = -dot(axis, eye);
  });
  out[15] = 1;
  return out;
}
