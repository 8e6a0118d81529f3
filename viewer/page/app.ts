/** What the page does: opens objects, and turns clicks and settings into questions to the worker. */

import source from "worker-source";
import { BOUND } from "../core/grid.ts";
import type { PointLight } from "../core/indirect.ts";
import { contactTime, type Material, type Striker } from "../core/materials.ts";
import type { Gaps, Header } from "../core/objectfile.ts";
import type { Profile } from "../core/sensor.ts";
import { ownMaterial } from "../core/tuning.ts";
import type { Vector } from "../core/vector.ts";
import type { Place, Reply, Request, StrikeSettings, TouchSettings } from "../worker/protocol.ts";
import { clear, drawHeights, drawImage, drawTones, drawWave } from "./charts.ts";
import { canvas, element, input, options, save, select, tell, whenever } from "./elements.ts";
import { Gestures } from "./gestures.ts";
import { single, studio } from "./lighting.ts";
import { embedded, type Source, whenOpened } from "./objects.ts";
import { Orbit } from "./orbit.ts";
import { Player, wav } from "./player.ts";
import { View } from "./view.ts";

const START: Vector = [1.8, 1.2, 1.15]; // of the camera
const RATE = 44100;
const DURATION = 2.5;
const SILENCE = 1e-5; // modes end below this share of the loudest
const RING = 0.02; // radius of the mark, unit frame
const STRONGEST = 0.1; // N s
const MISSED = 2000; // milliseconds that a note stays
const PAUSE = 90; // milliseconds without a change after which indirect light is asked for

const LOST =
  "The browser took the graphics card away, and usually gives it back soon. If the picture stays empty, reload the page.";

/** A few digits, without an exponent. */
const short = (value: number, digits = 3): string => String(+value.toPrecision(digits));

const greatest = (samples: Float32Array): number =>
  samples.reduce((most, value) => Math.max(most, Math.abs(value)), 0);

export interface Settings {
  /** By law of damping, then by name. */
  materials?: Record<"rayleigh" | "loss_factor", Record<string, Material>>;
  sensors?: Record<string, Profile>;
  /** That strikes by default. */
  striker?: Striker;
}

export class App {
  /** Milliseconds from the opening of the page or a file, by event; of the last strike and touch. */
  readonly times: Record<string, number> = {};
  readonly view: View;
  readonly orbit = new Orbit(START);
  readonly player = new Player(RATE);
  lastSound: Extract<Reply, { kind: "sound" }> | null = null;
  lastTouch: Extract<Reply, { kind: "touch" }> | null = null;
  point: Vector | null = null;
  private readonly worker: Worker;
  private header: Header | null = null;
  private gaps: Gaps | null = null;
  private began = 0;
  private bounces = false;
  private asked = 0;
  private timer = 0;
  private missed = 0;
  private poking = false;
  private waiting: { place: Place; strike: boolean } | null = null;
  private lights: PointLight[] = [];
  private sources: Source[] = embedded();
  private shown: Source | null = null;
  /** The source that was chosen last, until it is shown or cannot be. */
  private wanted: Source | null = null;
  /** Sources that the worker was asked to open, by the number of the request. */
  private readonly opening = new Map<number, Source>();
  private opened = 0;
  private readonly settled: (() => void)[] = [];
  private readonly answered: (() => void)[] = [];

  constructor(private readonly settings: Settings) {
    this.worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
    this.worker.onmessage = (event: MessageEvent<Reply>) => this.receive(event.data);
    this.worker.onerror = (event) => {
      if (this.wanted) this.fail(this.wanted, event.message);
      else this.problem(event.message);
      this.next(); // no reply ends this request
    };
    // The worker reads the first object while this thread sets the picture up.
    select("object").addEventListener("change", () =>
      this.show(this.sources[select("object").selectedIndex]),
    );
    if (this.sources.length) this.show(this.sources[0]);
    else this.problem("Open an Object File, or drop one on this page.", "No object");
    const accent = matchMedia("(prefers-color-scheme: dark)").matches
      ? [0.98, 0.6, 0.33]
      : [0.78, 0.25, 0.02];
    this.view = new View(canvas("view"), this.orbit, accent as Vector, (away) => {
      if (away) this.announce("The picture is lost", LOST);
      else tell("message", null);
    });
    new Gestures(this.view, {
      poke: (place, strike) => this.poke(place, strike),
      turned: () => this.relight(false),
    });
    this.forget();
    this.wire();
    new ResizeObserver(() => this.resize()).observe(element("stage"));
    this.resize();
    this.relight();
    const frame = () => {
      this.view.draw();
      requestAnimationFrame(frame);
    };
    frame();
  }

