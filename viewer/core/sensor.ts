/** A tactile sensor's profile, and its camera in front of the undeformed gel. */

export interface Profile {
  name: string;
  height: number;
  width: number;
  vertical_fov_deg: number;
  camera_to_gel: number;
  gel_curvature: number;
  gel_dome_radius: number;
  gel: "rigid" | "soft";
  elastomer_thickness: number;
  young_modulus: number;
  poisson_ratio: number;
  max_indentation: number;
  lights: { position: number[]; color: number[]; intensity: number }[];
  ambient: number;
  albedo: number;
  metallic: number;
  roughness: number;
  gamma: number;
  gain: number;
  slope_smoothing: number;
  image_smoothing: number;
  background_color: number[];
  background_glow: number;
  background_falloff: number;
  /** Coefficients of a fitted light model by colour; see core/residual.ts. */
  residual?: number[][];
  /** Picture of the untouched sensor, of sensors in the page's settings; see core/background.ts. */
  background?: string;
}

/** Slopes of the pixels' rays, and how deep the undeformed gel lies along them. */
export class Camera {
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly gel: Float64Array;
  /** Metres of gel per pixel, at its apex. */
  readonly pitch: number;
  /** Half extents of the image plane at distance 1: vertical, horizontal. */
  readonly half: [number, number];

  constructor(readonly profile: Profile) {
    const { height, width } = profile;
    const vertical = Math.tan((profile.vertical_fov_deg * Math.PI) / 360);
    const horizontal = (vertical * width) / height;
    this.half = [vertical, horizontal];
    this.pitch = (2 * vertical * profile.camera_to_gel) / height;
    this.y = new Float64Array(height * width);
    this.z = new Float64Array(height * width);
    this.gel = new Float64Array(height * width);
    for (let row = 0, n = 0; row < height; row++)
      for (let column = 0; column < width; column++, n++) {
        this.z[n] = (1 - ((row + 0.5) * 2) / height) * vertical;
        this.y[n] = (1 - ((column + 0.5) * 2) / width) * horizontal;
        this.gel[n] = gelDepth(profile, this.y[n], this.z[n]);
      }
  }

  /** Derivative of an image over the rows or the columns, per unit of the ray's slope. */
  gradient(image: Float64Array, overRows: boolean): Float64Array {
    const { width, height } = this.profile;
    const [step, count] = overRows ? [width, height] : [1, width];
    const pitch = overRows ? this.z[0] - this.z[width] : this.y[0] - this.y[1];
    return Float64Array.from(image, (_, n) => {
      const place = Math.floor(n / step) % count;
      const before = place > 0 ? n - step : n;
      const after = place < count - 1 ? n + step : n;
      return (image[after] - image[before]) / (((after - before) / step) * -pitch);
    });
  }

  /** Area of undeformed gel that each pixel sees, projected along the optical axis, m^2. */
  pixelAreas(): Float64Array {
    const [sideways, upwards] = [this.y, this.z].map((slope) => slope.map((s, n) => s * this.gel[n]));
    const [yRow, yColumn] = [this.gradient(sideways, true), this.gradient(sideways, false)];
    const [zRow, zColumn] = [this.gradient(upwards, true), this.gradient(upwards, false)];
    const pixel = (this.y[0] - this.y[1]) * (this.z[0] - this.z[this.profile.width]);
    return yRow.map((value, n) => Math.abs(value * zColumn[n] - yColumn[n] * zRow[n]) * pixel);
  }
}

/** Depth of the gel, the cap of a spheroid, along a ray; see objectfolder/touch/camera.py. */
function gelDepth(profile: Profile, y: number, z: number): number {
  const { camera_to_gel: apex, gel_dome_radius: radius } = profile;
  const slope = y * y + z * z;
  const stretch = profile.gel_curvature * radius;
  const root = Math.sqrt(radius * radius + (2 * radius * stretch - apex) * apex * slope);
  return apex - (stretch * slope * apex ** 2) / (radius + stretch * slope * apex + root);
}
