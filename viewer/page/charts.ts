/** Drawings of a sound and of a contact. */

import type { Tone } from "../worker/protocol.ts";

/** A canvas at the screen's resolution, and its size in CSS pixels. */
function prepared(canvas: HTMLCanvasElement): [CanvasRenderingContext2D, number, number] {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d")!;
  context.scale(ratio, ratio);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

const color = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name);

/** Remove what is drawn. */
export function clear(canvas: HTMLCanvasElement): void {
  canvas.getContext("2d")!.clearRect(0, 0, canvas.width, canvas.height);
}

/** Draw the beginning of a sound. @param gain that takes full scale to the canvas */
export function drawWave(canvas: HTMLCanvasElement, samples: Float32Array, gain: number): void {
  const [context, width, height] = prepared(canvas);
  const middle = height / 2;
  context.strokeStyle = color("--line");
  context.beginPath();
  context.moveTo(0, middle);
  context.lineTo(width, middle);
  context.stroke();
  context.fillStyle = color("--accent");
  for (let x = 0; x < width; x++) {
    let [least, most] = [0, 0];
    const end = Math.floor(((x + 1) * samples.length) / width);
    for (let n = Math.floor((x * samples.length) / width); n < end; n++) {
      least = Math.min(least, samples[n]);
      most = Math.max(most, samples[n]);
    }
    const top = middle - Math.min(most * gain, 1) * middle;
    const bottom = middle - Math.max(least * gain, -1) * middle;
    context.fillRect(x, top, 1, Math.max(bottom - top, 1));
  }
}

const LOWEST = 20;
const HIGHEST = 20000;
const FLOOR = -60;

/** Draw the modes of a sound: frequency to the right, level upwards. */
export function drawTones(canvas: HTMLCanvasElement, tones: Tone[]): void {
  const [context, width, height] = prepared(canvas);
  const bottom = height - 14;
  const across = (hertz: number) => (Math.log(hertz / LOWEST) / Math.log(HIGHEST / LOWEST)) * width;
  context.font = "10px system-ui, sans-serif";
  context.textAlign = "center";
  for (const hertz of [100, 1000, 10000]) {
    context.strokeStyle = color("--line");
    context.beginPath();
    context.moveTo(across(hertz), 0);
    context.lineTo(across(hertz), bottom);
    context.stroke();
    context.fillStyle = color("--quiet");
    context.fillText(hertz < 1000 ? `${hertz} Hz` : `${hertz / 1000} kHz`, across(hertz), height - 3);
  }
  context.fillStyle = color("--accent");
  for (const { frequency, level } of tones) {
    const tall = (1 - level / FLOOR) * (bottom - 2);
    context.fillRect(across(frequency) - 0.75, bottom - tall, 1.5, tall);
  }
}

/** Draw an RGBA picture. */
export function drawImage(
  canvas: HTMLCanvasElement,
  image: Uint8ClampedArray,
  width: number,
  rows: number,
): void {
  canvas.width = width;
  canvas.height = rows;
  const data = new ImageData(width, rows);
  data.data.set(image);
  canvas.getContext("2d")!.putImageData(data, 0, 0);
}

/** Points of the colour map of heights (viridis). */
const MAP = [
  [68, 1, 84],
  [59, 82, 139],
  [33, 145, 140],
  [94, 201, 98],
  [253, 231, 37],
];

/** Draw heights in the gel, from 0 to the deepest. */
export function drawHeights(
  canvas: HTMLCanvasElement,
  heights: Float32Array,
  width: number,
  rows: number,
  deepest: number,
): void {
  const image = new Uint8ClampedArray(4 * heights.length);
  heights.forEach((height, n) => {
    const place = Math.min(Math.max(height / deepest, 0), 1) * (MAP.length - 1);
    const low = Math.min(Math.floor(place), MAP.length - 2);
    for (let c = 0; c < 3; c++)
      image[4 * n + c] = MAP[low][c] + (place - low) * (MAP[low + 1][c] - MAP[low][c]);
    image[4 * n + 3] = 255;
  });
  drawImage(canvas, image, width, rows);
}
