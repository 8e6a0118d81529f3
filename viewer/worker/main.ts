/** The worker: answers the page's questions, strikes and touches first. */

import type { Slice } from "../core/indirect.ts";
import { FormatError } from "../core/safetensors.ts";
import { Answers } from "./answers.ts";
import type { Reply, Request } from "./protocol.ts";

const FRAME = 12; // milliseconds of work between looks at new messages

let answers: Answers | null = null;
let opened = 0;
let lit = 0;

const post = (reply: Reply, transfer: Transferable[] = []): void => self.postMessage(reply, { transfer });

class Outdated extends Error {}

/** Wait until the messages that have arrived are handled. */
const breathe = (): Promise<void> =>
  new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(null);
  });

/** Return a slicer of work that stops when its result is no longer wanted. */
function sliced(wanted: () => boolean): Slice {
  return async (count, work) => {
    let batch = 64;
    for (let from = 0; from < count; ) {
      const start = performance.now();
      const to = Math.min(from + batch, count);
      work(from, to);
      from = to;
      const took = performance.now() - start;
      batch = Math.max(16, Math.min(Math.floor((batch * FRAME) / Math.max(took, 0.1)), 4 * batch));
      await breathe();
      if (!wanted()) throw new Outdated();
    }
  };
}

async function open({ buffer, request }: Extract<Request, { kind: "open" }>): Promise<void> {
  const bytes = buffer.byteLength;
  // A file that cannot be read throws here, and the open object stays.
  const found = new Answers(buffer);
  const mine = ++opened;
  lit++; // light on the object before is no longer wanted
  answers = found;
  const { position, normal, index } = found.mesh;
  const mesh = { position: position.slice(), normal: normal.slice(), index: index.slice() };
  post({ kind: "shape", header: found.file.header, gaps: found.gaps, mesh, bytes, request }, [
    mesh.position.buffer,
    mesh.normal.buffer,
    mesh.index.buffer,
  ]);
  const slice = sliced(() => mine === opened);
  await breathe();
  const look = await found.appearance(slice);
  if (look?.kind !== "look") return;
  post(look, [look.color.buffer, look.normal.buffer]);
  if (await found.prepareBounces(slice)) post({ kind: "bounces" });
}

async function answer(request: Request): Promise<void> {
  if (request.kind === "open") return open(request);
  if (request.kind === "ping") return post({ kind: "done" });
  if (!answers) return;
  if (request.kind === "light") {
    const mine = ++lit;
    const values = await answers.bounces(
      request.camera,
      request.lights,
      sliced(() => mine === lit),
    );
    if (values) post({ kind: "indirect", values, request: request.request }, [values.buffer]);
    return;
  }
  const place = answers.at(request.place);
  if (!place) return post({ kind: "missed" });
  const { point, contact } = place;
  post({ kind: "point", point });
  const sound = request.strike && answers.strike(point, request.strike);
  if (sound) post(sound, [sound.samples.buffer]);
  const touch = request.touch && answers.press(contact, request.touch);
  if (touch) post(touch, [touch.image.buffer, touch.height.buffer]);
}

self.onmessage = (event: MessageEvent<Request>) => {
  answer(event.data).catch((error: unknown) => {
    if (error instanceof Outdated) return;
    const message = error instanceof Error ? error.message : String(error);
    const request = event.data.kind === "open" ? event.data.request : undefined;
    const cause = request === undefined ? "This cannot be computed" : "It is damaged";
    const whole = error instanceof FormatError ? message : `${cause}: ${message}`;
    post({ kind: "problem", message: whole, request });
  });
};
