import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.sound import bank as module
from objectfolder.sound.bank import Bank
from objectfolder.sound.synthesis import sinusoid_bank
from objectfolder.sound.tuning import stored_modes


@pytest.fixture
def tuning(rng):
    frequency = 2 * np.pi * torch.from_numpy(rng.uniform(100, 20000, 40))
    return stored_modes(frequency, torch.from_numpy(rng.uniform(1, 200, 40)))


@pytest.mark.parametrize("contact_time", [0.0, 3e-3])
@pytest.mark.parametrize("response", ["displacement", "acceleration"])
def test_sounds_are_the_responses_mixed_by_gains(tuning, response, contact_time, rng):
    bank = Bank(tuning, 16000, 0.3, response, contact_time)
    every = sinusoid_bank(tuning.damped_frequency, tuning.damping, 16000, 0.3, response, contact_time)
    gains = torch.from_numpy(rng.standard_normal((37, 40))).float()
    assert 0 < len(bank.heard) < 40
    expected = (gains.double() @ every.double()).numpy()
    found = bank.mix(gains[:, bank.heard])
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_a_long_sound_is_made_in_pieces_of_bounded_memory(tuning, monkeypatch, rng):
    monkeypatch.setattr(module, "PIECE", 1000)
    gains = torch.from_numpy(rng.standard_normal((3, 40))).float()
    kept = Bank(tuning, 16000, 0.3, "velocity", 3e-3)
    monkeypatch.setattr(module, "MAX_CACHED_BYTES", 0)
    made_anew = Bank(tuning, 16000, 0.3, "velocity", 3e-3)
    assert (len(kept._pieces), len(made_anew._pieces)) == (5, 0)
    gains = gains[:, kept.heard]
    np.testing.assert_array_equal(kept.mix(gains), made_anew.mix(gains))


@pytest.mark.parametrize("samples", [1, 6, 7, 9, 10, 11, 15])
def test_a_short_sound_is_bit_identical_at_any_place_in_a_batch(tuning, samples, rng, monkeypatch):
    """So is one whose last piece is short."""
    monkeypatch.setattr(module, "PIECE", 1000)
    for length in (samples, 1000 + samples):
        bank = Bank(tuning, 44100, length / 44100, "velocity", 0.0)
        gains = torch.from_numpy(rng.standard_normal((1, len(bank.heard)))).float()
        batch = bank.mix(gains.repeat(16, 1))
        assert batch.shape == (16, length)
        assert (batch == bank.mix(gains)).all()


@pytest.mark.parametrize("kept", [0, 1 << 27])
def test_nonsense_is_refused_at_once(tuning, kept, monkeypatch):
    monkeypatch.setattr(module, "MAX_CACHED_BYTES", kept)
    for nonsense in (
        (0, 1.0, "velocity", 0.0),
        (16000, 1.0, "loudness", 0.0),
        (16000, 1.0, "velocity", -1.0),
    ):
        refused(r"expected|must be|is not one of", Bank, tuning, *nonsense)
