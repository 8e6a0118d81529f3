/** Sounds of strikes. Levels are relative to the object's loudest spot under the strongest strike. */

const LOUDEST = 0.9; // of full scale

export class Player {
  private context: AudioContext | null = null;
  private playing: AudioBufferSourceNode | null = null;

  /** Play a sound at a gain; samples beyond full scale are clipped. */
  play(samples: Float32Array, rate: number, gain: number): void {
    this.context ??= new AudioContext({ sampleRate: rate });
    if (this.context.state === "suspended") void this.context.resume();
    const buffer = this.context.createBuffer(1, samples.length, rate);
    const data = buffer.getChannelData(0);
    for (let n = 0; n < data.length; n++) data[n] = Math.max(-1, Math.min(1, samples[n] * gain * LOUDEST));
    this.playing?.stop();
    this.playing = this.context.createBufferSource();
    this.playing.buffer = buffer;
    this.playing.connect(this.context.destination);
    this.playing.start();
  }

  get state(): string {
    return this.context?.state ?? "none";
  }
}
