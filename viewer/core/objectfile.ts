/** The Object File: its header, and what this page can answer from it. docs/objectfile.md has the format. */

import type { Material } from "./materials.ts";
import type { RadiationConfig } from "./radiation.ts";
import { type Container, damaged, FormatError, parse, type Tensor } from "./safetensors.ts";
import type { Profile } from "./sensor.ts";

export const MAJOR = 1;
const FINEST = 512; // points along a side of the grid

export interface GridConfig {
  kind: string;
  resolution: number;
  band: number;
  predictor: "none" | "planes";
  edges?: number;
  cells?: number;
  sheets?: number;
  moved?: number;
}

export interface VisionConfig {
  levels: number;
  features: number;
  table_bits: number;
  coarsest: number;
  finest: number;
  width: number;
  roughness: number;
  metallic: number;
}

export interface AudioConfig {
  resolution: number;
  channels: number;
  frequency: number;
}

export interface TouchConfig {
  sensor: Profile;
  depth_offset: number;
  renderer: "gel" | "tacto";
}

export interface Header {
  format: string;
  key: string;
  material: string;
  scale: number;
  material_properties?: Omit<Material, "name">;
  geometry?: GridConfig;
  vision?: { kind: string; net: VisionConfig };
  audio?: {
    kind: string;
    net: AudioConfig;
    band_hz?: [number, number];
    frequency_uncertainty?: number;
    uncertain?: boolean;
  };
  touch?: { kind: string; net: TouchConfig };
  radiation?: RadiationConfig;
  solid?: { volume: number };
}

/** Why a question cannot be answered; null if it can. */
export interface Gaps {
  shape: string | null;
  look: string | null;
  sound: string | null;
  touch: string | null;
}

export class ObjectFile {
  readonly header: Header;
  private readonly tensors: Map<string, Tensor>;

  constructor(buffer: ArrayBuffer) {
    const container: Container = parse(buffer);
    this.tensors = container.tensors;
    this.header = checked(container.metadata.objectfolder);
  }

  has(name: string): boolean {
    return this.tensors.has(name);
  }

  tensor(name: string): Tensor {
    const found = this.tensors.get(name);
    if (!found) throw damaged(`it lacks the tensor ${name}`);
    return found;
  }
}

function checked(text: string | undefined): Header {
  if (text === undefined)
    throw new FormatError(
      "this safetensors file is not an Object File: its metadata has no entry objectfolder",
    );
  let header: Header | null;
  try {
    header = JSON.parse(text);
  } catch {
    throw damaged("its header is not JSON");
  }
  if (typeof header !== "object" || !header) throw damaged("its header is empty");
  const major = Number(String(header.format ?? "").split(".")[0]);
  if (!header.format)
    throw new FormatError("this Object File is older than format 1.0: rebuild it with objectfolder build");
  if (major !== MAJOR)
    throw new FormatError(`this Object File has format ${header.format}; this page reads ${MAJOR}.x`);
  if (!(header.scale > 0)) throw damaged(`its size is ${header.scale} m`);
  for (const name of ["key", "material"] as const)
    if (typeof header[name] !== "string") throw damaged(`its header lacks ${name}`);
  const { geometry } = header;
  if (geometry?.kind === "distance_grid" && !(geometry.resolution >= 2 && geometry.resolution <= FINEST))
    throw damaged(`gives the grid ${geometry.resolution} points a side, not 2 to ${FINEST}`);
  for (const name of ["vision", "audio", "touch"] as const)
    if (header[name] && typeof header[name].net !== "object") throw damaged(`lacks ${name}.net`);
  return header;
}

/** Say what the page cannot answer from a file, and why. */
export function gaps(header: Header): Gaps {
  const { geometry, vision, audio, touch } = header;
  const ask = "ask the Python library (docs/queries.md)";
  let shape: string | null = null;
  if (!geometry)
    shape =
      "This file stores no geometry. Its nets answer in the Python library, but there is no surface to click.";
  else if (geometry.kind !== "distance_grid")
    shape = `Its geometry is of kind “${geometry.kind}”, which this page does not know.`;
  const look = !vision
    ? "The file does not say how the object looks: it is shown in grey."
    : vision.kind === "surface"
      ? null
      : `Its vision net is of kind “${vision.kind}”, which takes seconds per picture: the shape is shown in grey; ${ask} for views.`;
  const sound = !audio
    ? "The file does not say how the object sounds."
    : audio.kind === "gains"
      ? null
      : `Its audio net is of kind “${audio.kind}”, which stores spectrograms instead of modes: ${ask} for sounds.`;
  let felt: string | null = null;
  if (!touch) felt = "The file does not say how the object feels.";
  else if (touch.kind !== "geometric")
    felt = `Its touch net is of kind “${touch.kind}”, which stores the images of one press: ${ask} for them.`;
  return { shape, look, sound, touch: felt };
}
