import { describe, expect, it } from "vitest";
import { ambiguousFaces, EDGES, outlines } from "../core/cubes.ts";
import { type Mesh, surface } from "../core/surface.ts";
import type { Vector } from "../core/vector.ts";
import { ball, box, RADIUS } from "./shapes.ts";

/** Volume, and the number of edges that do not join two triangles in opposite directions. */
function measured({ position, index }: Mesh): { volume: number; open: number } {
  const edges = new Map<string, number>();
  let volume = 0;
  for (let t = 0; t < index.length; t += 3) {
    const corners = [...index.subarray(t, t + 3)];
    const [a, b, c] = corners.map((v) => [...position.subarray(3 * v, 3 * v + 3)]);
    volume +=
      (a[0] * (b[1] * c[2] - b[2] * c[1]) +
        a[1] * (b[2] * c[0] - b[0] * c[2]) +
        a[2] * (b[0] * c[1] - b[1] * c[0])) /
      6;
    corners.forEach((v, n) => {
      const w = corners[(n + 1) % 3];
      const key = v < w ? `${v} ${w}` : `${w} ${v}`;
      edges.set(key, (edges.get(key) ?? 0) + (v < w ? 1 : -1));
    });
  }
  return { volume, open: [...edges.values()].filter((sum) => sum !== 0).length };
}

describe("outlines of cells", () => {
  it("cross every edge between inside and outside once, whatever is joined", () => {
    for (let code = 0; code < 256; code++)
      for (const join of ambiguousFaces(code).length ? [false, true] : [false]) {
        const crossed = outlines(code, () => join).flat();
        const expected = EDGES.flatMap(([corner, axis], edge) =>
          ((code >> corner) & 1) !== ((code >> (corner | (1 << axis))) & 1) ? [edge] : [],
        );
        expect([...crossed].sort((a, b) => a - b)).toEqual(expected);
      }
  });
});

describe("the surface", () => {
  it("of a ball is closed, faces outwards and has its volume", () => {
    const { volume, open } = measured(surface(ball()));
    expect(open).toBe(0);
    expect(volume / ((4 / 3) * Math.PI * RADIUS ** 3)).toBeCloseTo(1, 2);
  });

  it("is closed where faces of cells are ambiguous", () => {
    const grid = ball(24);
    for (let n = 0; n < grid.values.length; n++) grid.values[n] = ((n * 7919) % 255) - 127 || 1;
    const edge = (n: number) => n === 0 || n === 23;
    grid.values.forEach((_, n) => {
      if ([n % 24, Math.floor(n / 24) % 24, Math.floor(n / 576)].some(edge)) grid.values[n] = 127;
    });
    expect(measured(surface(grid)).open).toBe(0);
  });

  it("is met by rays where they meet the ball", () => {
    const grid = ball();
    for (let n = 0; n < 50; n++) {
      const angle = n / 8;
      const origin: Vector = [2 * Math.cos(angle), 2 * Math.sin(angle), n / 50 - 0.5];
      const size = Math.hypot(...origin);
      const direction = origin.map((c) => -c / size) as Vector;
      expect(Math.abs(grid.cast(origin, direction) - (size - RADIUS))).toBeLessThan(0.1 * grid.spacing);
      expect(grid.cast(origin, direction.map((c) => -c) as Vector)).toBe(Number.POSITIVE_INFINITY);
    }
  });

  it("of a box has sharp edges where its cells have points", () => {
    const half: [number, number, number] = [0.3, 0.25, 0.2];
    const grid = box(64, half);
    const points = new Map<number, [number, number, number]>();
    const index = (x: number) => (x + 0.52) / grid.spacing;
    for (let i = 0; i < 63; i++)
      for (let j = 0; j < 63; j++)
        for (let k = 0; k < 63; k++) {
          // The point of a cell that an edge of the box passes through lies on that edge.
          const place = [i, j, k].map((n, axis) => {
            const wall = [half[axis], -half[axis]].map(index).find((w) => w >= n && w < n + 1);
            return wall ?? null;
          });
          const inside = [i, j, k].every(
            (n, axis) => Math.abs(n + 0.5 - index(0)) * grid.spacing < half[axis] + grid.spacing,
          );
          if (!inside || place.filter((p) => p !== null).length < 2) continue;
          points.set(
            (i * 64 + j) * 64 + k,
            place.map((p, axis) => p ?? [i, j, k][axis] + 0.5) as [number, number, number],
          );
        }
    const sharp = measured(surface(grid, { crossings: new Map(), points }));
    const round = measured(surface(grid));
    const exact = 8 * half[0] * half[1] * half[2];
    expect(sharp.volume).toBeGreaterThan(round.volume);
    expect(Math.abs(sharp.volume - exact)).toBeLessThan(0.5 * Math.abs(round.volume - exact));
  });
});
