"""Trainings of the paper's nets that take a second."""

import numpy as np

from objectfolder.sound.gains_training import ModeSamples
from objectfolder.sound.net_settings import SpectrogramConfig
from objectfolder.sound.spectrogram_training import train_spectrogram
from objectfolder.touch.image_training import train_image
from objectfolder.touch.net_settings import ImageConfig
from objectfolder.vision.cameras import Intrinsics, look_at, sphere_points
from objectfolder.vision.net_settings import OsfConfig
from objectfolder.vision.osf_training import train_osf

TRAINING = {"steps": 30, "learning_rate": 0.01, "final_rate": 1.0, "precision": "float32"}


def train_views(session, **changes):
    rng = np.random.default_rng(0)
    views = {
        "rgba": np.insert(rng.random((3, 8, 8, 3)), 3, 1, axis=3).astype(np.float16),
        "camera_to_world": look_at(sphere_points(3, 2.5, rng)),
        "light": sphere_points(3, 1.0, rng),
        "focal": np.float64(Intrinsics.square(8).focal),
        "center": np.full((3, 2), 4.0),
    }
    shape = {"width": 16, "depth": 2, "branch_width": 16, "branch_depth": 2, "point_octaves": 2}
    shape |= {"direction_octaves": 1, "coarse_samples": 8, "fine_samples": 8, "hull_cells": 4}
    config = OsfConfig(**shape, batch=32, **TRAINING | changes)
    return train_osf(views, views, config, session)


def train_sounds(session, **changes):
    rng = np.random.default_rng(0)
    points, shapes = rng.uniform(-0.5, 0.5, (20, 3)), rng.standard_normal((20, 3, 2))
    tuning = 2 * np.pi * np.array([400.0, 1500]), np.array([3.0, 4])
    samples = ModeSamples(points, shapes, *tuning, np.arange(15), np.arange(15, 20))
    shape = {"width": 8, "depth": 2, "point_octaves": 1, "bin_octaves": 2}
    config = SpectrogramConfig(**shape, batch=64, loud=0.5, **TRAINING | changes)
    return train_spectrogram(samples, config, session)


def train_touches(session, **changes):
    rng = np.random.default_rng(0)
    contacts = {
        "images": rng.integers(0, 255, (5, 6, 8, 3), dtype=np.uint8),
        "points": rng.uniform(-0.1, 0.1, (5, 3)),
        "depths": np.full(5, 0.001),
        "angles": np.zeros(5),
    }
    config = ImageConfig(width=8, depth=2, point_octaves=2, pixel_octaves=2, batch=64, **TRAINING | changes)
    return train_image(contacts, contacts, 0.2, "digit", config, session)
