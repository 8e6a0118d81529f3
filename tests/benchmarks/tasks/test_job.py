import numpy as np
import torch
from encoding import encoding

from objectfolder.benchmarks.models.inputs import encoder_inputs
from objectfolder.benchmarks.models.settings import InputSizes
from objectfolder.benchmarks.tasks import job
from objectfolder.benchmarks.tasks.job import Job

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
