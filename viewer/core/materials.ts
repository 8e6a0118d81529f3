/** Materials and their damping. */

export interface Material {
  name: string;
  density: number;
  youngs_modulus: number;
  poisson_ratio: number;
  alpha: number;
  beta: number;
  /** Pairs of a frequency in Hz and a loss factor; replaces alpha and beta. */
  loss_factor?: [number, number][];
}

/** Return the decay rate, 1/s, of a mode with an eigenvalue in rad^2/s^2. */
export function damping(material: Material, eigenvalue: number): number {
  const knots = material.loss_factor;
  if (!knots?.length) return (material.alpha + material.beta * eigenvalue) / 2;
  const angular = Math.sqrt(eigenvalue);
  const hertz = angular / (2 * Math.PI);
  let loss = knots[0][1];
  for (let n = 1; n < knots.length; n++) {
    const [low, start] = knots[n - 1];
    const [high, end] = knots[n];
    loss += ((end - start) / (high - low)) * (Math.min(Math.max(hertz, low), high) - low);
  }
  return (loss * angular) / 2;
}
