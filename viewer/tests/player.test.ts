import { afterEach, describe, expect, it, vi } from "vitest";
import { Player, wav } from "../page/player.ts";

/** A context that counts the sounds that start in it, and starts suspended. */
class Context {
  static made: Context[] = [];
  state = "suspended";
  started = 0;
  destination = {};

  constructor() {
    Context.made.push(this);
  }

  async resume() {
    this.state = "running";
  }

  createBuffer(_channels: number, length: number) {
    return { getChannelData: () => new Float32Array(length) };
  }

  createBufferSource() {
    return { connect: () => {}, stop: () => {}, start: () => this.started++ };
  }
}

function page(activation?: { hasBeenActive: boolean }) {
  Context.made = [];
  const target = new EventTarget();
  vi.stubGlobal("window", target);
  vi.stubGlobal("navigator", { userActivation: activation });
  vi.stubGlobal("AudioContext", Context);
  return (name: string) => target.dispatchEvent(new Event(name));
}

afterEach(() => vi.unstubAllGlobals());

describe("sound", () => {
  it("waits for a gesture, and then starts within it", () => {
    const activation = { hasBeenActive: false };
    const gesture = page(activation);
    const player = new Player(44100);
    gesture("pointerdown"); // a finger goes down
    player.play(new Float32Array(8), 1);
    player.play(new Float32Array(8), 1);
    expect(Context.made).toEqual([]);
    activation.hasBeenActive = true;
    gesture("pointerup");
    expect(player.state).toBe("running");
    expect(Context.made.map(({ started }) => started)).toEqual([1]);
    gesture("pointerup");
    expect(Context.made.map(({ started }) => started)).toEqual([1]);
  });

  it("is allowed by each gesture, also where browsers do not tell what counts as one", () => {
    for (const name of ["pointerdown", "pointerup", "keydown"]) {
      const gesture = page();
      const player = new Player(44100);
      gesture(name);
      expect(player.state).toBe("running");
    }
  });

  it("goes on when a browser has interrupted it", () => {
    const gesture = page();
    const player = new Player(44100);
    gesture("keydown");
    Context.made[0].state = "suspended";
    gesture("keydown");
    expect(player.state).toBe("running");
    expect(Context.made.length).toBe(1);
  });
});

describe("a saved sound", () => {
  it("is a WAV file of 16 bits at the level that is played", async () => {
    const bytes = new DataView(await wav(Float32Array.of(0.5, -4), 1, 44100).arrayBuffer());
    const text = (at: number) => String.fromCharCode(...new Uint8Array(bytes.buffer, at, 4));
    expect([0, 8, 12, 36].map(text)).toEqual(["RIFF", "WAVE", "fmt ", "data"]);
    expect([4, 16, 24, 28, 40].map((at) => bytes.getUint32(at, true))).toEqual([40, 16, 44100, 88200, 4]);
    expect([20, 22, 32, 34].map((at) => bytes.getUint16(at, true))).toEqual([1, 1, 2, 16]);
    expect([44, 46].map((at) => bytes.getInt16(at, true))).toEqual([Math.round(0.45 * 32767), -32767]);
    expect(bytes.byteLength).toBe(48);
  });
});
