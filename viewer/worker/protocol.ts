/** Messages between the page and its worker. */

import type { PointLight } from "../core/indirect.ts";
import type { Material } from "../core/materials.ts";
import type { Gaps, Header } from "../core/objectfile.ts";
import type { Profile } from "../core/sensor.ts";
import type { Mesh } from "../core/surface.ts";
import type { Response } from "../core/synthesis.ts";
import type { Vector } from "../core/vector.ts";

/** Where to strike or touch, unit frame: on a ray, or at a point that is projected to the surface. */
export type Place = { origin: Vector; direction: Vector } | { point: Vector };

export interface StrikeSettings {
  /** N s along the inward normal, or a vector of the object frame. */
  impulse: number | Vector;
  contact: number; // s
  material: Material | null; // null: the object's own
  size: number; // of the object's own
  rate: number; // Hz
  duration: number; // s
  response: Response; // of a sound without a listener
  silence: number;
  /** Where the strike is heard, in units of the longest side; null: nowhere, displacements are summed. */
  listener: Vector | null;
  /** Where the loudest spot is heard, which the volume refers to, as a listener. */
  reference: Vector | null;
}

export interface TouchSettings {
  profile: Profile | null; // null: the stored sensor
  gel: "stored" | "rigid";
  depth: number; // m
  angle: number; // rad
}

export type Request =
  | { kind: "open"; buffer: ArrayBuffer; request: number }
  | { kind: "poke"; place: Place; strike: StrikeSettings | null; touch: TouchSettings | null }
  | { kind: "ping" } // answered when all questions before it are
  | { kind: "light"; camera: Vector; lights: PointLight[]; request: number };

export interface Tone {
  frequency: number; // Hz
  level: number; // dB, of the loudest
  decay: number; // s, time to fall by 60 dB
}

export type Reply =
  | { kind: "problem"; message: string; request?: number } // numbered if a file cannot be opened
  | { kind: "shape"; header: Header; gaps: Gaps; mesh: Mesh; bytes: number; request: number }
  | { kind: "look"; color: Float32Array; normal: Float32Array; roughness: number; metallic: number }
  | { kind: "bounces" } // indirect light can be asked for
  | { kind: "indirect"; values: Float32Array; request: number }
  | { kind: "point"; point: Vector }
  | { kind: "missed" }
  | { kind: "done" }
  | {
      kind: "sound";
      samples: Float32Array;
      rate: number;
      /** Peak of the loudest spot at the same settings, heard from the reference, and an impulse of 1 N s. */
      reference: number;
      tones: Tone[];
      modes: number;
      notes: string[];
      milliseconds: number;
    }
  | {
      kind: "touch";
      image: Uint8ClampedArray;
      height: Float32Array;
      width: number;
      rows: number;
      deepest: number; // m, the scale of heights
      force: number | null;
      area: number;
      obstructed: number;
      milliseconds: number;
    };
