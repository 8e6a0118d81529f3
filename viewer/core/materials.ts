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

/** What strikes an object: a rounded tip, as objectfolder/sound/contact.py. */
export interface Striker {
  youngs_modulus: number; // Pa
  poisson_ratio: number;
  radius: number; // m
  mass: number; // kg
  speed: number; // m/s
}

/** Contact time over largest indentation times speed, of any Hertzian collision. */
const DURATION = 2.94327518;

/** Return how long a striker and an object of a mass, kg, touch, seconds: Hertz's elastic collision. */
export function contactTime(striker: Striker, material: Material, mass: number): number {
  const { radius, speed } = striker;
  const shared = 1 / (1 / striker.mass + 1 / mass);
  const soft = [striker, material].reduce(
    (sum, one) => sum + (1 - one.poisson_ratio ** 2) / one.youngs_modulus,
    0,
  );
  const indentation = ((15 * shared * speed ** 2 * soft) / (16 * Math.sqrt(radius))) ** 0.4;
  return (DURATION * indentation) / speed;
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
