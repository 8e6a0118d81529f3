import { describe, expect, it } from "vitest";
import { ambiguousFaces, EDGES, outlines, triangles } from "../core/cubes.ts";
import { BOUND } from "../core/grid.ts";
import { Nearest } from "../core/nearest.ts";
import { type Mesh, surface } from "../core/surface.ts";
import type { Vector } from "../core/vector.ts";
import { ball, box, RADIUS } from "./shapes.ts";

/**
 * Volume, and the number of edges that do not join two triangles in opposite directions.
 *
 * @param split whether vertices have copies, one for each side of an edge
 */
function measured({ position, index }: Mesh, split = false): { volume: number; open: number } {
  const edges = new Map<string, number>();
  let volume = 0;
  const first = new Map<string, number>();
  const place = Array.from({ length: position.length / 3 }, (_, v) => {
    const key = split ? position.subarray(3 * v, 3 * v + 3).join() : `${v}`;
    if (!first.has(key)) first.set(key, v);
    return first.get(key)!;
  });
  for (let t = 0; t < index.length; t += 3) {
    const corners = [...index.subarray(t, t + 3)];
    const [a, b, c] = corners.map((v) => [...position.subarray(3 * v, 3 * v + 3)]);
    volume +=
      (a[0] * (b[1] * c[2] - b[2] * c[1]) +
        a[1] * (b[2] * c[0] - b[0] * c[2]) +
        a[2] * (b[0] * c[1] - b[1] * c[0])) /
      6;
    corners.forEach((v, n) => {
      const [one, other] = [v, corners[(n + 1) % 3]].map((k) => place[k]);
      const key = one < other ? `${one} ${other}` : `${other} ${one}`;
      edges.set(key, (edges.get(key) ?? 0) + (one < other ? 1 : -1));
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

describe("triangles of cells", () => {
  it("are bounded by the outlines", () => {
    let known = 0;
    for (let code = 1; code < 255; code++) {
      const divided = triangles(code);
      if (!divided) continue;
      known++;
      const sides = new Map<string, number>();
      divided.forEach((from, n) => {
        const to = divided[n % 3 === 2 ? n - 2 : n + 1];
        const back = `${to} ${from}`;
        if (sides.get(back)) sides.delete(back);
        else sides.set(`${from} ${to}`, 1);
      });
      const border = outlines(code, () => false).flatMap((loop) =>
        loop.map((edge, n) => `${edge} ${loop[(n + 1) % loop.length]}`),
      );
      expect([...sides.keys()].sort()).toEqual(border.sort());
    }
    expect(known).toBe(130);
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
    const sharp = measured(surface(grid, { crossings: new Map(), points, sheets: [], moved: new Map() }));
    const round = measured(surface(grid));
    const exact = 8 * half[0] * half[1] * half[2];
    expect(sharp.volume).toBeGreaterThan(round.volume);
    expect(Math.abs(sharp.volume - exact)).toBeLessThan(0.5 * Math.abs(round.volume - exact));
  });

  it("of a board between the samples is closed and has its volume", () => {
    const count = 64;
    const half: [number, number, number] = [0.3, 0.25, 0.003];
    const grid = box(count, half);
    expect(surface(grid).index.length).toBe(0);
    const place = (n: number) => n * grid.spacing - BOUND;
    const sheets: number[] = [];
    const moved = new Map<number, [number, number, number]>();
    const layer = count / 2; // half a voxel above the middle of the board
    const within = (i: number, j: number) => Math.abs(place(i)) < half[0] && Math.abs(place(j)) < half[1];
    const index = (x: number) => (x + BOUND) / grid.spacing;
    for (let i = 1; i < count - 1; i++)
      for (let j = 1; j < count - 1; j++) {
        if (!within(i, j)) continue;
        const sample = (i * count + j) * count + layer;
        sheets.push(sample);
        moved.set(3 * sample + 2, [i, j, index(half[2])]);
        moved.set(3 * (sample - 1) + 2, [i, j, index(-half[2])]);
        for (const way of [-1, 1]) {
          const low = Math.min(way, 0);
          if (!within(i + way, j))
            moved.set(3 * (sample + low * count ** 2), [index(way * half[0]), j, index(0)]);
          if (!within(i, j + way))
            moved.set(3 * (sample + low * count) + 1, [i, index(way * half[1]), index(0)]);
        }
      }
    const features = { crossings: new Map(), points: new Map(), sheets, moved };
    const { volume, open } = measured(surface(grid, features), true);
    expect(open).toBe(0);
    expect(volume / (8 * half[0] * half[1] * half[2])).toBeCloseTo(1, 1);
    const nearest = new Nearest(grid, surface(grid, features), features);
    for (const point of [
      [0.1, -0.2, half[2]],
      [-0.25, 0.07, -half[2]],
    ] as Vector[]) {
      expect(Math.hypot(...nearest.to(point).map((c, axis) => c - point[axis]))).toBeLessThan(1e-6);
      expect(Math.abs(grid.nearest(point)[2] - point[2])).toBeGreaterThan(1e-4);
    }
  });
});
