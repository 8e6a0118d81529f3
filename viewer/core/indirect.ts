/**
 * Vision net `surface`: indirect light, as objectfolder/vision/surface_net.py.
 *
 * What vertices gather and mirror is found as in the Python library. The corrections of the net, which are
 * smooth, are evaluated at the patches that may face the camera; the library does so in squares of pixels.
 */

import { fresnel, principled } from "./bsdf.ts";
import type { Grid } from "./grid.ts";
import { HashGrid } from "./hashgrid.ts";
import type { Appearance, Look } from "./look.ts";
import { Network } from "./network.ts";
import type { ObjectFile } from "./objectfile.ts";
import { Interpolation, Radiosity, type Solution } from "./radiosity.ts";
import type { Mesh } from "./surface.ts";
import { along, dot, unit, type Vector } from "./vector.ts";

const TRANSPORT = { levels: 2, features: 4, table_bits: 13, coarsest: 8, finest: 14 };
const INPUTS = 52;
const FAMILIAR = 0.1; // lower limit of the distance to a light
const NEAREST = 1e-3;
const BIAS = [-4, -5, 0.5, 0]; // more diffuse, more glossy, factors of gathered and of mirrored light
const SCALE = [0.5, 0.1, 1, 1];
const BEHIND = -0.3; // cosine to the camera from which patches are left out
const TERMS = 12; // of a patch, as `BIAS` by colour

/** A point light that gives a white surface at distance 1 a radiance of its colour. */
export interface PointLight {
  position: Vector;
  color: Vector;
}

/** Do part of a job, from one number up to another, without blocking for long. */
export type Slice = (count: number, work: (from: number, to: number) => void) => Promise<void>;

/** What a mirror at points shows to a camera. */
interface Mirror {
  between: Interpolation;
  /** Fresnel reflectance by colour; 0 where nothing is met. */
  share: Float32Array;
  /** Whether points may face the camera. */
  front: Uint8Array;
}

type Points = Pick<Mesh, "position" | "normal">;

export class Indirect {
  private readonly network: Network;
  private readonly transport: HashGrid;
  private readonly radiosity: Radiosity;
  private readonly between: Interpolation;
  private readonly own: Appearance;
  private readonly features: Float32Array;
  private readonly reflectance: Float32Array;
  private readonly solutions = new Map<string, Solution>();
  private sees: Uint8Array = new Uint8Array(0);
  private mirrors: { camera: string; vertices: Mirror; patches: Mirror } | null = null;

