/**
 * Vision net `surface`: indirect light, as objectfolder/nets/vision_surface.py.
 *
 * The Python library evaluates the net in squares of pixels; here it is evaluated at the patches that may face
 * the camera, and interpolated at the vertices. It is smooth.
 */

import { fresnel, principled } from "./bsdf.ts";
import type { Grid } from "./grid.ts";
import { HashGrid } from "./hashgrid.ts";
import type { Appearance, Look } from "./look.ts";
import { Network } from "./network.ts";
import type { ObjectFile } from "./objectfile.ts";
import { Interpolation, Radiosity, type Solution } from "./radiosity.ts";
import type { Mesh } from "./surface.ts";
import { dot, unit, type Vector } from "./vector.ts";

const TRANSPORT = { levels: 2, features: 4, table_bits: 13, coarsest: 8, finest: 14 };
const INPUTS = 52;
const FAMILIAR = 0.1; // lower limit of the distance to a light
const NEAREST = 1e-3;
const BIAS = [-4, -5, 0.5, 0]; // more diffuse, more glossy, factors of gathered and of mirrored light
const SCALE = [0.5, 0.1, 1, 1];
const BEHIND = -0.3; // cosine to the camera from which patches are left out
const START = 0.3;
const TERMS = 6; // diffuse light for a white surface, then glossy light

/** A point light that gives a white surface at distance 1 a radiance of its colour. */
export interface PointLight {
  position: Vector;
  color: Vector;
}

/** Do part of a job, from one number up to another, without blocking for long. */
export type Slice = (count: number, work: (from: number, to: number) => void) => Promise<void>;

export class Indirect {
  private readonly network: Network;
  private readonly transport: HashGrid;
  private readonly radiosity: Radiosity;
  private readonly between: Interpolation;
  private readonly own: Appearance;
  private readonly features: Float32Array;
  private readonly reflectance: Float32Array;
  private readonly solutions = new Map<string, Solution>();

  private constructor(
    file: ObjectFile,
    private readonly look: Look,
    grid: Grid,
    mesh: Mesh,
  ) {
    this.network = new Network(file, "vision.bounced");
    this.transport = new HashGrid(file, "transport", TRANSPORT);
    this.radiosity = new Radiosity(grid, mesh);
    const { count, patches } = this.radiosity;
    this.between = new Interpolation(patches, mesh);
    this.own = { color: new Float32Array(3 * count), normal: new Float32Array(3 * count) };
    this.features = new Float32Array(this.transport.width * count);
    this.look.bake(patches, 0, count, this.own);
    const { position } = patches;
    for (let n = 0; n < count; n++)
      this.transport.lookup(
        position[3 * n],
        position[3 * n + 1],
        position[3 * n + 2],
        this.features,
        this.transport.width * n,
      );
    this.reflectance = this.own.color.map((c) => c * (1 - this.look.config.metallic));
  }

  static async make(file: ObjectFile, look: Look, grid: Grid, mesh: Mesh, slice: Slice): Promise<Indirect> {
    const made = new Indirect(file, look, grid, mesh);
    await slice(made.radiosity.count, (from, to) => made.radiosity.connect(from, to));
    await slice(made.between.count, (from, to) => made.between.connect(from, to));
    return made;
  }

  /** Return indirect radiance at the vertices, (V, 3), for a camera and lights of the unit frame. */
  async at(color: Float32Array, camera: Vector, lights: PointLight[], slice: Slice): Promise<Float32Array> {
    const out = new Float32Array(color.length);
    for (const light of lights) {
      const solution = this.solution(light.position);
      const terms = new Float32Array(TERMS * this.radiosity.count);
      await slice(this.radiosity.count, (from, to) => {
        for (let n = from; n < to; n++) this.evaluate(n, camera, light.position, solution, terms);
      });
      await slice(this.between.count, (from, to) => {
        for (let v = from; v < to; v++)
          for (let c = 0; c < 3; c++) {
            const diffuse = this.between.at(v, terms, TERMS, c);
            const glossy = this.between.at(v, terms, TERMS, 3 + c);
            out[3 * v + c] += light.color[c] * (color[3 * v + c] * diffuse + glossy);
          }
      });
    }
    return out;
  }

