import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { unpackBackground } from "../core/background.ts";
import type { Profile } from "../core/sensor.ts";
import { Answers } from "../worker/answers.ts";

const SAMPLE = new URL("../../objectfolder/objectfile/samples/die.safetensors", import.meta.url);
const [HEIGHT, WIDTH] = [12, 10];
/** What Python's `pack_background` gave for the picture of `level`. */
const PACKED =
  "/Td6WFoAAATm1rRGAgAhARYAAAB0L+Wj4AFnABcAABgAMgkySuvZ1QIny7xR4Mjpnvx2sycAAABAiWqWgBLNqAABM+gCAAAAS+UW87HEZ/sCAAAAAARZWg==";
const level = (y: number, x: number) => [240 - 20 * y, 20 * y, 255 * ((x + y) % 2)];

describe("the background of a sensor", () => {
  it("is unpacked as Python packed it", () => {
    const expected = Array.from({ length: HEIGHT * WIDTH }, (_, n) =>
      level(Math.floor(n / WIDTH), n % WIDTH),
    ).flat();
    expect([...unpackBackground(PACKED, HEIGHT, WIDTH)]).toEqual(expected);
  });

  it("is what another sensor than the stored one shows where nothing touches it", () => {
    const answers = new Answers(Uint8Array.from(readFileSync(SAMPLE)).buffer);
    const profile: Profile = {
      ...answers.file.header.touch!.net.sensor,
      height: HEIGHT,
      width: WIDTH,
      image_smoothing: 0,
      background: PACKED,
    };
    const { contact } = answers.at({ point: [0.5, 0.1, 0.2] })!;
    const { image, height } = answers.press(contact, { profile, gel: "rigid", depth: 5e-4, angle: 0 })!;
    const picture = unpackBackground(PACKED, HEIGHT, WIDTH);
    const untouched = [...height.keys()].filter((n) => height[n] <= 0);
    expect(untouched.length).toBeGreaterThan(0);
    expect(untouched.length).toBeLessThan(height.length);
    for (const n of untouched)
      expect([...image.subarray(4 * n, 4 * n + 3)]).toEqual([...picture.subarray(3 * n, 3 * n + 3)]);
  });
});
