import { describe, expect, it } from "vitest";
import { csv, plan } from "../listening/plan.ts";

describe("a listener's trials", () => {
  it("hold every pair once, with each method first in half of them", () => {
    for (const pairs of [1, 2, 15, 16])
      for (let listener = 0; listener < 50; listener++) {
        const trials = plan(pairs, `${listener}`, 0);
        expect(trials.map(({ pair }) => pair).sort((a, b) => a - b)).toEqual([...Array(pairs).keys()]);
        const swapped = trials.filter((trial) => trial.swapped).length;
        expect(Math.abs(swapped - pairs / 2)).toBeLessThanOrEqual(pairs % 2 ? 0.5 : 0);
      }
  });
  it("come in an order that is uniformly random over listeners, and the same for one", () => {
    const counts = Array.from({ length: 8 }, () => [0, 0]);
    for (let listener = 0; listener < 4000; listener++) {
      const [first] = plan(8, `listener ${listener}`, 1);
      counts[first.pair][Number(first.swapped)]++;
    }
    // 250 expected in each of 16 cells: chi-squared with 15 degrees of freedom, below its 99.9 % quantile.
    expect(counts.flat().reduce((sum, n) => sum + (n - 250) ** 2 / 250, 0)).toBeLessThan(37.7);
    expect(plan(8, "a", 1)).toEqual(plan(8, "a", 1));
    expect(plan(8, "a", 1)).not.toEqual(plan(8, "a", 2));
  });
});

it("CSV quotes what needs it", () => {
  expect(csv(["a", "b"], [['say "x", y', 2]])).toBe('a,b\n"say ""x"", y",2\n');
  expect(csv(["a", "b"], [["=1", '"+1;@x']])).toBe('a,b\n\'=1,"\'""+1;\'@x"\n');
  expect(csv(["a", "b"], [[-1, "a-b=c"]])).toBe("a,b\n-1,a-b=c\n");
});
