import { describe, expect, it } from "vitest";
import { gaps, type Header, ObjectFile } from "../core/objectfile.ts";
import { unxz } from "../core/xz.ts";
import { BYTES, STREAM } from "./stream.ts";

const stream = Uint8Array.from(Buffer.from(STREAM, "base64"));

/** A safetensors file of one tensor. */
function file(metadata: Record<string, string>, bytes = 4): ArrayBuffer {
  const tensor = { dtype: "F32", shape: [1], data_offsets: [0, bytes] };
  const head = new TextEncoder().encode(JSON.stringify({ __metadata__: metadata, "a.b": tensor }));
  const out = new Uint8Array(8 + head.length + 4);
  new DataView(out.buffer).setBigUint64(0, BigInt(head.length), true);
  out.set(head, 8);
  return out.buffer;
}

const HEADER = { format: "1.2", key: "cup", material: "wood", scale: 0.1 };

describe("xz", () => {
  it("unpacks what Python packed", () => {
    expect(unxz(stream, BYTES.length)).toEqual(BYTES);
  });

  it("refuses damaged, cut and foreign streams", () => {
    expect(() => unxz(stream, BYTES.length + 1)).toThrow("expected");
    expect(() => unxz(stream, BYTES.length - 1)).toThrow("too long");
    expect(() => unxz(new Uint8Array(50), 10)).toThrow("not an xz stream");
    for (let cut = 13; cut < stream.length - 40; cut += 97)
      expect(() => unxz(stream.subarray(0, cut), BYTES.length)).toThrow();
  });
});

describe("files", () => {
  it("that are Object Files are read", () => {
    const found = new ObjectFile(file({ objectfolder: JSON.stringify(HEADER) }));
    expect(found.header.key).toBe("cup");
    expect(() => found.tensor("audio.damping")).toThrow("lacks the tensor audio.damping");
  });

  it("that are not are explained", () => {
    const expected: [ArrayBuffer, string][] = [
      [new ArrayBuffer(3), "has only 3 bytes"],
      [
        new TextEncoder().encode("solid cube of a foreign format").buffer as ArrayBuffer,
        "not a safetensors file",
      ],
      [file({}), "is not an Object File"],
      [file({ objectfolder: JSON.stringify({ ...HEADER, format: "2.0" }) }), "this page reads 1.x"],
      [file({ objectfolder: JSON.stringify({ key: "cup" }) }), "older than format 1.0"],
      [file({ objectfolder: JSON.stringify(HEADER) }, 8), "ends beyond the file"],
      [file({ objectfolder: "{" }), "its header is not JSON"],
      [file({ objectfolder: "null" }), "its header is empty"],
      [file({ objectfolder: JSON.stringify({ ...HEADER, key: undefined }) }), "lacks key"],
      [
        file({
          objectfolder: JSON.stringify({ ...HEADER, geometry: { kind: "distance_grid", resolution: 4000 } }),
        }),
        "4000 points a side",
      ],
      [file({ objectfolder: JSON.stringify({ ...HEADER, audio: { kind: "gains" } }) }), "lacks audio.net"],
    ];
    for (const [buffer, message] of expected) expect(() => new ObjectFile(buffer)).toThrow(message);
  });

  it("say what they cannot answer", () => {
    const kinds = (vision: string, audio: string, touch: string) =>
      gaps({
        ...HEADER,
        geometry: { kind: "distance_grid", resolution: 2, band: 1, predictor: "none" },
        vision: { kind: vision },
        audio: { kind: audio },
        touch: { kind: touch },
      } as unknown as Header);
    expect(Object.values(kinds("surface", "gains", "geometric"))).toEqual([null, null, null, null]);
    const others = kinds("osf", "spectrogram", "image");
    expect(others.shape).toBeNull();
    expect([others.look, others.sound, others.touch].map((text) => /kind “(\w+)”/.exec(text!)![1])).toEqual([
      "osf",
      "spectrogram",
      "image",
    ]);
    expect(Object.values(gaps(HEADER)).every((text) => text !== null)).toBe(true);
  });
});
