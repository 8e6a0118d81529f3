import { describe, expect, it } from "vitest";
import { Fft, fastLength } from "../core/fft.ts";
import { deform } from "../core/gel.ts";
import { Camera, type Profile } from "../core/sensor.ts";
import { surface } from "../core/surface.ts";
import { Touch } from "../core/touch.ts";
import { ball, RADIUS } from "./shapes.ts";

const PROFILE: Profile = {
  name: "flat",
  height: 96,
  width: 80,
  vertical_fov_deg: 60,
  camera_to_gel: 0.022,
  gel_curvature: 0,
  gel_dome_radius: 1,
  gel: "rigid",
  elastomer_thickness: 0.004,
  young_modulus: 1e5,
  poisson_ratio: 0.48,
  max_indentation: 0.002,
  lights: [{ position: [0.01, 0, 0.02], color: [1, 1, 1], intensity: 1e-4 }],
  ambient: 0.1,
  albedo: 0.5,
  metallic: 0,
  roughness: 0.5,
  gamma: 2.2,
  gain: 1,
  slope_smoothing: 0,
  image_smoothing: 0,
  background_color: [0.3, 0.3, 0.3],
  background_glow: 0.1,
  background_falloff: 0.005,
};
const SCALE = 0.05; // metres; the ball's radius is 2 cm

describe("Fourier transforms", () => {
  it("are the sums that define them, and their inverses undo them", () => {
    for (const length of [1, 2, 8, 30, 225]) {
      const re = Float64Array.from({ length }, (_, n) => Math.sin(n * n));
      const im = Float64Array.from({ length }, (_, n) => Math.cos(3 * n));
      const [a, b] = [re.slice(), im.slice()];
      const fft = new Fft(length);
      fft.run(a, b);
      for (const k of [0, 1, length - 1].filter((n) => n >= 0 && n < length)) {
        let sum = 0;
        re.forEach((value, n) => {
          const angle = (2 * Math.PI * k * n) / length;
          sum += value * Math.cos(angle) + im[n] * Math.sin(angle);
        });
        expect(a[k]).toBeCloseTo(sum, 9);
      }
      fft.run(b, a);
      a.forEach((value, n) => {
        expect(value / length).toBeCloseTo(re[n], 9);
      });
    }
  });

  it("have fast lengths with factors of at most 5", () => {
    expect([1, 7, 11, 97, 211].map(fastLength)).toEqual([1, 8, 12, 100, 216]);
  });
});

describe("a ball in the gel", () => {
  const grid = ball(160);
  const mesh = surface(grid);
  const press = (profile: Profile, depth: number) =>
    new Touch(grid, mesh, SCALE, profile, 0).press([RADIUS, 0, 0], depth, 0);

  it("leaves its imprint", () => {
    const depth = 1e-3;
    const { height, area, pose } = press(PROFILE, depth);
    expect(pose.normal[0]).toBeCloseTo(1, 4);
    const most = height.reduce((a, b) => Math.max(a, b));
    expect(Math.abs(most - depth)).toBeLessThan(2e-5);
    const radius = SCALE * RADIUS;
    expect(area / (Math.PI * (2 * radius * depth - depth ** 2))).toBeCloseTo(1, 1);
  });

  it("presses on a soft gel where they touch, and nowhere else", () => {
    const soft: Profile = { ...PROFILE, gel: "soft" };
    const { height, displacement, pressure, force } = press(soft, 1e-3);
    const overlap = height.map((h, n) => h - displacement[n]);
    expect(overlap.reduce((a, b) => Math.max(a, b))).toBeLessThan(1e-9);
    pressure!.forEach((p, n) => {
      expect(p).toBeGreaterThanOrEqual(0);
      if (p > 0) expect(Math.abs(overlap[n])).toBeLessThan(1e-9);
    });
    expect(force).toBeGreaterThan(0);
    expect(press({ ...soft, young_modulus: 2e5 }, 1e-3).force! / force!).toBeCloseTo(2, 2);
  });

  it("does nothing to a gel that it does not reach", () => {
    const camera = new Camera({ ...PROFILE, gel: "soft" });
    const far = new Float32Array(96 * 80).fill(-1e-3);
    const { displacement, pressure } = deform(far, camera);
    expect([...displacement, ...pressure!].every((value) => value === 0)).toBe(true);
  });
});