  /** Read and show one of the sources. */
  private async show(source: Source): Promise<void> {
    this.wanted = source;
    this.choose(source);
    const began = performance.now();
    let buffer: ArrayBuffer;
    try {
      const read = source.read();
      buffer = read instanceof ArrayBuffer ? read : await read;
    } catch {
      return this.fail(source, `${source.name} cannot be read: is it a file?`);
    }
    if (this.wanted === source) this.open(source, buffer, began); // else another was chosen meanwhile
  }

  /** Fill the menu of objects, with one of them chosen. */
  private choose(source: Source): void {
    element("chooser").hidden = this.sources.length < 2;
    options(
      "object",
      this.sources.map(({ name }, at) => [String(at), name]),
      String(this.sources.indexOf(source)),
    );
  }

  /** Say that a source cannot be shown, and forget it; the object that is shown stays. */
  private fail(source: Source, message: string): void {
    if (this.wanted === source) this.wanted = null;
    if (this.shown) {
      this.sources = this.sources.filter((other) => other !== source);
      this.choose(this.wanted ?? this.shown);
    }
    this.problem(message, "This file cannot be shown");
  }

  /** Open an Object File. */
  private open(source: Source, buffer: ArrayBuffer, began: number): void {
    this.began = this.times.shape === undefined ? 0 : began;
    this.waiting = null; // it was meant for the object that is open now
    tell("message", null);
    tell("busy", "Reading the Object File …");
    const request = ++this.opened;
    this.opening.set(request, source);
    this.ask({ kind: "open", buffer, request }, [buffer]);
  }

  /** Strike and touch a place, or only touch it. */
  poke(place: Place, strike = true): void {
    if (this.poking) {
      this.waiting = { place, strike: strike || (this.waiting?.strike ?? false) };
      return;
    }
    // Without an object, a message says why there is none.
    if (!this.header) return;
    this.poking = true;
    tell("message", null);
    clearTimeout(this.missed);
    tell("busy", null);
    const touch = this.gaps?.touch ? null : this.touchSettings();
    this.ask({
      kind: "poke",
      place,
      strike: strike && !this.gaps?.sound ? this.strikeSettings() : null,
      touch,
    });
    this.ask({ kind: "ping" });
  }

  /** Strike and touch a place with settings of one's own, and return when both are answered. */
  query(place: Place, strike: StrikeSettings | null, touch: TouchSettings | null): Promise<void> {
    this.ask({ kind: "poke", place, strike, touch });
    this.ask({ kind: "ping" });
    return new Promise((resolve) => this.answered.push(resolve));
  }

  /** Show a camera and lights and return when their indirect light is drawn. */
  settle(eye: Vector, lights: PointLight[]): Promise<void> {
    this.orbit.place(eye);
    this.lights = lights;
    this.view.light(lights);
    return new Promise((resolve) => {
      if (!this.bounces) return resolve();
      this.settled.push(resolve);
      this.askLight();
    });
  }

  private ask(request: Request, transfer: Transferable[] = []): void {
    this.worker.postMessage(request, transfer);
  }

  private receive(reply: Reply): void {
    switch (reply.kind) {
      case "problem":
        return this.receiveProblem(reply);
      case "shape":
        return this.showShape(reply);
      case "look":
        this.view.dress(reply.color, reply.normal, reply.roughness, reply.metallic);
        this.note("coloured");
        return;
      case "bounces":
        this.bounces = true;
        return this.askLight();
      case "indirect":
        if (reply.request !== this.asked) return;
        this.view.bounce(reply.values);
        this.note("bounced");
        for (const resolve of this.settled.splice(0)) resolve();
        return;
      case "point":
        this.point = reply.point;
        return this.view.point(reply.point, RING);
      case "sound":
        return this.showSound(reply);
      case "touch":
        return this.showTouch(reply);
      case "done":
        return this.next();
      case "missed":
        return this.miss();
    }
  }

