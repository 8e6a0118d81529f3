/** The object in WebGL 2. */

import type { PointLight } from "../core/indirect.ts";
import type { Mesh } from "../core/surface.ts";
import { length, type Vector } from "../core/vector.ts";
import { lookAt, type Matrix, perspective, product } from "./matrix.ts";
import type { Orbit } from "./orbit.ts";
import { DEPTH_FRAGMENT, DEPTH_VERTEX, FRAGMENT, LIGHTS, VERTEX } from "./shaders.ts";

const SHADOW_SIZE = 2048;
const LIFT = 0.05; // voxels along the normal where shadows are looked up
const GREY = 0.42;
const FINE = 9; // samples along each side of a pixel that is measured
const CREASE = 0.35; // difference of neighbouring normals
// Modes of the shader.
const SHOWN = 0;
const RADIANCE = 1;
const FACING = 2;
const ATTRIBUTES = ["position", "normal", "color", "shading", "indirect"] as const;
type Attribute = (typeof ATTRIBUTES)[number];

/** What a context holds, and loses with it. */
interface Held {
  paint: WebGLProgram;
  cast: WebGLProgram;
  shadows: WebGLTexture;
  target: WebGLFramebuffer;
  object: WebGLVertexArrayObject;
  buffers: Map<Attribute, WebGLBuffer>;
  triangles: WebGLBuffer;
}

