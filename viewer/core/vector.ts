/** Vectors of three numbers. */

export type Vector = [number, number, number];

export const dot = (a: ArrayLike<number>, b: ArrayLike<number>): number =>
  a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

export const cross = (a: Vector, b: Vector): Vector => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Sum of a vector and a multiple of another. */
export const along = (a: Vector, factor: number, b: Vector): Vector => [
  a[0] + factor * b[0],
  a[1] + factor * b[1],
  a[2] + factor * b[2],
];

export const scaled = (factor: number, a: Vector): Vector => [factor * a[0], factor * a[1], factor * a[2]];

export const length = (a: Vector): number => Math.sqrt(dot(a, a));

/** The vector with length 1; zero stays zero. */
export function unit(a: Vector): Vector {
  const size = length(a);
  return size > 0 ? scaled(1 / size, a) : a;
}
