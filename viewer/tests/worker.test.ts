import { readFileSync } from "node:fs";
import { beforeAll, describe, expect, it, vi } from "vitest";
import type { Reply, Request } from "../worker/protocol.ts";

const SAMPLE = new URL("../../objectfolder/objectfile/samples/die.safetensors", import.meta.url);
const POKE: Request = { kind: "poke", place: { point: [0.5, 0.1, 0.2] }, strike: null, touch: null };

/** The worker's scope, and what it posted. */
const scope = {
  onmessage: (_: { data: Request }): void => {},
  postMessage: (reply: Reply) => {
    posted.push(reply.kind);
  },
};
const posted: Reply["kind"][] = [];

/** Ask something and return the kinds of the replies until one ends it. */
async function asked(request: Request, end: Reply["kind"]): Promise<Reply["kind"][]> {
  const before = posted.length;
  scope.onmessage({ data: request });
  await vi.waitFor(() => expect(posted.slice(before)).toContain(end), 30_000);
  return posted.slice(before);
}

let opened = 0;
const opening = (bytes: Uint8Array): Request => ({
  kind: "open",
  buffer: Uint8Array.from(bytes).buffer,
  request: ++opened,
});

describe("the worker", () => {
  beforeAll(async () => {
    vi.stubGlobal("self", scope);
    await import("../worker/main.ts");
  });

  it("keeps the open object when another file cannot be read", async () => {
    const sample = readFileSync(SAMPLE);
    await asked(opening(sample), "shape");
    expect(await asked(opening(sample.subarray(0, 1000)), "problem")).not.toContain("shape");
    await asked(POKE, "point");
    await vi.waitFor(() => expect(posted).toContain("bounces"), 50_000);
  });
});
