/** An open Object File and its answers; everything that takes longer than a frame is sliced. */

import { unpackBackground } from "../core/background.ts";
import { readFeatures } from "../core/features.ts";
import { Gains } from "../core/gains.ts";
import { Grid } from "../core/grid.ts";
import { Indirect, type PointLight, type Slice } from "../core/indirect.ts";
import { type Appearance, Look } from "../core/look.ts";
import { Nearest } from "../core/nearest.ts";
import { type Gaps, gaps, ObjectFile } from "../core/objectfile.ts";
import { Radiation } from "../core/radiation.ts";
import { FormatError } from "../core/safetensors.ts";
import type { Profile } from "../core/sensor.ts";
import { type Mesh, surface } from "../core/surface.ts";
import { amplitudes, type Gained, modalGains, plain, synthesise } from "../core/synthesis.ts";
import { Touch } from "../core/touch.ts";
import { type Modes, ownMaterial, tuned } from "../core/tuning.ts";
import { along, length, scaled, type Vector } from "../core/vector.ts";
import type { Place, Reply, StrikeSettings, Tone, TouchSettings } from "./protocol.ts";

const SPOTS = 48; // vertices among which the loudest is sought
const PEAK = 0.1; // seconds within which a sound has its peak
const QUIETEST = -60; // dB of tones that are shown
const SHOWN = 120; // tones
const ELSEWHERE =
  "Accelerations, not sound pressure: in this material the sound has other wavelengths, whose radiation is not stored.";
const UNMOVED = 1.0; // voxels; contacts nearer to the surface stay where they are, as in the library

export class Answers {
  readonly file: ObjectFile;
  readonly gaps: Gaps;
  readonly grid: Grid;
  readonly mesh: Mesh;
  private readonly nearest: Nearest;
  private readonly gains: Gains | null;
  private readonly radiation: Radiation | null;
  private look: Look | null = null;
  private baked: Appearance | null = null;
  private indirect: Indirect | null = null;
  private touch: { key: string; press: Touch } | null = null;
  private reference: { key: string; peak: number } | null = null;

  constructor(buffer: ArrayBuffer) {
    this.file = new ObjectFile(buffer);
    const found = gaps(this.file.header);
    if (found.shape) throw new FormatError(found.shape);
    this.grid = Grid.read(this.file);
    const features = readFeatures(this.file);
    this.mesh = surface(this.grid, features);
    this.nearest = new Nearest(this.grid, this.mesh, features);
    if (!this.mesh.index.length) throw new FormatError("The geometry of this file holds no surface.");
    this.gains = found.sound === null ? new Gains(this.file) : null;
    this.radiation = this.gains && Radiation.read(this.file, this.gains.frequency);
    if (this.gains?.count === 0 && !this.radiation)
      found.sound = "The object has no modes between 20 Hz and 20 kHz: it is silent.";
    this.gaps = found;
  }

  /** Return the point that is meant, on the surface, and where a sensor touches it. */
  at(place: Place): { point: Vector; contact: Vector } | null {
    const far = "point" in place ? 0 : this.grid.cast(place.origin, place.direction);
    if (!Number.isFinite(far)) return null;
    const given = "point" in place ? place.point : along(place.origin, far, place.direction);
    const point = this.nearest.to(given);
    const moved = length(along(point, -1, given));
    return { point, contact: moved < UNMOVED * this.grid.spacing ? given : point };
  }

  private normalAt(point: Vector): Vector {
    const normal: Vector = [0, 0, 0];
    this.grid.normal(point[0], point[1], point[2], normal);
    return normal;
  }

  /** Evaluate the base colours and shading normals of the vertices. */
  async appearance(slice: Slice): Promise<Reply | null> {
    if (this.gaps.look) return null;
    const look = new Look(this.file);
    const size = this.mesh.position.length;
    const found = { color: new Float32Array(size), normal: new Float32Array(size) };
    await slice(size / 3, (from, to) => look.bake(this.mesh, from, to, found));
    this.look = look;
    this.baked = { color: found.color.slice(), normal: found.normal.slice() };
    return { kind: "look", ...found, roughness: look.config.roughness, metallic: look.config.metallic };
  }

  /** Prepare indirect light. */
  async prepareBounces(slice: Slice): Promise<boolean> {
    if (!this.look || !this.baked) return false;
    this.indirect = await Indirect.make(this.file, this.look, this.grid, this.mesh, this.baked, slice);
    return true;
  }

  async bounces(camera: Vector, lights: PointLight[], slice: Slice): Promise<Float32Array | null> {
    return this.indirect ? this.indirect.at(camera, lights, slice) : null;
  }

