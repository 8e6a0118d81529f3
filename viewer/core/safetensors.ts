/** Reader of safetensors: 8 bytes with the length of a JSON header, the header, then the data. */

export interface Tensor {
  dtype: string;
  shape: number[];
  bytes: Uint8Array;
}

export interface Container {
  metadata: Record<string, string>;
  tensors: Map<string, Tensor>;
}

const SIZES: Record<string, number> = { F16: 2, F32: 4, F64: 8, I8: 1, U8: 1 };
const LONGEST_HEADER = 100e6;

export class FormatError extends Error {}

export const damaged = (how: string) =>
  new FormatError(`this Object File is damaged (${how}): download or copy it again`);

interface Entry {
  dtype: string;
  shape: number[];
  data_offsets: [number, number];
}

/** Split a file into its tensors, without copying them. */
export function parse(buffer: ArrayBuffer): Container {
  if (buffer.byteLength < 10)
    throw new FormatError(`the file has only ${buffer.byteLength} bytes: download or copy it again`);
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const start = 8 + length;
  if (length > LONGEST_HEADER || start > buffer.byteLength)
    throw new FormatError(
      "this is not a safetensors file, or only the beginning of one: download or copy it again",
    );
  let head: Record<string, unknown>;
  try {
    head = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(buffer, 8, length)));
  } catch {
    throw new FormatError("this is not a safetensors file: its header is not JSON");
  }
  const tensors = new Map<string, Tensor>();
  const { __metadata__: metadata, ...entries } = head;
  for (const [name, entry] of Object.entries(entries)) {
    const { dtype, shape, data_offsets: place } = entry as Entry;
    const [from, to] = place ?? [];
    if (!(from >= 0 && to >= from && start + to <= buffer.byteLength))
      throw damaged(`tensor ${name} ends beyond the file`);
    const count = shape.reduce((a, b) => a * b, 1);
    if (SIZES[dtype] && count * SIZES[dtype] !== to - from)
      throw damaged(`tensor ${name} has ${to - from} bytes, expected ${count * SIZES[dtype]}`);
    tensors.set(name, { dtype, shape, bytes: new Uint8Array(buffer, start + from, to - from) });
  }
  return { metadata: (metadata ?? {}) as Record<string, string>, tensors };
}

function half(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? Number.NaN : sign * Number.POSITIVE_INFINITY;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

/** Values of a tensor of floating-point numbers; copied, since its place in the file may be unaligned. */
export function floats(tensor: Tensor): Float32Array {
  const bytes = tensor.bytes.slice().buffer;
  if (tensor.dtype === "F16") return Float32Array.from(new Uint16Array(bytes), half);
  if (tensor.dtype === "F32") return new Float32Array(bytes);
  throw damaged(`a tensor has type ${tensor.dtype}, expected F16 or F32`);
}

/** Values of a tensor of double precision. */
export function doubles(tensor: Tensor): Float64Array {
  if (tensor.dtype !== "F64") throw damaged(`a tensor has type ${tensor.dtype}, expected F64`);
  return new Float64Array(tensor.bytes.slice().buffer);
}

/** Values of a tensor of signed bytes. */
export function signedBytes(tensor: Tensor): Int8Array {
  if (tensor.dtype !== "I8") throw damaged(`a tensor has type ${tensor.dtype}, expected I8`);
  return new Int8Array(tensor.bytes.slice().buffer);
}
