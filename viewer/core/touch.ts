/** Touch: a sensor pressed on the surface. */

import { contactNormal, heights, type Pose, sensorFrame } from "./contact.ts";
import { type Deformed, deform } from "./gel.ts";
import type { Grid } from "./grid.ts";
import { Optics } from "./optics.ts";
import { Camera, type Profile } from "./sensor.ts";
import type { Mesh } from "./surface.ts";
import { scaled, type Vector } from "./vector.ts";

export interface Pressed extends Deformed {
  pose: Pose;
  height: Float32Array;
  obstructed: number;
  /** RGBA. */
  image: Uint8ClampedArray;
  /** m^2, where gel and object touch. */
  area: number;
  /** N, along the optical axis; null for a rigid gel. */
  force: number | null;
}

export class Touch {
  readonly camera: Camera;
  private readonly optics: Optics;
  private readonly areas: Float64Array;

  /** @param scale longest side of the object, metres */
  constructor(
    private readonly grid: Grid,
    private readonly mesh: Mesh,
    private readonly scale: number,
    readonly profile: Profile,
    private readonly depthOffset: number,
    background?: Uint8Array,
  ) {
    this.camera = new Camera(profile);
    this.optics = new Optics(this.camera, background);
    this.areas = this.camera.pixelAreas();
  }

  /** Press the sensor at a point of the unit frame, to a depth in metres, turned by an angle in radians. */
  press(point: Vector, depth: number, angle: number): Pressed {
    const normal = contactNormal(this.grid, point);
    const pose = {
      point: scaled(this.scale, point),
      normal,
      frame: sensorFrame(normal, angle),
      depth: Math.min(Math.max(depth + this.depthOffset, 0), this.profile.max_indentation),
    };
    const { height, obstructed } = heights(this.mesh, this.grid, this.camera, pose, this.scale);
    const { displacement, pressure } = deform(height, this.camera);
    const image = this.optics.render(displacement);
    const touching = pressure ?? height;
    let [area, force] = [0, 0];
    for (let n = 0; n < height.length; n++) {
      if (touching[n] > 0) area += this.areas[n];
      if (pressure) force += pressure[n] * this.areas[n];
    }
    return { pose, height, obstructed, displacement, pressure, image, area, force: pressure && force };
  }
}
