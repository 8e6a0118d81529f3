import numpy as np
import pytest
import torch
from solids import isosurface, sphere, stored

from objectfolder.mesh.isosurface import Isosurface
from objectfolder.vision.radiosity import Radiosity
from objectfolder.vision.trace import SurfaceSamples, trace

RADIUS = 0.4  # of a cavity
REFLECTANCE = torch.tensor([0.8, 0.5, 0.1])


@pytest.fixture(scope="module")
def cavity():
    """A thick shell; its inner wall is a sphere seen from inside."""

    def distance(x, y, z):
        r = np.sqrt(x**2 + y**2 + z**2)
        return np.maximum(r - 0.49, RADIUS - r)

    return stored(distance, 96)


def gray(points: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    return REFLECTANCE.expand(len(points), 3)


def samples_in(surface: Isosurface, eye: list[float], light: torch.Tensor) -> SurfaceSamples:
    directions = np.random.default_rng(1).normal(size=(500, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return trace(surface, np.float32(eye), directions, light.numpy())


def around(radiosity: Radiosity, samples: SurfaceSamples, light: torch.Tensor):
    index, shown = radiosity.mirror(samples, samples.normals, light)
    mirrored = torch.zeros(len(samples.points), 3).index_copy_(0, index, shown)
    return radiosity.gather(samples, light), mirrored


@pytest.mark.parametrize("light", [[0, 0, 0], [0.15, 0.1, -0.1]])
def test_a_white_wall_of_a_sphere_reflects_the_mean_of_what_it_receives(cavity, light):
    # A sphere's wall gives every other part of it the same: the mean irradiance, wherever the light is.
    light = torch.tensor(light, dtype=torch.float32)
    samples = samples_in(cavity, [0.05, 0, 0], light)
    assert len(samples.points) == 500
    assert samples.lit.all()
    gathered, _ = around(Radiosity(cavity, gray), samples, light)
    expected = (REFLECTANCE + REFLECTANCE**2) / RADIUS**2  # two bounces
    assert (gathered.mean(0) / expected - 1).abs().max() < 0.02
    # Each patch counts the others with its own 81 rays.
    assert (gathered / expected - 1).abs().square().mean().sqrt() < 0.05


def test_the_wall_shows_in_a_mirror_what_it_gives_off(cavity):
    light = torch.zeros(3)
    samples = samples_in(cavity, [0.05, 0, 0], light)
    _, mirrored = around(Radiosity(cavity, gray), samples, light)
    expected = (REFLECTANCE + REFLECTANCE**2 + REFLECTANCE**3) / RADIUS**2
    torch.testing.assert_close(mirrored, expected.expand_as(mirrored), rtol=0.05, atol=0)


def test_a_convex_object_receives_nothing_from_itself(monkeypatch):
    ball = isosurface(sphere(0.45, 4), 64)
    light = torch.tensor([0.3, 0.5, 1.0])
    axis = np.float32([[-1, 0, 0], [-1, 0.1, 0], [-1, 0, 0.15]])
    samples = trace(ball, np.float32([2, 0, 0]), axis, light.numpy())
    radiosity, cast = Radiosity(ball, gray), []
    intersect = ball.caster.intersect
    monkeypatch.setattr(ball.caster, "intersect", lambda *rays: cast.append(len(rays[1])) or intersect(*rays))
    gathered, mirrored = around(radiosity, samples, light)
    assert sum(cast) == 0
    assert gathered.abs().max() < 1e-3
    assert mirrored.abs().max() == 0


def test_what_is_kept_of_lights_answers_as_if_it_were_new(cavity):
    """Of the same surface, built twice."""
    radiosity, again = (Radiosity(cavity, gray) for _ in range(2))
    lights = [torch.tensor([0.1, 0.1, z / 40]) for z in range(10)]
    samples = samples_in(cavity, [0.05, 0, 0], lights[0])
    first = [around(radiosity, samples, light) for light in lights]  # more than are kept
    for light, known in reversed(list(zip(lights, first))):
        for found in (around(radiosity, samples, light), around(again, samples, light)):
            assert all(torch.equal(a, b) for a, b in zip(found, known))
    assert not torch.equal(first[0][0], first[1][0])
