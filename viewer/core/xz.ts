/** Decoder of xz streams with LZMA2 and no other filter. Browsers have none. Checksums are not compared. */

import { damaged } from "./safetensors.ts";

const TOP = 1 << 24;
const CHECK_BYTES = [0, 4, 4, 4, 8, 8, 8, 16, 16, 16, 32, 32, 32, 64, 64, 64];

/** Unpack a stream that holds a known number of bytes. */
export function unxz(source: Uint8Array, size: number): Uint8Array {
  if (source[0] !== 0xfd || source[1] !== 0x37 || source[2] !== 0x7a)
    throw damaged("a compressed tensor is not an xz stream");
  const check = CHECK_BYTES[source[7] & 15];
  const out = new Uint8Array(size);
  const decoder = new Lzma2(source, out);
  let place = 12;
  let at = 0;
  while (source[place] !== 0) {
    if (place >= source.length) throw damaged("an xz stream ends early");
    const end = place + (source[place] + 1) * 4;
    let p = place + 1;
    const flags = source[p++];
    const number = () => {
      let value = 0;
      let factor = 1;
      for (let byte = 128; byte & 128; factor *= 128) {
        byte = source[p++];
        value += (byte & 127) * factor;
      }
      return value;
    };
    if (flags & 0x40) number();
    if (flags & 0x80) number();
    if ((flags & 3) !== 0 || number() !== 0x21) throw damaged("an xz stream is not packed by LZMA2 alone");
    [place, at] = decoder.block(end, at);
    while (place & 3) place++;
    place += check;
  }
  if (at !== size) throw damaged(`an xz stream holds ${at} bytes, expected ${size}`);
  return out;
}

// First entries of the groups of probabilities.
const IS_REPEAT = 192;
const REPEAT_0 = 204;
const REPEAT_1 = 216;
const REPEAT_2 = 228;
const SHORT_REPEAT = 240;
const SLOTS = 432;
const SPECIAL = 688;
const ALIGN = 803;
const LENGTH = 819;
const REPEAT_LENGTH = 1333;
const LITERALS = 1847;

class Lzma2 {
  private odds = new Uint16Array(0);
  private literalContext = 3;
  private literalPosition = 0;
  private positionBits = 2;
  private readonly coder = new Uint32Array(2); // range, code
  private place = 0;
  private state = 0;
  private readonly repeats = new Uint32Array(4);

  constructor(
    private readonly source: Uint8Array,
    private readonly out: Uint8Array,
  ) {}

  /** Unpack one block; return where its successor starts, in the stream and in the output. */
  block(from: number, to: number): [number, number] {
    const { source, out } = this;
    let place = from;
    let at = to;
    for (;;) {
      if (place >= source.length) throw damaged("an xz stream ends early");
      const control = source[place++];
      if (control === 0) return [place, at];
      if (control < 0x80) {
        const count = (source[place] << 8) + source[place + 1] + 1;
        if (at + count > out.length) throw damaged("an xz stream is too long");
        out.set(source.subarray(place + 2, place + 2 + count), at);
        place += 2 + count;
        at += count;
        continue;
      }
      const size = ((control & 31) << 16) + (source[place] << 8) + source[place + 1] + 1;
      const packed = (source[place + 2] << 8) + source[place + 3] + 1;
      place += 4;
      const reset = (control >> 5) & 3;
      if (reset >= 2) {
        const properties = source[place++];
        this.literalContext = properties % 9;
        this.literalPosition = Math.floor(properties / 9) % 5;
        this.positionBits = Math.floor(properties / 45);
      }
      if (reset >= 1) {
        this.odds = new Uint16Array(LITERALS + (0x300 << (this.literalContext + this.literalPosition))).fill(
          1024,
        );
        this.state = 0;
        this.repeats.fill(0);
      }
      if (at + size > out.length) throw damaged("an xz stream is too long");
      this.coder[0] = 0xffffffff;
      this.coder[1] =
        ((source[place + 1] << 24) |
          (source[place + 2] << 16) |
          (source[place + 3] << 8) |
          source[place + 4]) >>>
        0;
      this.place = place + 5;
      this.chunk(at, at + size);
      at += size;
      place += packed;
    }
  }

  private bit(index: number): number {
    const { coder, odds } = this;
    const odd = odds[index];
    const bound = (coder[0] >>> 11) * odd;
    let bit: number;
    if (coder[1] < bound) {
      coder[0] = bound;
      odds[index] = odd + ((2048 - odd) >> 5);
      bit = 0;
    } else {
      coder[0] -= bound;
      coder[1] -= bound;
      odds[index] = odd - (odd >> 5);
      bit = 1;
    }
    if (coder[0] < TOP) {
      coder[0] <<= 8;
      coder[1] = (coder[1] << 8) | this.source[this.place++];
    }
    return bit;
  }

