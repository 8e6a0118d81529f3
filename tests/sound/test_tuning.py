import dataclasses
import math

import numpy as np
import pytest
import torch
from solids import box

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import material
from objectfolder.sound.fem.cutcell import cut_cells
from objectfolder.sound.fem.modal import Request, modal_analysis, solved_band
from objectfolder.sound.tuning import retune, stored_modes

SOLID = box((1, 0.55, 0.3))
GLASS = material("glass")
#: Glass with the stiffness, density and damping of wood.
SOFT = dataclasses.replace(material("wood"), poisson_ratio=GLASS.poisson_ratio)
BAND = (0.0, 20000.0)


@pytest.fixture(scope="module")
def solve():
    cells = cut_cells(*SOLID, 6, 4)

    def modes(stuff, scale, max_frequency=20000.0, max_modes=30):
        request = Request(stuff, scale, max_frequency, max_modes)
        data = modal_analysis(cells, SOLID[0], request)
        return data, solved_band(data, request)

    return modes


def tensors(data):
    return torch.from_numpy(data.damped_frequency), torch.from_numpy(data.damping)


@pytest.mark.parametrize(("stuff", "scale"), [(GLASS, 0.13), (SOFT, 0.2), (SOFT, 0.35)])
def test_it_is_what_a_solve_finds(solve, stuff, scale):
    stored, band = solve(GLASS, 0.2)
    again, _ = solve(stuff, scale)
    tuned = retune(*tensors(stored), band, (GLASS, 0.2), (stuff, scale))
    shared = min(len(tuned.modes), len(again.damping))
    assert shared >= 4
    np.testing.assert_allclose(tuned.damped_frequency[:shared], again.damped_frequency[:shared], rtol=1e-6)
    np.testing.assert_allclose(tuned.damping[:shared], again.damping[:shared], rtol=1e-6)
    shapes = stored.shapes[:, :, tuned.modes.numpy()[:shared]] * tuned.shape_factor
    np.testing.assert_allclose(shapes, again.shapes[:, :, :shared], atol=1e-6 * np.abs(again.shapes).max())
    # Everything up to the stated frequency is there.
    natural = np.sqrt(again.eigenvalues) / (2 * np.pi)
    assert (natural < tuned.complete_hz[1]).sum() <= len(tuned.modes)


def test_modes_that_leave_the_range_of_hearing_are_left_out(solve):
    stored, band = solve(GLASS, 0.2, max_modes=500)
    assert not stored.report["truncated"]
    tuned = retune(*tensors(stored), band, (GLASS, 0.2), (GLASS, 0.1))
    again, _ = solve(GLASS, 0.1, max_modes=500)
    assert 0 < len(again.damping) < len(stored.damping)
    np.testing.assert_allclose(tuned.damped_frequency, again.damped_frequency, rtol=1e-6)
    assert tuned.notes == ()  # nothing is lacking: a smaller object rings higher
    assert tuned.complete_hz == pytest.approx((0, 40000))


def test_modes_that_come_into_it_are_said_to_be_lacking(solve):
    stored, band = solve(GLASS, 0.2, max_modes=500)
    tuned = retune(*tensors(stored), band, (GLASS, 0.2), (GLASS, 0.5))
    again, _ = solve(GLASS, 0.5, max_modes=500)
    assert len(tuned.modes) == len(stored.damping) < len(again.damping)
    assert again.damped_frequency[len(tuned.modes)] / (2 * np.pi) > 8000
    (note,) = tuned.notes
    assert note.startswith("incomplete: modes from 8000 to 20000 Hz were above the band")


def test_of_a_truncated_object_the_band_ends_at_its_last_mode(solve):
    stored, band = solve(GLASS, 0.2, max_modes=5)
    assert stored.report["truncated"]
    assert band == [0.0, pytest.approx(math.sqrt(stored.eigenvalues[-1]) / (2 * np.pi))]
    (note,) = retune(*tensors(stored), band, (GLASS, 0.2), (GLASS, 0.2)).notes
    assert f"modes from {band[1]:.0f} to 20000 Hz" in note


