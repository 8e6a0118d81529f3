"""Made-up observations of objects, held in memory, and an encoder that learns them in a moment."""

import numpy as np
from torch import nn

from objectfolder.benchmarks.datasets.samples import Samples
from objectfolder.benchmarks.models.encoders import register_encoder


@register_encoder("linear")
class Linear(nn.Module):
    """One layer on an input of 8 x 4 pixels."""

    features = 16

    def __init__(self, channels):
        super().__init__()
        self.layer = nn.Sequential(nn.Linear(32 * channels, 16), nn.BatchNorm1d(16), nn.ReLU())

    def forward(self, x):
        return self.layer(nn.functional.adaptive_avg_pool2d(x, (8, 4)).flatten(1))


class MadeUp(Samples):
    """Samples whose ``arrays`` (rows, ...) may be changed, and which remember the rows that are read."""

    def __init__(self, keys, arrays, **records):
        self.arrays, self.reads = arrays, {name: [] for name in arrays}
        count = len(next(iter(arrays.values()))) // len(keys)
        said = [{"count": count, **{name: of[i] for name, of in records.items()}} for i in range(len(keys))]
        super().__init__(dict(zip(keys, said)), {})

    def shape(self, name):
        return self.arrays[name].shape[1:]

    def read(self, name, rows):
        self.reads[name].append(np.array(rows))
        return self.arrays[name][rows]

    def counts(self, name):
        """How often each row was read."""
        return np.bincount(np.concatenate(self.reads[name]), minlength=len(self))


def picture(colours, side, noise, rng):
    """Pictures of one colour each under noise, (N, side, side, 3) uint8."""
    pixels = np.asarray(colours)[:, None, None] + noise * rng.standard_normal((len(colours), side, side, 3))
    return pixels.clip(0, 255).astype(np.uint8)


def hum(pitches, rng):
    """Decaying tones (N, 1600) float32 at 16 kHz, under a little noise."""
    time = np.arange(1600) / 16000
    sounds = np.sin(2 * np.pi * np.asarray(pitches)[:, None] * time) * np.exp(-20 * time)
    return (sounds + 0.01 * rng.standard_normal(sounds.shape)).astype(np.float32)


def observations(rng, count):
    """Noise as a view, a sound of two seconds, and a touch, so many of each."""
    sides = {"vision": (64, 64), "touch": (160, 120)}
    found = {name: rng.integers(256, size=(count, *of, 3), dtype=np.uint8) for name, of in sides.items()}
    return found | {"audio": rng.standard_normal((count, 32000)).astype(np.float32)}