  private tree(base: number, bits: number): number {
    let node = 1;
    for (let i = 0; i < bits; i++) node = (node << 1) | this.bit(base + node);
    return node - (1 << bits);
  }

  private reverseTree(base: number, bits: number): number {
    let node = 1;
    let value = 0;
    for (let i = 0; i < bits; i++) {
      const bit = this.bit(base + node);
      node = (node << 1) | bit;
      value |= bit << i;
    }
    return value;
  }

  private direct(bits: number): number {
    const { coder } = this;
    let value = 0;
    for (let i = 0; i < bits; i++) {
      const middle = coder[0] >>> 1;
      coder[0] = middle;
      let bit = 0;
      if (coder[1] >= middle) {
        coder[1] -= middle;
        bit = 1;
      }
      value = (value << 1) | bit;
      if (middle < TOP) {
        coder[0] <<= 8;
        coder[1] = (coder[1] << 8) | this.source[this.place++];
      }
    }
    return value;
  }

  private length(base: number, position: number): number {
    if (!this.bit(base)) return 2 + this.tree(base + 2 + (position << 3), 3);
    if (!this.bit(base + 1)) return 10 + this.tree(base + 130 + (position << 3), 3);
    return 18 + this.tree(base + 258, 8);
  }

  private distance(length: number): number {
    const slot = this.tree(SLOTS + (Math.min(length - 2, 3) << 6), 6);
    if (slot < 4) return slot;
    const bits = (slot >> 1) - 1;
    const base = (2 | (slot & 1)) << bits;
    if (slot < 14) return base + this.reverseTree(SPECIAL + base - slot, bits);
    return base + (this.direct(bits - 4) << 4) + this.reverseTree(ALIGN, 4);
  }

  private literal(at: number, matched: boolean): number {
    const { out } = this;
    const before = at ? out[at - 1] : 0;
    const context =
      ((at & ((1 << this.literalPosition) - 1)) << this.literalContext) +
      (before >> (8 - this.literalContext));
    const base = LITERALS + 0x300 * context;
    let node = 1;
    if (matched) {
      let guess = out[at - this.repeats[0] - 1];
      for (let offset = 0x100; node < 0x100; ) {
        guess <<= 1;
        const expected = guess & offset;
        const bit = this.bit(base + offset + expected + node);
        node = (node << 1) | bit;
        offset &= bit ? guess : ~guess;
      }
    } else while (node < 0x100) node = (node << 1) | this.bit(base + node);
    return node & 255;
  }

  private chunk(from: number, end: number): void {
    const { out, repeats } = this;
    const mask = (1 << this.positionBits) - 1;
    let { state } = this;
    let at = from;
    while (at < end) {
      const position = at & mask;
      if (!this.bit((state << 4) + position)) {
        out[at] = this.literal(at, state >= 7);
        at++;
        state = state < 4 ? 0 : state < 10 ? state - 3 : state - 6;
        continue;
      }
      let length: number;
      if (!this.bit(IS_REPEAT + state)) {
        repeats.copyWithin(1, 0, 3);
        length = this.length(LENGTH, position);
        state = state < 7 ? 7 : 10;
        repeats[0] = this.distance(length);
      } else {
        if (this.bit(REPEAT_0 + state)) {
          const which = !this.bit(REPEAT_1 + state) ? 1 : !this.bit(REPEAT_2 + state) ? 2 : 3;
          const chosen = repeats[which];
          repeats.copyWithin(1, 0, which);
          repeats[0] = chosen;
        } else if (!this.bit(SHORT_REPEAT + (state << 4) + position)) {
          out[at] = out[at - repeats[0] - 1];
          at++;
          state = state < 7 ? 9 : 11;
          continue;
        }
        length = this.length(REPEAT_LENGTH, position);
        state = state < 7 ? 8 : 11;
      }
      const back = repeats[0] + 1;
      if (back > at || at + length > end) throw damaged("an xz stream is damaged");
      if (back === 1) out.fill(out[at - 1], at, at + length);
      else if (back >= length) out.copyWithin(at, at - back, at - back + length);
      else for (let i = 0; i < length; i++) out[at + i] = out[at + i - back];
      at += length;
    }
    this.state = state;
  }
}
