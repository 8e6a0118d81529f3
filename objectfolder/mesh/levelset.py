"""Triangles of the zero level set of a distance grid."""

import numpy as np

from objectfolder.mesh.gridcodec import enclosing_box


def zero_level(values: np.ndarray, zero: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Extract the zero level set by marching cubes (Lewiner et al. 2003).

    Of the values (R, R, R) int8, negative inside, some are negative or 0, and some positive. ``zero``,
    which is not positive, is taken for those of 0. Returns vertices (V, 3) float64 in units of samples, and
    faces (F, 3) int64, counter-clockwise seen from outside.
    """
    from skimage.measure import marching_cubes

    box = enclosing_box(values <= 0)
    values = values[tuple(box)]
    distances = values.astype(np.float32)
    if zero:
        distances[values == 0] = zero
    vertices, faces, _, _ = marching_cubes(distances, 0.0, allow_degenerate=False, mask=_crossed(values))
    return vertices.astype(np.float64) + [side.start for side in box], faces.astype(np.int64)


def _crossed(values: np.ndarray) -> np.ndarray:
    """Mark the cells that the surface may cross, at their upper corner; bool.

    Marching cubes skips the others, which are most.
    """
    cells = values.shape[2] - 1
    inside = np.packbits(values <= 0, axis=2)  # eight samples at once
    some, every = inside != 0, inside == 255
    # Cells of a byte extend into the next byte; bits beyond the last sample are 0.
    some[:, :, :-1], every[:, :, :-1] = some[:, :, :-1] | some[:, :, 1:], every[:, :, :-1] & every[:, :, 1:]
    for _ in range(2):
        some, every = (some[:-1] | some[1:]).swapaxes(0, 1), (every[:-1] & every[1:]).swapaxes(0, 1)
    crossed = np.zeros(values.shape, bool)
    crossed[1:, 1:, 1:] = np.repeat(some & ~every, 8, axis=2)[:, :, :cells]
    return crossed
