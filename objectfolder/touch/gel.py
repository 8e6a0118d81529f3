"""How the gel gives way."""

import numpy as np

from objectfolder.touch.profiles import SensorProfile


def deform(height: np.ndarray, profile: SensorProfile) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (N, H, W), metres, and pressure, of the gel's surface."""
    return np.maximum(height, 0).astype(np.float32), np.full(height.shape, np.nan, np.float32)
