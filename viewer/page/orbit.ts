/** A camera that circles the object. */

import { length, scaled, type Vector } from "../core/vector.ts";
import { axes } from "./matrix.ts";

const STEEPEST = 1.54; // rad
const NEAREST = 0.9;
const FARTHEST = 6;

export class Orbit {
  /** Tangent of half the field of view: that of the queries' default camera. */
  readonly tangent = 128 / 355.5555;
  private azimuth = 0;
  private elevation = 0;
  private distance = 0;

  constructor(readonly start: Vector) {
    this.reset();
  }

  reset(): void {
    this.place(this.start);
  }

  place(eye: Vector): void {
    this.distance = length(eye);
    this.azimuth = Math.atan2(eye[1], eye[0]);
    this.elevation = Math.asin(eye[2] / this.distance);
  }

  get eye(): Vector {
    const flat = Math.cos(this.elevation);
    return scaled(this.distance, [
      Math.cos(this.azimuth) * flat,
      Math.sin(this.azimuth) * flat,
      Math.sin(this.elevation),
    ]);
  }

  turn(right: number, up: number): void {
    this.azimuth -= right;
    this.elevation = Math.min(Math.max(this.elevation + up, -STEEPEST), STEEPEST);
  }

  zoom(factor: number): void {
    this.distance = Math.min(Math.max(this.distance * factor, NEAREST), FARTHEST);
  }

  /** Tangents of half the field of view, horizontal and vertical; the shorter side has that of the queries. */
  extent(aspect: number): [number, number] {
    return aspect >= 1 ? [this.tangent * aspect, this.tangent] : [this.tangent, this.tangent / aspect];
  }

  /** Direction of the ray through a point of the picture: -1 to 1, to the right and up. */
  ray(x: number, y: number, aspect: number): Vector {
    const [right, up, back] = axes(this.eye, [0, 0, 0]);
    const [wide, high] = this.extent(aspect);
    const ray = [0, 1, 2].map((k) => right[k] * x * wide + up[k] * y * high - back[k]) as Vector;
    return scaled(1 / length(ray), ray);
  }
}