export class View {
  private readonly gl: WebGL2RenderingContext;
  private held: Held;
  private readonly values = new Map<Attribute, Float32Array>();
  private index: Uint32Array = new Uint32Array();
  private corners = 0;
  private vertices = 0;
  private lights: PointLight[] = [];
  private lightMatrices: Matrix[] = [];
  private mark: [number, number, number, number] = [0, 0, 0, 0];
  private surface = { roughness: 0.6, metallic: 0 };
  private lift = 0;
  private radius = 1; // of a ball around the object
  private stale = true;
  private unshadowed = true;

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly orbit: Orbit,
    private readonly accent: Vector,
    /** The browser took the picture away, or gave it back. */
    lost: (away: boolean) => void,
  ) {
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl)
      throw new Error(
        "The picture needs WebGL 2, which this browser lacks: turn on hardware acceleration, or use another browser.",
      );
    this.gl = gl;
    this.held = held(gl);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // else it is never restored
      lost(true);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.restore();
      lost(false);
    });
  }

  private restore(): void {
    this.held = held(this.gl);
    for (const [name, values] of this.values) this.fill(name, values);
    this.join(this.index);
    this.changed();
  }

  get aspect(): number {
    return this.canvas.width / Math.max(this.canvas.height, 1);
  }

  private fill(name: Attribute, values: Float32Array): void {
    const { gl } = this;
    this.values.set(name, values);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.held.buffers.get(name)!);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    this.stale = true;
  }

  /** Join vertices to triangles. */
  private join(index: Uint32Array): void {
    const { gl } = this;
    this.index = index;
    this.corners = index.length;
    gl.bindVertexArray(this.held.object);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.held.triangles);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    this.unshadowed = true;
  }

  /** Show a shape in grey. */
  show(mesh: Mesh, spacing: number): void {
    this.vertices = mesh.position.length;
    this.lift = LIFT * spacing;
    this.radius = farthest(mesh.position);
    this.surface = { roughness: 0.6, metallic: 0 };
    this.mark = [0, 0, 0, 0];
    this.fill("position", mesh.position);
    this.fill("normal", mesh.normal);
    this.fill("color", new Float32Array(this.vertices).fill(GREY));
    this.fill("shading", mesh.normal);
    this.fill("indirect", new Float32Array(this.vertices));
    this.join(mesh.index);
  }

  /** Give the vertices base colours and shading normals. */
  dress(color: Float32Array, shading: Float32Array, roughness: number, metallic: number): void {
    if (color.length !== this.vertices) return;
    this.surface = { roughness, metallic };
    this.fill("color", color);
    this.fill("shading", shading);
  }

  /** Give the vertices indirect radiance. */
  bounce(indirect: Float32Array): void {
    if (indirect.length === this.vertices) this.fill("indirect", indirect);
  }

  /** Mark a point of the surface by a ring. */
  point(place: Vector, radius: number): void {
    this.mark = [...place, radius];
    this.stale = true;
  }

  light(lights: PointLight[]): void {
    this.lights = lights.slice(0, LIGHTS);
    this.stale = this.unshadowed = true;
  }

  /** Draw the shadow maps, if lights or object changed. */
  private shade(): void {
    const { gl, radius } = this;
    if (!this.unshadowed || !this.corners) return;
    this.unshadowed = false;
    this.lightMatrices = this.lights.map(({ position }) => {
      const far = length(position);
      const tangent = far > radius * 1.02 ? Math.tan(Math.asin(radius / far)) : 4;
      return product(
        perspective(tangent, 1, Math.max(far - radius, 0.02), far + radius),
        lookAt(position, [0, 0, 0]),
      );
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.held.target);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.useProgram(this.held.cast);
    gl.bindVertexArray(this.held.object);
    // The object's far side casts the shadows: what is lit cannot shade itself by inexact depths.
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.FRONT);
    this.lightMatrices.forEach((matrix, k) => {
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, this.held.shadows, 0, k);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix4fv(gl.getUniformLocation(this.held.cast, "camera"), false, matrix);
      gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
    });
    gl.disable(gl.CULL_FACE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  changed(): void {
    this.stale = true;
  }

  /** Draw, if anything changed. */
  draw(): void {
    if (!this.stale || this.gl.isContextLost()) return;
    this.stale = false;
    this.shade();
    this.paintInto(this.canvas.width, this.canvas.height, SHOWN);
  }

  private paintInto(width: number, height: number, mode: number): void {
    const { gl, orbit } = this;
    const { paint } = this.held;
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!this.corners) return;
    const { eye } = orbit;
    const [, high] = orbit.extent(width / height);
    const far = length(eye) + this.radius;
    const projection = perspective(high, width / height, Math.max(length(eye) - this.radius, 0.01), far);
    gl.useProgram(paint);
    const at = (name: string) => gl.getUniformLocation(paint, name);
    gl.uniformMatrix4fv(at("camera"), false, product(projection, lookAt(eye, [0, 0, 0])));
    gl.uniform3fv(at("eye"), eye);
    gl.uniform3fv(at("accent"), this.accent);
    gl.uniform1i(at("count"), this.lights.length);
    gl.uniform1f(at("roughness"), this.surface.roughness);
    gl.uniform1f(at("metallic"), this.surface.metallic);
    gl.uniform1f(at("texel"), 1 / SHADOW_SIZE);
    gl.uniform1f(at("lift"), this.lift);
    gl.uniform1i(at("mode"), mode);
    gl.uniform4fv(at("mark"), this.mark);
    this.lights.forEach(({ position, color }, k) => {
      gl.uniform3fv(at(`lights[${k}]`), position);
      gl.uniform3fv(at(`intensities[${k}]`), color);
      gl.uniformMatrix4fv(at(`lightMatrices[${k}]`), false, this.lightMatrices[k]);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.held.shadows);
    gl.uniform1i(at("shadows"), 0);
    gl.bindVertexArray(this.held.object);
    gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
  }

  /** Return whether the picture shows the object at a pixel of the page. */
  covers(x: number, y: number): boolean {
    const { gl, canvas } = this;
    const box = canvas.getBoundingClientRect();
    const pixel = new Uint8Array(4);
    this.draw();
    const column = Math.floor(((x - box.left) / box.width) * canvas.width);
    const row = Math.floor((1 - (y - box.top) / box.height) * canvas.height);
    gl.readPixels(column, row, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return pixel[3] > 127;
  }

  /**
   * Return linear radiance and coverage, (size, size, 4), premultiplied, sampled as in the library.
   *
   * The colour of a pixel is that at its centre. Where a silhouette, a crease or the edge of a shadow crosses it,
   * it is the mean of the 3 x 3 samples that meet the object, and coverage is the share of `FINE` x `FINE`.
   */
  capture(size: number): Float32Array {
    this.shade();
    const wide = size * FINE;
    const fine = this.samples(wide, RADIANCE);
    const crossed = edges(this.samples(size, FACING), size);
    const out = new Float32Array(4 * size * size);
    const [first, middle] = [(FINE / 3 - 1) / 2, (FINE - 1) / 2];
    for (let y = 0; y < size; y++)
      for (let x = 0; x < size; x++) {
        const to = 4 * (y * size + x);
        const at = (i: number, j: number) => 4 * ((wide - 1 - (y * FINE + i)) * wide + x * FINE + j);
        let covered = 0;
        for (let i = 0; i < FINE; i++) for (let j = 0; j < FINE; j++) covered += fine[at(i, j) + 3];
        if (!covered) continue;
        const alpha = covered / FINE ** 2;
        const sum = [0, 0, 0, 0];
        const add = (from: number) => {
          for (let c = 0; c < 4; c++) sum[c] += fine[from + c];
        };
        if (alpha < 1 || crossed[(size - 1 - y) * size + x])
          for (let n = 0; n < 9; n++)
            add(at(first + (FINE / 3) * Math.floor(n / 3), first + (FINE / 3) * (n % 3)));
        else add(at(middle, middle));
        if (!sum[3]) continue;
        for (let c = 0; c < 3; c++) out[to + c] = (alpha * sum[c]) / sum[3];
        out[to + 3] = alpha;
      }
    return out;
  }

  /** Draw what a shader's mode shows into a square of samples, lowest row first. */
  private samples(wide: number, mode: number): Float32Array {
    const { gl } = this;
    if (!gl.getExtension("EXT_color_buffer_float"))
      throw new Error(
        "The picture needs WebGL with floating-point textures, which this browser lacks: use another browser.",
      );
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    const stores = [
      [gl.COLOR_ATTACHMENT0, gl.RGBA32F],
      [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24],
    ].map(([place, format]) => {
      const store = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, store);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, wide, wide);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, store);
      return store;
    });
    this.paintInto(wide, wide, mode);
    const fine = new Float32Array(4 * wide * wide);
    gl.readPixels(0, 0, wide, wide, gl.RGBA, gl.FLOAT, fine);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    for (const store of stores) gl.deleteRenderbuffer(store);
    return fine;
  }
}

