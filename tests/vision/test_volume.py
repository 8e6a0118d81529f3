"""Volume rendering against integrals that are known."""

import math

import numpy as np
import pytest
import torch

from objectfolder.vision.cameras import sphere_points
from objectfolder.vision.volume import Rays, opacity, resample, sample_strata, transmittance, visibility


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(3)


def rays(near, far, count=1):
    """Along x from the origin, in double precision."""
    ends = [torch.full((count,), float(end), dtype=torch.float64) for end in (near, far)]
    direction = torch.tensor([[1.0, 0, 0]], dtype=torch.float64).expand(count, 3)
    return Rays(torch.zeros_like(direction), direction, *ends)


def test_chords_of_a_cube_average_to_four_volumes_per_surface():
    """Cauchy: over uniform isotropic lines the mean chord is 4 V / S, and the shadow is S / 4."""
    rng = np.random.default_rng(0)
    direction = sphere_points(200_000, 1.0, rng)
    side = np.cross(direction, np.roll(direction, 1, 1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    disc = rng.uniform(-1, 1, (2, len(direction), 1))  # a square of 2 x 2 holds every shadow
    origin = disc[0] * side + disc[1] * np.cross(direction, side) - 3 * direction
    cut = Rays.through_cube(torch.from_numpy(origin), torch.from_numpy(direction), 0.5)
    chord = (cut.far - cut.near).clamp(min=0)
    assert 4 * (chord > 0).double().mean().item() == pytest.approx(6 / 4, rel=0.01)
    assert chord[chord > 0].mean().item() == pytest.approx(4 / 6, rel=0.01)
    ends = cut[chord > 0]
    for distance in (ends.near, ends.far):
        reached = ends.points(distance[:, None])[:, 0].abs().amax(1)
        torch.testing.assert_close(reached, torch.full_like(reached, 0.5))


def test_rays_along_a_face_beside_and_behind_the_cube_and_from_inside():
    origin = torch.tensor([[-2.0, 0.1, 0], [-2, 0.6, 0], [2, 0, 0], [0.2, 0, 0], [-2, 0.5, 0]])
    cut = Rays.through_cube(origin, torch.tensor([[1.0, 0, 0]]).expand(5, 3), 0.5)
    assert (cut.far > cut.near)[:4].tolist() == [True, False, False, True]
    torch.testing.assert_close(cut.near[[0, 3]], torch.tensor([1.5, 0.0]))
    torch.testing.assert_close(cut.far[[0, 3]], torch.tensor([2.5, 0.3]))
    assert not (cut.near.isnan() | cut.far.isnan()).any()


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_a_slab_of_constant_density_lets_through_exp_of_its_depth(count, generator):
    """Whatever the number of samples and wherever they are: the intervals fill the slab."""
    ray, sigma = rays(1, 1.8, 50), 2.5
    distance = sample_strata(ray.near, ray.far, count, generator)
    lengths = ray.intervals(distance).diff()
    assert (lengths > 0).all()
    density = torch.full_like(distance, sigma)
    through = transmittance(density, lengths)
    exact = torch.full((50,), math.exp(-sigma * 0.8), dtype=torch.float64)
    torch.testing.assert_close(through[:, -1], exact)
    torch.testing.assert_close(1 - visibility(density, lengths).sum(1), exact)
    starts = ray.intervals(distance)[:, :-1]
    torch.testing.assert_close(through[:, :-1], torch.exp(-sigma * (starts - 1)))
    torch.testing.assert_close(through[:, 1:], through[:, :-1] * (1 - opacity(density, lengths)))


def test_seen_colour_converges_with_the_square_of_the_interval():
    """Density 3 t and colour t: transmittance exp(-3 t^2 / 2), so the pixel is an error function."""
    exact = math.sqrt(math.pi / 6) * math.erf(math.sqrt(1.5)) - math.exp(-1.5)
    errors = []
    for count in (16, 32, 64, 128):
        ray = rays(0, 1)
        t = sample_strata(ray.near, ray.far, count)
        pixel = (visibility(3 * t, ray.intervals(t).diff()) * t).sum().item()
        errors.append(abs(pixel - exact))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.9).all()
    assert errors[-1] < 1e-4


def test_an_opaque_wall_hides_what_is_behind_it():
    density = torch.tensor([[0.0, 1e9, 5.0, 1e9]])
    weights = visibility(density, torch.full((1, 4), 0.1))
    torch.testing.assert_close(weights, torch.tensor([[0.0, 1, 0, 0]]), rtol=0, atol=0)


def test_stratified_samples_have_one_in_each_part(generator):
    low, high = torch.tensor([0.0, 2.0]), torch.tensor([1.0, 6.0])
    middle = sample_strata(low, high, 4)
    torch.testing.assert_close(middle, torch.tensor([[0.125, 0.375, 0.625, 0.875], [2.5, 3.5, 4.5, 5.5]]))
    samples = torch.stack([sample_strata(low, high, 4, generator) for _ in range(4000)])
    part = ((samples - low[:, None]) / (high - low)[:, None] * 4).floor()
    assert (part == torch.arange(4)).all()
    offset = samples - middle
    torch.testing.assert_close(offset.mean(0), torch.zeros(2, 4), rtol=0, atol=0.03)
    variance = torch.tensor([[0.25**2 / 12], [1 / 12]]).expand(2, 4)
    torch.testing.assert_close(offset.var(0), variance, rtol=0.1, atol=0)


@pytest.mark.parametrize("random", [False, True])
def test_importance_samples_follow_the_weights(random, generator):
    ends = torch.tensor([[0.0, 1.0, 1.5, 4.0, 5.0]])
    weights = torch.tensor([[0.1, 0.0, 0.3, 0.4]])
    samples = resample(ends, weights, 1000, generator if random else None, floor=0)
    assert (samples.diff() >= 0).all()
    counts = torch.histogram(samples[0], ends[0]).hist
    torch.testing.assert_close(counts, weights[0] / 0.8 * 1000, rtol=0, atol=1.0)
    inside = samples[(samples > 1.5) & (samples < 4)]  # uniform within an interval
    assert inside.mean().item() == pytest.approx(2.75, abs=0.01)
    assert inside.var().item() == pytest.approx(2.5**2 / 12, rel=0.02)


def test_importance_samples_of_a_density_find_its_quantiles():
    """Of an exponential decay, cut off at 3: t(u) = -log(1 - u (1 - exp(-3)))."""
    ray = rays(0, 3)
    t = sample_strata(ray.near, ray.far, 400)
    ends = ray.intervals(t)
    weights = visibility(torch.ones_like(t), ends.diff())
    u = (torch.arange(50, dtype=torch.float64) + 0.5) / 50
    exact = -torch.log1p(-u * (1 - math.exp(-3)))
    torch.testing.assert_close(resample(ends, weights, 50, floor=0)[0], exact, rtol=0, atol=1e-4)


def test_rows_without_weight_are_sampled_uniformly_and_all_weight_may_be_in_one_interval():
    ends = torch.tensor([[0.0, 1, 3], [0, 1, 3]])
    samples = resample(ends, torch.tensor([[0.0, 0], [0, 1]]), 8)
    torch.testing.assert_close(samples[0], torch.tensor([0.125, 0.375, 0.625, 0.875, 1.25, 1.75, 2.25, 2.75]))
    assert ((samples[1] >= 1) & (samples[1] <= 3)).all()
