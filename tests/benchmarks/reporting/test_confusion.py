import numpy as np
from PIL import Image

from objectfolder.benchmarks.reporting.confusion import draw_confusion


def _darkness(path):
    return 255 - np.asarray(Image.open(path).convert("L"), float)


def test_more_confusion_is_drawn_in_more_places(tmp_path):
    right = 10 * np.eye(4, dtype=int)
    spread = np.full((4, 4), 10)
    names = ("a", "b", "c", "d")
    for name, first in (("right", right), ("again", right), ("spread", spread)):
        draw_confusion(
            "Answers", {"V": first, "T": right, "VAT": 0 * right + 1}, names, tmp_path / f"{name}.png"
        )
    assert (tmp_path / "right.png").read_bytes() == (tmp_path / "again.png").read_bytes()
    change = _darkness(tmp_path / "right.png") - _darkness(tmp_path / "spread.png")
    # Of the first panel alone: the diagonal becomes lighter, the other twelve cells darker.
    assert not change[len(change) // 2 :].any()
    lighter, darker = (change > 100).sum(), (change < -10).sum()
    assert 2 < darker / lighter < 4
