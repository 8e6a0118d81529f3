import { afterEach, describe, expect, it, vi } from "vitest";
import { Player } from "../page/player.ts";

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