  /** Say that a strike met nothing. */
  private miss(): void {
    tell("busy", "Nothing is there: turn the object, or strike beside it.");
    clearTimeout(this.missed);
    this.missed = window.setTimeout(() => tell("busy", null), MISSED);
  }

  private next(): void {
    const resolve = this.answered.shift();
    if (resolve) return resolve();
    this.poking = false;
    const { waiting } = this;
    this.waiting = null;
    if (waiting) this.poke(waiting.place, waiting.strike);
  }

  private note(event: string): void {
    this.times[event] = performance.now() - this.began;
  }

  private receiveProblem({ message, request = 0 }: Extract<Reply, { kind: "problem" }>): void {
    const source = this.opening.get(request);
    this.opening.delete(request);
    if (source) this.fail(source, message);
    else this.problem(message);
  }

  private problem(message: string, title = "Part of this file cannot be shown"): void {
    tell("busy", null);
    this.announce(title, message);
  }

  private announce(title: string, message: string): void {
    const place = element("message");
    const heading = document.createElement("strong");
    heading.textContent = title;
    place.replaceChildren(heading, message);
    if (this.header) {
      // The message covers an object that is still there to be struck.
      const close = document.createElement("button");
      close.textContent = "Close";
      close.addEventListener("click", () => tell("message", null));
      place.append(close);
    }
    place.hidden = false;
  }

  private showShape({ header, gaps, mesh, bytes, request }: Extract<Reply, { kind: "shape" }>): void {
    this.header = header;
    this.gaps = gaps;
    const source = this.opening.get(request)!;
    this.opening.delete(request);
    this.shown = source;
    if (this.wanted === source) this.wanted = null;
    this.choose(this.wanted ?? source);
    this.bounces = false;
    this.forget();
    if (!this.wanted) tell("busy", null);
    element("name").textContent = header.key.replaceAll("_", " ");
    const size = header.scale < 1 ? `${short(header.scale * 1000)} mm` : `${short(header.scale)} m`;
    tell("facts", `${header.material} · ${size} · ${(bytes / 1000).toFixed(0)} kB`);
    document.title = `${header.key} – objectfolder`;
    for (const sense of ["sound", "touch"] as const) {
      tell(`${sense}-gap`, gaps[sense]);
      element(`${sense}-controls`).hidden = gaps[sense] !== null;
    }
    tell("look-gap", gaps.look);
    this.fillMenus(header);
    this.view.show(mesh, (2 * BOUND) / (header.geometry!.resolution - 1));
    this.relight();
    this.view.draw();
    this.note("shape");
  }

  /** Remove the answers of the object before. */
  private forget(): void {
    this.point = null;
    this.lastSound = null;
    this.lastTouch = null;
    for (const id of ["wave", "tones", "touch", "heights"]) clear(canvas(id));
    element("sound-readout").textContent = "Strike the object to hear it.";
    element("touch-readout").textContent = "Touch the object to feel it.";
    element("notes").replaceChildren();
    for (const id of ["again", "save-sound"]) element<HTMLButtonElement>(id).disabled = true;
    delete this.times.strike;
    delete this.times.touch;
    this.timing();
  }

  private fillMenus(header: Header): void {
    const tunable = ownMaterial(header) !== null;
    const names = Object.keys(this.materials);
    const others = names.filter((name) => name !== header.material && tunable);
    options("material", [
      ["", `${header.material} (its own)`],
      ...others.map((name) => [name, name] as [string, string]),
    ]);
    select("material").disabled = input("size").disabled = !tunable;
    input("size").value = "0";
    input("contact").value = String(this.contact(header) * 1e3);
    const sensors = Object.keys(this.settings.sensors ?? {});
    const own = this.gaps?.touch === null ? header.touch!.net : null;
    const tacto = own?.renderer === "tacto" ? " (images as this library's gel, not TACTO)" : "";
    options("sensor", [
      ["", `${own?.sensor.name ?? "none"}, as stored${tacto}`],
      ["rigid", "the same, rigid gel"],
      ...sensors.filter((name) => name !== own?.sensor.name).map((name) => [name, name] as [string, string]),
    ]);
    this.labels();
  }

