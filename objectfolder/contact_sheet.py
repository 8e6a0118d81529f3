"""Many small pictures on one page."""

import numpy as np


def tile(images: np.ndarray, columns: int, gap: int = 4) -> np.ndarray:
    """Lay images out in rows on white; (N, H, W, 3) uint8 -> (H', W', 3) uint8."""
    count, height, width, _ = images.shape
    rows = -(-count // columns)
    page = np.full((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), 255, np.uint8)
    for i, image in enumerate(images):
        top, left = gap + i // columns * (height + gap), gap + i % columns * (width + gap)
        page[top : top + height, left : left + width] = image
    return page
