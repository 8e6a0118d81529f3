/** Sounds of strikes. Levels are relative to the object's loudest spot under the strongest strike. */

const LOUDEST = 0.9; // of full scale

/** Level of what is played and saved, clipped beyond full scale. */
const leveled = (samples: Float32Array, gain: number): Float32Array =>
  samples.map((value) => Math.max(-1, Math.min(1, value * gain * LOUDEST)));

/** Return a sound as a WAV file of 16 bits. */
export function wav(samples: Float32Array, gain: number, rate: number): Blob {
  const size = 2 * samples.length;
  // "RIFF", its size, "WAVE"; "fmt ": PCM, one channel, rate, bytes per second, bytes and bits of a sample; "data".
  const form = [0x46464952, 36 + size, 0x45564157, 0x20746d66, 16, 0x10001, rate, 2 * rate, 0x100002];
  const head = Uint32Array.of(...form, 0x61746164, size);
  const body = Int16Array.from(leveled(samples, gain), (value) => Math.round(value * 32767));
  return new Blob([head, body], { type: "audio/wav" });
}

export class Player {
  private context: AudioContext | null = null;
  private playing: AudioBufferSourceNode | null = null;
  private waiting: (() => void) | null = null;

  /** @param rate of all sounds, Hz */
  constructor(private readonly rate: number) {
    // Browsers allow sound only from within a gesture; the sound of a strike comes after it.
    for (const name of ["pointerdown", "pointerup", "keydown"])
      window.addEventListener(name, () => this.unlock(), { capture: true });
  }

  /** Play a sound at a gain, or with the next gesture if none has been yet; samples beyond full scale are clipped. */
  play(samples: Float32Array, gain: number): void {
    this.waiting = null;
    const { context } = this;
    if (!context) {
      this.waiting = () => this.play(samples, gain);
      return;
    }
    const buffer = context.createBuffer(1, samples.length, this.rate);
    buffer.getChannelData(0).set(leveled(samples, gain));
    this.playing?.stop();
    this.playing = context.createBufferSource();
    this.playing.buffer = buffer;
    this.playing.connect(context.destination);
    this.playing.start();
  }

  private unlock(): void {
    // A finger that goes down is no gesture yet; that it goes up is.
    if (navigator.userActivation?.hasBeenActive === false) return;
    this.context ??= new AudioContext({ sampleRate: this.rate });
    // Where a browser refuses, the next gesture tries again.
    if (this.context.state !== "running") this.context.resume().catch(() => {});
    this.waiting?.();
  }

  get state(): string {
    return this.context?.state ?? "none";
  }
}