  private constructor(
    file: ObjectFile,
    private readonly look: Look,
    grid: Grid,
    private readonly mesh: Mesh,
    /** Of the vertices. */
    private readonly baked: Appearance,
  ) {
    this.network = new Network(file, "vision.bounced");
    this.transport = new HashGrid(file, "transport", TRANSPORT);
    this.radiosity = new Radiosity(grid, mesh);
    const { count, patches } = this.radiosity;
    this.between = new Interpolation(patches, mesh.position.length / 3);
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

  static async make(
    file: ObjectFile,
    look: Look,
    grid: Grid,
    mesh: Mesh,
    baked: Appearance,
    slice: Slice,
  ): Promise<Indirect> {
    const made = new Indirect(file, look, grid, mesh, baked);
    await slice(made.radiosity.count, (from, to) => made.radiosity.connect(from, to));
    await slice(made.between.count, (from, to) => {
      for (let v = from; v < to; v++) made.between.connect(v, mesh.position, mesh.normal, 3 * v);
    });
    made.sees = made.radiosity.sees();
    return made;
  }

  /** Return indirect radiance at the vertices, (V, 3), for a camera and lights of the unit frame. */
  async at(camera: Vector, lights: PointLight[], slice: Slice): Promise<Float32Array> {
    const { between, baked } = this;
    const { vertices, patches } = await this.mirrorsFor(camera, slice);
    const out = new Float32Array(3 * between.count);
    for (const light of lights) {
      const solution = this.solution(light.position);
      const terms = new Float32Array(TERMS * this.radiosity.count);
      await slice(this.radiosity.count, (from, to) => {
        for (let n = from; n < to; n++)
          if (patches.front[n]) this.evaluate(n, camera, light.position, solution, patches, terms);
      });
      await slice(between.count, (from, to) => {
        for (let v = from; v < to; v++) {
          if (!vertices.front[v]) continue;
          for (let c = 0; c < 3; c++) {
            const k = 3 * v + c;
            const gathered = between.at(v, solution.gathered, 3, c);
            const diffuse = gathered * between.at(v, terms, TERMS, 6 + c) + between.at(v, terms, TERMS, c);
            let glossy = between.at(v, terms, TERMS, 3 + c);
            if (vertices.share[k])
              glossy += mirrored(vertices, v, solution, c) * between.at(v, terms, TERMS, 9 + c);
            out[k] += light.color[c] * (baked.color[k] * diffuse + glossy);
          }
        }
      });
    }
    return out;
  }

  /** Return what mirrors at the vertices and at the patches show to a camera. */
  private async mirrorsFor(camera: Vector, slice: Slice): Promise<{ vertices: Mirror; patches: Mirror }> {
    const key = camera.join();
    if (this.mirrors?.camera === key) return this.mirrors;
    const { patches } = this.radiosity;
    const sees = (v: number) => this.between.any(v, this.sees);
    const vertices = await this.mirror(this.mesh, this.baked, camera, sees, slice);
    const own = await this.mirror(patches, this.own, camera, (n) => this.sees[n] > 0, slice);
    this.mirrors = { camera: key, vertices, patches: own };
    return this.mirrors;
  }

  /** Cast the rays that a camera sees mirrored at points; none from where nothing is seen. */
  private async mirror(
    { position, normal }: Points,
    look: Appearance,
    camera: Vector,
    sees: (n: number) => boolean,
    slice: Slice,
  ): Promise<Mirror> {
    const count = position.length / 3;
    const { metallic } = this.look.config;
    const between = new Interpolation(this.radiosity.patches, count);
    const made = { between, share: new Float32Array(3 * count), front: new Uint8Array(count) };
    await slice(count, (from, to) => {
      for (let n = from; n < to; n++) {
        const point = three(position, n);
        const bent = three(look.normal, n);
        const view = unit(along(point, -1, camera));
        const facing = -dot(bent, view);
        if (facing < BEHIND) continue;
        made.front[n] = 1;
        if (!sees(n)) continue;
        const away = along(view, 2 * facing, bent);
        if (this.radiosity.reflect(n, between, point, three(normal, n), away))
          made.share.set(fresnel(facing, three(look.color, n), metallic), 3 * n);
      }
    });
    return made;
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
  private evaluate(
    n: number,
    camera: Vector,
    light: Vector,
    solution: Solution,
    mirror: Mirror,
    terms: Float32Array,
  ): void {
    const { patches } = this.radiosity;
    const point = three(patches.position, n);
    const outward = three(patches.normal, n);
    const normal = three(this.own.normal, n);
    const color = three(this.own.color, n);
    const view = unit(along(point, -1, camera));
    const facing = -dot(normal, view);
    const { metallic, roughness } = this.look.config;
    const toLight = along(light, -1, point);
    const exact = dot(toLight, toLight);
    const squared = Math.max(exact, FAMILIAR ** 2);
    const direction = unit(toLight);
    const lit = solution.lit[n];
    const reflected = lit ? principled(normal, view, direction, color, roughness, metallic) : [0, 0, 0];
    const direct = reflected.map((value) => value / Math.max(exact, NEAREST ** 2));
    const gathered = three(solution.gathered, n);
    const away = along(view, 2 * facing, normal);
    const shown = [0, 1, 2].map((c) => mirrored(mirror, n, solution, c));
    const nl = dot(normal, direction);
    const half = unit(along(direction, -1, view));
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
      ...shown.map((value) => Math.log1p(16 * value)),
      ...this.features.subarray(n * this.transport.width, (n + 1) * this.transport.width),
    );
    if (inputs.length !== INPUTS + this.transport.width)
      throw new Error("inputs of the net of indirect light");
    const found = this.network.run(inputs);
    for (let k = 0; k < TERMS; k++) {
      const group = Math.floor(k / 3);
      terms[TERMS * n + k] = softplus(found[k] + BIAS[group]) * SCALE[group];
    }
  }
}

const three = (values: Float32Array, n: number): Vector => [
  values[3 * n],
  values[3 * n + 1],
  values[3 * n + 2],
];

/** Return the light of one colour that the mirror at a point shows. */
function mirrored({ between, share }: Mirror, n: number, { outgoing }: Solution, color: number): number {
  const part = share[3 * n + color];
  return part ? part * between.at(n, outgoing, 3, color) : 0;
}

function softplus(value: number): number {
  return value > 20 ? value : Math.log1p(Math.exp(value));
}
