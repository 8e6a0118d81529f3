"""An Object File whose audio net stores spectrograms answers the same questions."""

import numpy as np
import pytest
import torch
from refusals import refused

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli import app
from objectfolder.sound.evaluation import UnitStrikes, score_spectrograms
from objectfolder.sound.spectrogram import spectrogram
from objectfolder.sound.synthesis import sinusoid_bank


@pytest.fixture
def file(spectrograms):
    return spectrograms


def test_a_strike_sounds_like_the_stored_spectrograms(file, brick):
    np.testing.assert_array_equal(file.frequencies, brick.frequencies)  # still known
    points = file.sample_surface(2)
    sounds = file.impact(points, [[1, 0, 0], [0, 2, -1]])
    assert sounds.shape == (2, 32000)
    assert sounds.dtype == np.float32
    axes = [file.impact(points[1:], axis)[0] for axis in np.eye(3)]
    np.testing.assert_allclose(sounds[1], 2 * axes[1] - axes[2], atol=1e-3 * np.abs(sounds[1]).max())
    np.testing.assert_array_equal(file.impact(points[1:], [0, 2, -1])[0], sounds[1])
    np.testing.assert_array_equal(file.impact(points, [1, 0, 0], duration=0.25)[0], sounds[0, :4000])
    assert file.impact(points[:0], np.zeros((0, 3))).shape == (0, 32000)


LEARNED = r"answers displacement at 16000 Hz, up to 2 s.*gains"
NO_MODES = r"brick: its audio net stores spectrograms, no modes"


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        *(
            ({"sample_rate": 44100}, LEARNED),
            ({"duration": 2.5}, LEARNED),
            ({"response": "velocity"}, LEARNED),
        ),
        ({"duration": 0.0}, "give no samples"),
        ({"duration": float("nan")}, "expected a finite number"),
        ({"listener": [1, 0, 0]}, NO_MODES),
        *(
            (option, "stores spectrograms")
            for option in ({"material": "steel"}, {"scale": 0.3}, {"contact_time": 1e-3})
        ),
        ({"forces": [0, 0, 1e40]}, r"impulses of up to 1e\+40 N s .*scale them down"),
        ({"striker": "finger"}, "of ideal impulses; leave striker out"),
    ],
)
def test_what_the_net_has_not_learned_is_refused(file, asked, message):
    refused(message, file.impact, **{"points": file.sample_surface(1), "forces": [0, 0, 1]} | asked)


def test_gains_are_not_in_the_file(file):
    refused(NO_MODES, file.mode_shapes, file.sample_surface(1))
    assert file.impact(file.sample_surface(1), [0, 0, 1], contact_time=0.0).any()


def test_its_scores_stand_beside_silence(file, brick):
    """The net answers noise: worse than silence."""
    points = brick.sample_surface(20) / brick.scale
    modes = {
        "points": points,
        "shapes": brick.mode_shapes(points * brick.scale),
        "damped_frequency": brick._parts.audio.net.damped_frequency.numpy(),
        "damping": brick._parts.audio.net.damping.numpy(),
    }
    strikes = UnitStrikes.random(np.arange(10, 20), 2, np.random.default_rng(0))
    scores = score_spectrograms(file, modes, strikes, np.random.default_rng(0))
    assert (scores["impacts"], scores["modes"]) == (2, len(brick.frequencies))
    assert scores["psnr"] < scores["baseline_silence"]
    # Silence's score, from the sounds themselves.
    bank = sinusoid_bank(torch.from_numpy(modes["damped_frequency"]), torch.from_numpy(modes["damping"]))
    gains = torch.from_numpy(np.einsum("na,nam->nm", strikes.impulses, modes["shapes"][strikes.rows])).float()
    truth = torch.view_as_real(spectrogram(gains @ bank)).numpy()
    silence = 10 * np.log10(np.ptp(truth) ** 2 / np.mean(truth.astype(np.float64) ** 2))
    assert scores["baseline_silence"] == pytest.approx(silence, abs=1e-3)


def test_the_command_refuses_a_striker_alike(file, tmp_path):
    file.save(tmp_path / "o.safetensors")
    np.save(tmp_path / "p.npy", np.concatenate([file.sample_surface(1), np.eye(3)[:1]], 1))
    command = ["query", "audio", *(str(tmp_path / name) for name in ("o.safetensors", "p.npy", "out"))]
    app(command, standalone_mode=False)
    assert (tmp_path / "out" / "1.wav").exists()
    with pytest.raises(ObjectFolderError, match="leave striker out"):
        app([*command[:-1], str(tmp_path / "other"), "--striker", "finger"], standalone_mode=False)