def test_modes_below_hearing_are_said_to_be_lacking_when_they_come_into_it():
    w, c = torch.tensor([300.0, 3000.0]), torch.ones(2)
    stiffer = retune(w, c, (20.0, 20000.0), (GLASS, 1.0), (GLASS, 0.5))
    assert stiffer.notes == (
        "incomplete: modes from 20 to 40 Hz were below the band that was solved and are not stored; "
        "build the object with this material and scale to hear them",
    )
    assert retune(w, c, BAND, (GLASS, 1.0), (GLASS, 0.5)).notes == ()
    softer = retune(w, c, (20.0, 20000.0), (GLASS, 1.0), (GLASS, 4.0))
    assert softer.modes.tolist() == [1]  # 300 rad/s falls to 12 Hz
    assert len(softer.notes) == 1


def test_the_objects_own_material_and_size_change_nothing():
    w, c = torch.tensor([300.0, 3000.0, 9e4]).double(), torch.tensor([0.5, 0.5, 0.5]).double()
    plain = dataclasses.replace(GLASS, alpha=1.0, beta=0.0)
    tuned, stored = retune(w, c, BAND, (plain, 0.1), (plain, 0.1)), stored_modes(w, c)
    torch.testing.assert_close(tuned.damped_frequency, stored.damped_frequency)
    torch.testing.assert_close(tuned.damping, stored.damping)
    assert tuned.modes.tolist() == stored.modes.tolist() == [0, 1, 2]
    assert (tuned.shape_factor, tuned.frequency_bounds, tuned.notes) == (1, (1, 1), ())
    torch.testing.assert_close(stored.frequencies, w / (2 * np.pi))


def test_modes_of_a_solve_beyond_hearing_stay():
    w, c = 2 * np.pi * torch.tensor([300.0, 25000.0, 27000.0]).double(), torch.full((3,), 0.5).double()
    plain = dataclasses.replace(GLASS, alpha=1.0, beta=0.0, loss_factor=())
    assert retune(w, c, (0.0, 26000.0), (plain, 0.1), (plain, 0.1)).modes.tolist() == [0, 1]


@pytest.mark.parametrize("other", ["iron", "polycarbonate"])
def test_at_another_poisson_ratio_the_true_frequencies_are_within_the_bounds(solve, other):
    stuff = material(other)
    stored, band = solve(GLASS, 0.2, max_modes=12)
    again, _ = solve(stuff, 0.2, max_modes=12)
    tuned = retune(*tensors(stored), band, (GLASS, 0.2), (stuff, 0.2))
    low, high = tuned.frequency_bounds
    assert low < 1 < high
    count = min(len(tuned.modes), len(again.damping))
    natural = (tuned.damped_frequency**2 + tuned.damping**2).sqrt().numpy()[:count]
    factor = np.sqrt(again.eigenvalues[:count]) / natural
    assert (factor > low).all()
    assert (factor < high).all()
    assert np.abs(factor - 1).max() > 1e-3
    said = f"glass with Poisson ratio 0.2, {other} has {stuff.poisson_ratio:g}; true frequencies are "
    assert said in tuned.notes[0]
    assert f"{low:.3f} to {high:.3f} times these" in tuned.notes[0]


def test_overdamped_modes_are_left_out():
    w, c = torch.tensor([500.0, 5000.0, 50000.0]), torch.zeros(3)
    dull = dataclasses.replace(GLASS, alpha=1200.0, beta=1e-4)
    tuned = retune(w, c, BAND, (GLASS, 0.1), (dull, 0.1))
    assert tuned.modes.tolist() == [1]
    assert torch.isfinite(tuned.damped_frequency).all()


def test_an_object_without_modes():
    none = torch.zeros(0, dtype=torch.float64)
    tuned = retune(none, none, BAND, (GLASS, 0.1), (SOFT, 1.0))
    assert len(tuned.modes) == len(tuned.damping) == len(tuned.frequencies) == 0
    assert "modes from" in tuned.notes[0]


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan, math.inf])
def test_a_size_must_be_positive(scale):
    with pytest.raises(ObjectFolderError, match=f"scale is {scale}, expected"):
        retune(torch.ones(1), torch.ones(1), BAND, (GLASS, 0.1), (GLASS, scale))