/** Return the largest distance of positions from the centre. */
function farthest(position: Float32Array): number {
  let most = 0;
  for (let k = 0; k < position.length; k += 3)
    most = Math.max(most, position[k] ** 2 + position[k + 1] ** 2 + position[k + 2] ** 2);
  return Math.sqrt(most);
}

/** Return which pixels differ from one of their neighbours in what they face or in whether they are lit. */
function edges(facing: Float32Array, size: number): Uint8Array {
  const crossed = new Uint8Array(size * size);
  for (let y = 0; y < size; y++)
    for (let x = 0; x < size; x++)
      for (const [down, right] of [
        [0, 1],
        [1, 0],
        [1, 1],
        [1, -1],
      ]) {
        if (y + down >= size || x + right < 0 || x + right >= size) continue;
        const [one, other] = [y * size + x, (y + down) * size + x + right];
        for (let c = 0; c < 4; c++)
          if (Math.abs(facing[4 * one + c] - facing[4 * other + c]) > CREASE)
            crossed[one] = crossed[other] = 1;
      }
  return crossed;
}

/** Make what draws in a context. */
function held(gl: WebGL2RenderingContext): Held {
  const [paint, cast] = [program(gl, VERTEX, FRAGMENT), program(gl, DEPTH_VERTEX, DEPTH_FRAGMENT)];
  const object = gl.createVertexArray();
  const triangles = gl.createBuffer();
  const buffers = new Map(ATTRIBUTES.map((name) => [name, gl.createBuffer()]));
  gl.bindVertexArray(object);
  ATTRIBUTES.forEach((name, place) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.get(name)!);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
  const shadows = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, shadows);
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE, LIGHTS);
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
    [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE],
    [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
  ])
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, value);
  gl.enable(gl.DEPTH_TEST);
  return { paint, cast, shadows, target: gl.createFramebuffer(), object, buffers, triangles };
}

function program(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
  const made = gl.createProgram();
  for (const [kind, source] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS))
      throw new Error(`The picture cannot be drawn: ${gl.getShaderInfoLog(shader)}`);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}
