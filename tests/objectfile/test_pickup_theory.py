"""Contact microphones on a beam and a plate, free at all edges, whose vibration is known.

Two errors are kept apart: that of the frequencies, which the finite elements have, and all others, of the
mode shapes (finite elements, net, surface) and of the query. Both are below 1 %.
"""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg
import trimesh
from brick import build_small
from numpy.polynomial import legendre
from scipy import optimize, special
from solids import box

from objectfolder.base.materials import material
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.modal import Request
from objectfolder.sound.net_settings import GainsConfig

STEEL, LENGTH, RATE = material("steel"), 0.3, 48000  # m, Hz
CONTACT, DURATION = 2e-4, 0.03  # s
E, RHO, NU = STEEL.youngs_modulus, STEEL.density, STEEL.poisson_ratio


NET = GainsConfig(
    modes=14, resolution=4, channels=1, width=32, features=200, most_features=200, frequency=4.0, steps=300,
    learning_rate=5e-3, grid_rate=1.0,
)  # fmt: skip

BODIES = pytest.mark.parametrize("name", ["beam", pytest.param("disc", marks=pytest.mark.slow)])


@dataclass(frozen=True)
class Theory:
    """Modes that move along z, ascending, and the file of the same body."""

    file: ObjectFile
    points: np.ndarray  #: (P, 3) m, on the top
    hertz: np.ndarray  #: (M,) natural frequencies
    shapes: np.ndarray  #: (P, M) at the points along z, kg^-1/2

    @property
    def rows(self):
        """Of the file's modes those that move the points along z; the others turn or bend them sideways."""
        moves = np.square(self.file.mode_shapes(self.points)[:, 2]).mean(0)
        rows = np.flatnonzero(moves > 0.01 * moves.max())
        assert len(rows) == len(self.hertz)
        return rows


def bending(thick, count, degree=24):
    """Frequencies, Hz m, and shapes of a free bar of length 1 by Timoshenko's theory; Legendre series."""
    shear = 10 * (1 + NU) / (12 + 11 * NU) / (2 * (1 + NU))  # of the modulus; Cowper's coefficient
    x, w = legendre.leggauss(2 * degree)
    value = legendre.legvander(x, degree - 1)
    slope = 2 * np.stack([legendre.legval(x, legendre.legder(u)) for u in np.eye(degree)], 1)

    def inner(a, b):
        return (a * w[:, None] / 2).T @ b

    bend, cross = thick**2 / 12, -shear * inner(slope, value)
    turned = shear * inner(value, value) + bend * inner(slope, slope)
    stiffness = np.block([[shear * inner(slope, slope), cross], [cross.T, turned]])
    mass = scipy.linalg.block_diag(inner(value, value), bend * inner(value, value))
    values, vectors = scipy.linalg.eigh(stiffness, mass)
    bends = slice(2, 2 + count)  # after two of the rigid bar
    hertz = np.sqrt(values[bends] * E / RHO) / (2 * np.pi)
    return hertz, lambda x: legendre.legvander(2 * x, degree - 1) @ vectors[:degree, bends]


def edge(n, k):
    """Moment and Kirchhoff's shear force at the edge r = 1 of J_n(k r) and of I_n(k r), for cos(n angle)."""
    found = []
    for f, derivative, sign in ((special.jv, special.jvp, -1), (special.iv, special.ivp, 1)):
        value, slope = f(n, k), k * derivative(n, k)
        curved = sign * k**2 * value - slope + n**2 * value
        moment = curved + NU * (slope - n**2 * value)
        found.append((moment, sign * k**2 * slope + (1 - NU) * n**2 * (value - slope)))
    return found


def disc_modes(thick, most, diameters=8):
    """Nodal diameters, frequencies, Hz m, and radial shapes of a free disc of radius 1 by Kirchhoff's theory.

    W = J_n(k r) + C I_n(k r); moment and shear force vanish at the edge (Leissa, Vibration of Plates, 1969,
    chapter 2.1.3). k is at most ``most``.
    """

    def determinant(k, n):
        (moment, force), (of_i, also) = edge(n, k)
        return (moment * also - of_i * force) / special.iv(n, k) ** 2

    found, k = [], np.linspace(1.5, most, 500)
    for n in range(diameters):
        values = determinant(k, n)
        for i in np.flatnonzero(values[1:] * values[:-1] < 0):
            root = optimize.brentq(determinant, k[i], k[i + 1], (n,))
            (moment, _), (of_i, _) = edge(n, root)
            found.append(
                (
                    root**2 * thick * np.sqrt(E / (12 * RHO * (1 - NU**2))) / (2 * np.pi),
                    n,
                    root,
                    -moment / of_i,
                )
            )
    return sorted(found)