  /** How long the library's striker touches the object, seconds; an impulse where it does not know either. */
  private contact(header: Header): number {
    const [own, { striker }] = [ownMaterial(header), this.settings];
    const mass = (header.solid?.volume ?? Number.POSITIVE_INFINITY) * header.scale ** 3 * (own?.density ?? 1);
    return own && striker ? contactTime(striker, own, mass) : 0;
  }

  private get sensor(): Profile | null {
    const name = select("sensor").value;
    return (
      (name && name !== "rigid" ? this.settings.sensors?.[name] : this.header?.touch?.net.sensor) ?? null
    );
  }

  /** By name, with the open object's law of damping. */
  private get materials(): Record<string, Material> {
    const law = this.header?.material_properties?.loss_factor ? "loss_factor" : "rayleigh";
    return this.settings.materials?.[law] ?? {};
  }

  private strikeSettings(): StrikeSettings {
    const material = this.materials[select("material").value] ?? null;
    const size = 2 ** +input("size").value;
    const contact = +input("contact").value * 1e-3;
    return {
      impulse: this.impulse,
      contact,
      material,
      size,
      rate: RATE,
      duration: DURATION,
      response: "acceleration",
      silence: SILENCE,
      listener: this.orbit.eye,
      reference: START,
    };
  }

  private touchSettings(): TouchSettings {
    const name = select("sensor").value;
    return {
      profile: name && name !== "rigid" ? (this.settings.sensors?.[name] ?? null) : null,
      gel: name === "rigid" ? "rigid" : "stored",
      depth: +input("depth").value * 1e-3,
      angle: (+input("angle").value * Math.PI) / 180,
    };
  }

  /** N s. */
  private get impulse(): number {
    return 10 ** +input("impulse").value * 1e-3;
  }

  private showSound(sound: Extract<Reply, { kind: "sound" }>): void {
    this.lastSound = sound;
    this.times.strike = sound.milliseconds;
    this.play();
    this.drawSound();
    const peak = greatest(sound.samples);
    const gain = sound.reference > 0 ? 1 / (sound.reference * STRONGEST) : 0;
    const [loudest] = sound.tones;
    const level = 20 * Math.log10(Math.max(peak * gain, 1e-9));
    element("sound-readout").innerHTML = loudest
      ? `<b>${loudest.frequency.toFixed(0)} Hz</b> loudest of ${sound.modes} mode${sound.modes === 1 ? "" : "s"}, rings ${loudest.decay.toPrecision(2)} s · <b>${level.toFixed(0)} dB</b> of the loudest`
      : peak > 0
        ? "No mode lies within hearing: only the click of the strike is heard."
        : "Silent: no mode lies within hearing.";
    element("notes").replaceChildren(
      ...sound.notes.map((text) => Object.assign(document.createElement("li"), { textContent: text })),
    );
    for (const id of ["again", "save-sound"]) element<HTMLButtonElement>(id).disabled = false;
    this.timing();
  }

  private drawSound(): void {
    const { lastSound } = this;
    if (!lastSound) return;
    const peak = greatest(lastSound.samples);
    drawWave(canvas("wave"), lastSound.samples.subarray(0, RATE / 2), peak > 0 ? 0.95 / peak : 0);
    drawTones(canvas("tones"), lastSound.tones);
  }

  private play(): void {
    const { lastSound } = this;
    if (lastSound?.reference) this.player.play(lastSound.samples, 1 / (lastSound.reference * STRONGEST));
  }

  private saveSound(): void {
    const { lastSound, header } = this;
    if (lastSound?.reference && header)
      save(wav(lastSound.samples, 1 / (lastSound.reference * STRONGEST), RATE), `${header.key}.wav`);
  }

