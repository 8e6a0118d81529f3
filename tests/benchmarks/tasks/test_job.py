from dataclasses import replace

import numpy as np
import torch
from encoding import encoding
from made_up import MadeUp

from objectfolder.benchmarks.models import touch_frame
from objectfolder.benchmarks.models.inputs import encoder_inputs
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import job
from objectfolder.benchmarks.tasks.job import Job
from objectfolder.benchmarks.tasks.recognize import RecognizeConfig
from objectfolder.touch.ball import BallModel
from objectfolder.touch.inverse import PhotometricInverse
from objectfolder.touch.profiles import load_profile

SIZES = InputSizes(12, (16, 10), (8, 6))


def test_what_is_kept_has_one_limit(tmp_path, monkeypatch):
    """Of three tensors of 80 bytes, the third finds no room; one of 160 would leave none for the others."""
    monkeypatch.setattr(job, "KEPT_BYTES", 200)
    task = Job(Sounds(), None, None, encoding("tiny", SIZES), seed=0, progress=tmp_path)

    def computed(name, width):
        """Ask twice for a row; return how often it was computed."""
        made = []
        for _ in range(2):
            task.once(
                name, np.array([3]), (width,), lambda rows: made.append(rows) or torch.ones(len(rows), width)
            )
        return len(made)

    assert [computed(name, width) for name, width in (("d", 2), ("a", 1), ("b", 1), ("c", 1))] == [2, 1, 1, 2]


class Sounds:
    """Noise of an object's twenty observations, which remembers what is read."""

    labels = np.zeros(20, np.int64)

    def __init__(self):
        self.asked: list[int] = []

    def read(self, modality, rows):
        assert modality == "audio"
        self.asked += rows.tolist()
        noise = [np.random.default_rng(row).normal(size=32000) for row in rows]
        return np.stack(noise).astype(np.float32)


def test_each_spectrogram_is_computed_once(tmp_path, monkeypatch):
    rows = [np.array([3, 1, 3, 7]), np.array([7, 0, 1]), np.array([3])]
    expected = [encoder_inputs("audio", Sounds().read("audio", some), SIZES) for some in rows]
    for most, asked in ((2**20, [1, 3, 7, 0]), (100, [3, 1, 3, 7, 7, 0, 1, 3])):
        monkeypatch.setattr(job, "KEPT_BYTES", most)
        sounds = Sounds()
        task = Job(sounds, None, None, encoding("tiny", SIZES), seed=0, progress=tmp_path)
        for some, inputs in zip(rows, expected):
            assert torch.equal(task.inputs("audio", some), inputs)
        assert sounds.asked == asked


def test_touches_in_their_own_frame_are_inputs_of_a_net_that_asks_for_them(tmp_path):
    """Each is computed once; training mirrors some; images are untouched where they are asked for."""
    profile = replace(load_profile("digit"), height=24, width=18)
    ball = BallModel(profile, 0.004)
    still = ball.optics.background.numpy()
    presses = np.array([[10, 8, 0.001], [14, 11, 0.0006], [12, 5, 0.0014]])
    touches = np.concatenate([ball.optics.render(ball.displacement(pose)).numpy() for pose in presses])
    table = MadeUp(("ball",), {"touch": touches})
    rows, inverse = np.array([2, 0, 1]), PhotometricInverse.fitted(profile, still, (12, 9))
    encode = encoding("tiny", InputSizes(12, (16, 10), (12, 9)), shift=1)
    own = Job(table, None, RecognizeConfig(), encode, 0, tmp_path, inverse=inverse)
    shapes = touch_frame.levelled(inverse.displacement(touches))
    expected = touch_frame.gel_inputs(touch_frame.upright(shapes, 24 / 18))[rows]
    found = own.inputs("touch", rows)
    torch.testing.assert_close(found, expected, atol=2e-2, rtol=2e-3)  # kept with 16 bits
    assert torch.equal(own.inputs("touch", rows), found)
    assert table.counts("touch").tolist() == [1, 1, 1]
    drawn = [own.inputs("touch", rows, np.random.default_rng(seed)) for seed in range(4)]
    assert any(not torch.equal(one, drawn[0]) for one in drawn)
    images = replace(own, inverse=None).inputs("touch", rows)
    assert torch.equal(images, encoder_inputs("touch", touches[rows], encode.sizes))