@pytest.fixture(scope="module")
def beam():
    """300 mm x 12 mm x 7.5 mm of steel; points on the middle of its top."""
    thick, wide = 0.025, 0.04
    solid = box((1, wide, thick))
    file = build_small(
        "beam", solid, cut_cells(*solid, 20, 8), Request(STEEL, LENGTH, 5000.0, 14), NET, 900, 0
    )
    hertz, shapes = bending(thick, 4)
    x = np.array([-0.46, -0.37, -0.21, 0.03, 0.16, 0.44])
    points = np.stack([x, 0 * x, 0 * x + thick / 2], 1) * LENGTH
    return Theory(file, points, hertz / LENGTH, shapes(x) / np.sqrt(RHO * wide * thick * LENGTH**3))


@pytest.fixture(scope="module")
def disc():
    """A plate of steel, 300 mm wide and 6 mm thick."""
    thick, around = 0.02, 128
    mesh = trimesh.creation.cylinder(
        np.sqrt(np.pi / (around / 2 * np.sin(2 * np.pi / around))) / 2, thick, around
    )
    solid = np.array(mesh.vertices), np.array(mesh.faces, np.int64)
    file = build_small(
        "disc", solid, cut_cells(*solid, 16, 8), Request(STEEL, LENGTH, 900.0, 14), NET, 900, 0
    )
    rng, r = np.random.default_rng(1), np.array([0.0, 0.3, 0.5, 0.7, 0.9, 0.97])
    turn = rng.uniform(0, 2 * np.pi, len(r))
    hertz, shapes = [], []
    s, w = legendre.leggauss(40)
    s, w = (s + 1) / 2, w / 2
    for frequency, n, k, c in disc_modes(2 * thick, 3.6):

        def radial(r, n=n, k=k, c=c):
            return special.jv(n, k * r) + c * special.iv(n, k * r)

        mass = (
            RHO
            * thick
            * LENGTH
            * (LENGTH / 2) ** 2
            * (w * s * radial(s) ** 2).sum()
            * (np.pi if n else 2 * np.pi)
        )
        for around in (np.cos, np.sin)[: 2 if n else 1]:
            hertz.append(frequency / (LENGTH / 2))
            shapes.append(radial(r) * around(n * turn) / np.sqrt(mass))
    points = np.stack([r * np.cos(turn) / 2, r * np.sin(turn) / 2, 0 * r + thick / 2], 1) * LENGTH
    return Theory(file, points, np.array(hertz), np.stack(shapes, 1))


def accelerations(angular, damping, weights):
    """Sum of modes after half a sine of force of unit impulse, by quadrature; (N, samples), m/s^2.

    a = f + integral of f(u) h''(t - u) du with h = exp(-c t) sin(w t) / w.
    """
    time, (x, w) = np.arange(round(RATE * DURATION)) / RATE, legendre.leggauss(24)
    lasts = np.minimum(time, CONTACT)[:, None]
    u, s = lasts * (x + 1) / 2, -damping + 1j * angular
    force = np.pi / (2 * CONTACT) * np.sin(np.pi * u / CONTACT)
    now = np.pi / (2 * CONTACT) * np.sin(np.pi * time / CONTACT) * (time < CONTACT)
    parts = [
        (force * w * lasts / 2 * (p**2 * np.exp(p * (time[:, None] - u))).imag).sum(1) / p.imag + now
        for p in s
    ]
    return weights @ np.array(parts)


@BODIES
def test_frequencies_are_those_of_the_theory(name, request):
    theory = request.getfixturevalue(name)
    assert theory.file.frequencies[theory.rows] == pytest.approx(theory.hertz, rel=0.01)


@BODIES
def test_a_contact_microphone_measures_what_the_theory_says(name, request):
    """Strikes and microphones at all pairs of points, with the frequencies of the file."""
    theory = request.getfixturevalue(name)
    strike, heard = (part.ravel() for part in np.indices((len(theory.points),) * 2))
    got = theory.file.impact(
        theory.points[strike], [[0, 0, 1.0]], RATE, DURATION, "acceleration", contact_time=CONTACT,
        pickup=theory.points[heard], axis=[[0, 0, 1]],
    )  # fmt: skip
    angular = theory.file.tuning().damped_frequency.numpy()[theory.rows]
    damping = STEEL.damping((2 * np.pi * theory.hertz) ** 2)
    expected = accelerations(angular, damping, theory.shapes[strike] * theory.shapes[heard])
    assert np.abs(got - expected).max() < 0.01 * np.abs(expected).max()