  private saveView(): void {
    const { header } = this;
    if (header) canvas("view").toBlob((picture) => picture && save(picture, `${header.key}.png`));
  }

  private showTouch(touch: Extract<Reply, { kind: "touch" }>): void {
    this.lastTouch = touch;
    this.times.touch = touch.milliseconds;
    drawImage(canvas("touch"), touch.image, touch.width, touch.rows);
    drawHeights(canvas("heights"), touch.height, touch.width, touch.rows, touch.deepest);
    const force = touch.force === null ? "" : `<b>${short(touch.force)} N</b> on `;
    const blocked = touch.obstructed > 0 ? " · obstructed: a real sensor could not get there" : "";
    element("touch-readout").innerHTML = `${force}<b>${short(touch.area * 1e6)} mm²</b>${blocked}`;
    this.timing();
  }

  private timing(): void {
    const { strike, touch } = this.times;
    const parts = [strike && `strike ${strike.toFixed(0)} ms`, touch && `touch ${touch.toFixed(0)} ms`];
    element("timing").textContent = parts.filter(Boolean).join(", ");
  }

  private labels(): void {
    const show = (id: string, text: string) => {
      element(id).parentElement!.querySelector("output")!.textContent = text;
      element(id).setAttribute("aria-valuetext", text);
    };
    const deepest = (this.sensor?.max_indentation ?? 2e-3) * 1e3;
    input("depth").max = String(deepest);
    show("impulse", `${short(this.impulse * 1e3, 2)} mN·s`);
    show("contact", `${(+input("contact").value).toFixed(2)} ms`);
    show("size", `× ${short(2 ** +input("size").value)}`);
    show("depth", `${(+input("depth").value).toFixed(2)} mm`);
    for (const id of ["angle", "azimuth", "elevation"]) show(id, `${input(id).value}°`);
    show("distance", `× ${short(+input("distance").value)}`);
    element("distance-row").hidden = select("setup").value === "studio";
  }

  private wire(): void {
    const again = (strike: boolean) => () => {
      this.labels();
      if (this.point) this.poke({ point: this.point }, strike);
    };
    whenever(["impulse", "contact", "size"], "change", again(true));
    whenever(["impulse", "contact", "size"], "input", () => this.labels());
    whenever(["material"], "change", again(true));
    whenever(["depth", "angle"], "input", again(false));
    whenever(["sensor"], "change", again(false));
    whenever(["azimuth", "elevation", "distance"], "input", () => this.relight());
    whenever(["setup"], "change", () => this.relight());
    element("again").addEventListener("click", () => this.play());
    element("save-sound").addEventListener("click", () => this.saveSound());
    element("save-view").addEventListener("click", () => this.saveView());
    // Frames of notebooks and reports may not save.
    element("save-sound").hidden = element("save-view").hidden = window.parent !== window;
    element("reset").addEventListener("click", () => {
      this.orbit.reset();
      this.view.changed();
      this.relight(false);
    });
    whenOpened(input("file"), (files) => {
      const first = this.sources.length;
      this.sources = [...this.sources, ...files];
      void this.show(this.sources[first]);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.drawSound());
    this.labels();
  }

  private relight(moved = true): void {
    this.labels();
    if (moved) {
      const [azimuth, elevation] = [+input("azimuth").value, +input("elevation").value];
      this.lights =
        select("setup").value === "studio"
          ? studio(azimuth, elevation)
          : single(azimuth, elevation, +input("distance").value);
      this.view.light(this.lights);
    }
    clearTimeout(this.timer);
    if (this.bounces) this.timer = window.setTimeout(() => this.askLight(), PAUSE);
  }

  private askLight(): void {
    this.ask({ kind: "light", camera: this.orbit.eye, lights: this.lights, request: ++this.asked });
  }

  private resize(): void {
    const box = element("stage").getBoundingClientRect();
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { canvas: picture } = this.view;
    picture.width = Math.max(Math.round(box.width * ratio), 1);
    picture.height = Math.max(Math.round(box.height * ratio), 1);
    this.view.changed();
    this.drawSound();
  }
}