  strike(point: Vector, settings: StrikeSettings): Extract<Reply, { kind: "sound" }> | null {
    const { gains } = this;
    if (!gains || this.gaps.sound) return null;
    const start = performance.now();
    const modes = tuned(gains, this.file.header, settings.material, settings.size);
    const impulse =
      typeof settings.impulse === "number"
        ? scaled(-settings.impulse, this.normalAt(point))
        : settings.impulse;
    const { sound, strike, note } = this.heard(modes, point, impulse, settings);
    const samples = synthesise(sound, strike);
    const reference = this.loudest(modes, settings);
    const milliseconds = performance.now() - start;
    return {
      kind: "sound",
      samples,
      rate: settings.rate,
      reference,
      tones: tones(modes, amplitudes(sound, strike).subarray(0, modes.which.length)),
      modes: modes.which.length,
      notes: note ? [...modes.notes, note] : modes.notes,
      milliseconds,
    };
  }

  /** What is heard of an impulse, N s: sound pressure at the listener, or else the response that is asked for. */
  private heard(
    modes: Modes,
    point: Vector,
    impulse: ArrayLike<number>,
    settings: StrikeSettings,
  ): { sound: Gained; strike: StrikeSettings; note: string | null } {
    const { listener, size } = settings;
    const gains = modalGains(modes, this.gains!.shapes(point), impulse);
    const own = { sound: plain(modes, gains), strike: settings, note: null };
    const material = settings.material ?? ownMaterial(this.file.header);
    if (!listener || !this.radiation || !material) return own;
    if (!this.radiation.holds(modes, size)) return { ...own, note: ELSEWHERE };
    const sound = this.radiation.heard(modes, gains, listener, impulse, size, material.density);
    return { sound, strike: { ...settings, response: "displacement" }, note: null };
  }

  /** Peak of the loudest of some spots, heard from the reference, for an impulse of 1 N s along the normal. */
  private loudest(modes: Modes, settings: StrikeSettings): number {
    const { material, size, contact, rate, response, reference: listener } = settings;
    const key = JSON.stringify([material, size, contact, rate, response, listener]);
    if (this.reference?.key === key) return this.reference.peak;
    const { position } = this.mesh;
    let best = [...position.subarray(0, 3)] as Vector; // without modes, only the recoil is heard, as anywhere
    let most = 0;
    for (let n = 0; n < SPOTS; n++) {
      const vertex = Math.floor(((n + 0.5) / SPOTS) * (position.length / 3));
      const point = [...position.subarray(3 * vertex, 3 * vertex + 3)] as Vector;
      const mixed = modalGains(modes, this.gains!.shapes(point), this.normalAt(point));
      const energy = mixed.reduce((sum, gain) => sum + gain * gain, 0);
      if (energy > most) [best, most] = [point, energy];
    }
    let peak = 0;
    const { sound, strike } = this.heard(modes, best, this.normalAt(best), { ...settings, listener });
    for (const value of synthesise(sound, { ...strike, duration: PEAK, silence: 1e-3 }))
      peak = Math.max(peak, Math.abs(value));
    this.reference = { key, peak };
    return peak;
  }

  private storedBackground(): Uint8Array | undefined {
    return this.file.has("touch.background") ? this.file.tensor("touch.background").bytes : undefined;
  }

  press(point: Vector, settings: TouchSettings): Extract<Reply, { kind: "touch" }> | null {
    if (this.gaps.touch) return null;
    const { net } = this.file.header.touch!;
    const own = settings.profile === null;
    const profile: Profile = { ...(settings.profile ?? net.sensor) };
    if (settings.gel === "rigid") profile.gel = "rigid";
    const key = JSON.stringify(profile);
    if (this.touch?.key !== key) {
      const { scale } = this.file.header;
      const background = own ? this.storedBackground() : packedBackground(profile);
      this.touch = {
        key,
        press: new Touch(this.grid, this.mesh, scale, profile, net.depth_offset, background),
      };
    }
    const start = performance.now();
    const { image, height, force, area, obstructed } = this.touch.press.press(
      point,
      settings.depth,
      settings.angle,
    );
    return {
      kind: "touch",
      image,
      height,
      width: profile.width,
      rows: profile.height,
      deepest: profile.max_indentation,
      force,
      area,
      obstructed,
      milliseconds: performance.now() - start,
    };
  }
}

function packedBackground({ background, height, width }: Profile): Uint8Array | undefined {
  return background ? unpackBackground(background, height, width) : undefined;
}

/** The loudest modes of a sound, by their energy in it. */
function tones(modes: Modes, amplitude: Float64Array): Tone[] {
  const loudness = amplitude.map((value, n) => value / Math.sqrt(modes.damping[n]));
  const most = loudness.reduce((a, b) => Math.max(a, b), 1e-300);
  const found: Tone[] = [];
  loudness.forEach((value, n) => {
    const level = 20 * Math.log10(value / most);
    if (level < QUIETEST) return;
    const frequency = modes.frequency[n] / (2 * Math.PI);
    found.push({ frequency, level, decay: Math.log(1000) / modes.damping[n] });
  });
  return found.sort((a, b) => b.level - a.level).slice(0, SHOWN);
}