  private solution(light: Vector): Solution {
    const key = light.join();
    let found = this.solutions.get(key);
    if (!found) {
      found = this.radiosity.solve(light, this.reflectance);
      if (this.solutions.size > 8) this.solutions.clear();
      this.solutions.set(key, found);
    }
    return found;
  }

  /** Write what the net answers at a patch. */
  private evaluate(n: number, camera: Vector, light: Vector, solution: Solution, terms: Float32Array): void {
    const { patches } = this.radiosity;
    const three = (values: Float32Array) => [values[3 * n], values[3 * n + 1], values[3 * n + 2]] as Vector;
    const point = three(patches.position);
    const outward = three(patches.normal);
    const normal = three(this.own.normal);
    const color = three(this.own.color);
    const view = unit([point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]]);
    const facing = -dot(normal, view);
    if (facing < BEHIND) return;
    const { metallic, roughness } = this.look.config;
    const toLight = [light[0] - point[0], light[1] - point[1], light[2] - point[2]] as Vector;
    const exact = dot(toLight, toLight);
    const squared = Math.max(exact, FAMILIAR ** 2);
    const direction = unit(toLight);
    const lit = solution.lit[n];
    const reflected = lit ? principled(normal, view, direction, color, roughness, metallic) : [0, 0, 0];
    const direct = reflected.map((value) => value / Math.max(exact, NEAREST ** 2));
    const gathered = three(solution.gathered);
    const away = [0, 1, 2].map((i) => view[i] + 2 * facing * normal[i]) as Vector;
    const met = this.radiosity.hit(this.radiosity.lifted(n, START), away);
    const share = met < 0 ? [0, 0, 0] : fresnel(facing, color, metallic);
    const mirrored = share.map((value, c) => (met < 0 ? 0 : value * solution.outgoing[3 * met + c]));
    const nl = dot(normal, direction);
    const half = unit([direction[0] - view[0], direction[1] - view[1], direction[2] - view[2]]);
    const nh8 = Math.min(Math.max(dot(normal, half), 0), 1) ** 8;
    const received = Math.max(nl, 0) / squared;
    const sine = point.map((p) => Math.sin(4 * p));
    const cosine = point.map((p) => Math.cos(4 * p));
    const inputs = Float64Array.of(
      ...point,
      ...sine,
      ...cosine,
      ...sine.map((s, i) => 2 * s * cosine[i]),
      ...sine.map((s) => 1 - 2 * s * s),
      ...light,
      ...outward,
      ...normal,
      ...view,
      ...direction,
      ...away,
      nl,
      facing,
      nh8 ** (1 / 8),
      nh8,
      nh8 ** 2,
      received,
      lit,
      lit * received,
      1 / squared,
      Math.log(squared),
      ...direct.map((value) => Math.log1p(4 * value)),
      ...gathered.map((value) => Math.log1p(4 * value)),
      ...mirrored.map((value) => Math.log1p(16 * value)),
      ...this.features.subarray(n * this.transport.width, (n + 1) * this.transport.width),
    );
    if (inputs.length !== INPUTS + this.transport.width)
      throw new Error("inputs of the net of indirect light");
    const found = this.network.run(inputs);
    const term = (group: number, c: number) => softplus(found[3 * group + c] + BIAS[group]) * SCALE[group];
    for (let c = 0; c < 3; c++) {
      terms[TERMS * n + c] = gathered[c] * term(2, c) + term(0, c);
      terms[TERMS * n + 3 + c] = mirrored[c] * term(3, c) + term(1, c);
    }
  }
}

function softplus(value: number): number {
  return value > 20 ? value : Math.log1p(Math.exp(value));
}
