"""Sound with gradients: the answers of `ObjectFile.impact`, and slopes beside central differences."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from central_differences import disagreement
from refusals import refused

from objectfolder import ObjectFile

HEARD = {"duration": 0.05}


@pytest.fixture(scope="module")
def mug():
    return ObjectFile.sample("mug")


@pytest.fixture(scope="module")
def strike(mug):
    rng = np.random.default_rng(0)
    return torch.from_numpy(mug.sample_surface(3, seed=1)), torch.from_numpy(rng.normal(size=(3, 3)))


@pytest.fixture(scope="module")
def sound(mug):
    return mug.torch(torch.float64).sound


@pytest.fixture(scope="module")
def weighted(sound, strike):
    """A number that sums a sound with random weights, relative to its size."""
    size = sound(*strike, **HEARD).norm()
    weights = torch.randn(3, 800, generator=torch.Generator().manual_seed(2), dtype=torch.float64) / size

    def total(points=strike[0], forces=strike[1], **settings):
        return (sound(points, forces, **HEARD, **settings) * weights).sum()

    return total


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"response": "acceleration", "sample_rate": 44100},
        {"response": "velocity", "contact_time": 0.0},
        {"material": "steel", "scale": 0.15, "striker": "rubber"},
    ],
)
def test_the_sound_is_that_of_impact(mug, strike, dtype, settings):
    points, forces = strike[0] * (settings.get("scale", mug.scale) / mug.scale), strike[1]
    expected = mug.impact(points, forces, duration=0.5, **settings)
    found = mug.torch(dtype).sound(points, forces, duration=0.5, **settings)
    assert found.dtype == dtype
    assert float((found - expected).norm() / expected.norm()) < 1e-5


def test_points_off_the_surface_are_projected_as_impact_does(mug, strike, sound):
    points = strike[0] * 1.01
    expected = mug.impact(points, strike[1], **HEARD)
    assert float((sound(points, strike[1], **HEARD) - expected).norm() / expected.norm()) < 1e-5


def test_slopes_along_impulse_point_contact_time_and_size(weighted, mug, strike):
    """Projection in single precision limits the differences by point and size."""
    assert disagreement(lambda forces: weighted(forces=forces), strike[1], 1e-3) < 1e-8
    assert disagreement(lambda points: weighted(points=points), strike[0], 2e-5) < 1e-2
    assert disagreement(lambda time: weighted(contact_time=time), torch.tensor(4.1e-4), 1e-9) < 1e-6

    def of_size(factor):  # the struck place stays the same
        return weighted(points=strike[0] * factor, scale=mug.scale * factor)

    assert disagreement(of_size, torch.tensor(1.0), 1e-4) < 1e-2


@pytest.mark.parametrize("name", ["youngs_modulus", "density", "alpha", "beta", "loss_factor"])
def test_slope_along_the_material(weighted, sound, name):
    own = sound.material
    if name in ("alpha", "beta"):
        own = replace(own, loss_factor=())

    def changed(factor):
        if name == "loss_factor":
            return replace(own, loss_factor=tuple((hertz, loss * factor) for hertz, loss in own.loss_factor))
        return replace(own, **{name: getattr(own, name) * factor})

    total = lambda factor: weighted(material=changed(factor))  # noqa: E731
    assert disagreement(total, torch.tensor(1.0), 1e-6) < 1e-5


def test_what_is_not_physical_is_refused(sound, strike):
    refused("youngs_modulus is -1", replace, sound.material, youngs_modulus=torch.tensor(-1.0))
    silent = replace(sound.material, loss_factor=(), alpha=torch.tensor(0.0), beta=0.0)
    for wrong, message in (
        ({"points": strike[0] + 1}, "off the surface"),
        ({"contact_time": -0.001}, r"contact time is -0\.001 s, expected 0 or more"),
        (
            {"contact_time": torch.tensor(1e-3), "striker": "wood"},
            "striker is 'wood', but contact_time says how",
        ),
        ({"sample_rate": 40000, "duration": 3600}, r"gradients of \d+ modes in 144,000,000 samples: needs"),
        ({"material": silent}, "an undamped object rings for ever"),
    ):
        refused(message, sound, **{"points": strike[0], "forces": strike[1]} | wrong)


def changed(own, stiffer, loss):
    return replace(own, youngs_modulus=own.youngs_modulus * stiffer, loss_factor=((1000.0, loss * 1e-3),))


def found_material(sound, strike, heard, stiffnesses, rate=16000):
    """Stiffness and loss factor, relative to a stiffness of 1 and a loss of 1e-3, that give a sound.

    A search of the sound's first 5 ms, then descent on ever longer parts of it.
    """
    own = sound.material

    def misfit(logarithms, samples):
        stuff, part = changed(own, *logarithms.exp()), heard[:, :samples]
        return ((sound(*strike, duration=samples / rate, material=stuff) - part) / part.norm()).square().sum()

    grid = torch.stack([stiffnesses.log(), torch.zeros_like(stiffnesses)], 1)
    with torch.no_grad():
        best = grid[torch.stack([misfit(row, 80) for row in grid]).argmin()]
    guess = best.clone().requires_grad_()
    for samples in (80, 320, 1280, 5120):
        steps = torch.optim.LBFGS([guess], max_iter=40, line_search_fn="strong_wolfe")

        def closure(steps=steps, samples=samples):
            steps.zero_grad()
            value = misfit(guess, samples)
            value.backward()
            return value

        steps.step(closure)
    return guess.detach().exp()


SEEDS = [1, pytest.param(0, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]


@pytest.mark.parametrize("seed", SEEDS)
def test_stiffness_and_loss_are_found_from_a_sound(mug, sound, seed):
    """From half to twice the stiffness; the sound has white noise 20 dB below it."""
    rng = np.random.default_rng(seed)
    strike = torch.from_numpy(mug.sample_surface(1, seed)), torch.from_numpy(rng.normal(size=(1, 3)))
    stiffer, loss = rng.uniform(0.5, 2), rng.uniform(0.5, 5)
    heard = sound(*strike, duration=0.32, material=changed(sound.material, stiffer, loss))
    noise = torch.from_numpy(rng.normal(size=heard.shape))
    noisy = heard + 0.1 * heard.norm() / noise.norm() * noise
    found = found_material(sound, strike, noisy, torch.logspace(-0.35, 0.35, 140).double())
    assert float(found[0]) == pytest.approx(stiffer, rel=1e-3)
    assert float(found[1]) == pytest.approx(loss, rel=0.05)


def test_copies_of_modules_answer_alike(mug, strike):
    modules = mug.torch()
    sound = copy.deepcopy(modules.sound)
    assert torch.equal(sound(*strike, **HEARD), modules.sound(*strike, **HEARD))
    for module in (modules.touch, modules.view):
        function, arguments = pickle.loads(pickle.dumps(module.__reduce__()))
        assert arguments[1:] == (torch.float32, type(module).__name__.lower())
        assert function.__name__ == "_again"
    touch = pickle.loads(pickle.dumps(modules.touch))
    assert torch.equal(touch(strike[0][:1]).force, modules.touch(strike[0][:1]).force)
    assert torch.equal(copy.deepcopy(modules).sound(*strike, **HEARD), sound(*strike, **HEARD))


def test_loss_factors_of_a_list_are_a_material_of_impact(mug, sound, strike):
    stuff = replace(sound.material, loss_factor=[(1000.0, 1e-3), (5000.0, 2e-3)])
    points, forces = (part.numpy() for part in strike)
    assert mug.impact(points, forces, material=stuff, **HEARD).any()
