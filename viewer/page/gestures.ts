/** Pointer, wheel and keys on the picture: poke the object, turn it, zoom. */

import type { Place } from "../worker/protocol.ts";
import type { View } from "./view.ts";

const TURN = 0.008; // rad per pixel
const KEY_TURN = 0.12; // rad
const KEY_ZOOM = 1.12;
const FINGERS = 100; // milliseconds in which a second finger may follow the first

export interface Handlers {
  /** A place was pressed (strike), or the pointer was drawn across it. */
  poke(place: Place, strike: boolean): void;
  turned(): void;
}

export class Gestures {
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private mode: "poke" | "turn" | null = null;
  private travelled = 0;
  /** A finger that may turn out to be the first of two. */
  private pending: { place: Place; timer: number } | null = null;

  constructor(
    private readonly view: View,
    private readonly handlers: Handlers,
  ) {
    const { canvas } = view;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(name, (event) => {
        if (name === "pointerup") this.press();
        else this.hold();
        this.pointers.delete(event.pointerId);
        if (!this.pointers.size) this.mode = null;
      });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!this.mayZoom()) return;
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY * 0.001));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Whether the wheel is ours: in a frame, such as a notebook's, it scrolls what holds it until we are used. */
  private mayZoom(): boolean {
    return window.parent === window || (document.hasFocus() && document.activeElement === this.view.canvas);
  }

  private placeAt(x: number, y: number): Place {
    const box = this.view.canvas.getBoundingClientRect();
    const across = ((x - box.left) / box.width) * 2 - 1;
    const up = 1 - ((y - box.top) / box.height) * 2;
    const { orbit, aspect } = this.view;
    return { origin: orbit.eye, direction: orbit.ray(across, up, aspect) };
  }

  private down(event: PointerEvent): void {
    const { clientX: x, clientY: y } = event;
    this.view.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x, y });
    this.travelled = 0;
    const turning = event.button !== 0 || event.shiftKey || this.pointers.size > 1;
    this.mode = !turning && this.view.covers(x, y) ? "poke" : "turn";
    this.hold();
    if (this.mode !== "poke") return;
    const place = this.placeAt(x, y);
    if (event.pointerType !== "touch") return this.handlers.poke(place, true);
    this.pending = { place, timer: window.setTimeout(() => this.press(), FINGERS) };
  }

  /** Strike where a finger came down, unless that is done or another has followed. */
  private press(): void {
    const { pending } = this;
    this.hold();
    if (pending) this.handlers.poke(pending.place, true);
  }

  private hold(): void {
    clearTimeout(this.pending?.timer);
    this.pending = null;
  }

  private move(event: PointerEvent): void {
    const { clientX: x, clientY: y } = event;
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.view.canvas.classList.toggle("over", this.view.covers(x, y));
      return;
    }
    const [right, down] = [x - before.x, y - before.y];
    const spread = this.spread();
    this.pointers.set(event.pointerId, { x, y });
    this.travelled += Math.hypot(right, down);
    if (this.mode === "poke") {
      if (this.pending || this.travelled <= 2 || !this.view.covers(x, y)) return;
      this.handlers.poke(this.placeAt(x, y), false);
    } else if (this.pointers.size > 1) {
      this.zoom(spread / Math.max(this.spread(), 1));
      this.turn((right * TURN) / 2, (down * TURN) / 2); // by the point between two fingers
    } else this.turn(right * TURN, down * TURN);
  }

  /** Distance between two fingers. */
  private spread(): number {
    const [a, b] = [...this.pointers.values()];
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 1;
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return; // shortcuts of the browser
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [-KEY_TURN, 0],
      ArrowRight: [KEY_TURN, 0],
      ArrowUp: [0, -KEY_TURN],
      ArrowDown: [0, KEY_TURN],
    };
    const turn = turns[event.key];
    if (turn) this.turn(...turn);
    else if (event.key === "+" || event.key === "=") this.zoom(1 / KEY_ZOOM);
    else if (event.key === "-") this.zoom(KEY_ZOOM);
    else if (event.key === "Enter" || event.key === " ") {
      const { orbit, aspect } = this.view;
      this.handlers.poke({ origin: orbit.eye, direction: orbit.ray(0, 0, aspect) }, true);
    } else return;
    event.preventDefault();
  }

  private turn(right: number, up: number): void {
    this.view.orbit.turn(right, up);
    this.view.changed();
    this.handlers.turned();
  }

  private zoom(factor: number): void {
    this.view.orbit.zoom(factor);
    this.view.changed();
    this.handlers.turned();
  }
}
