"""Scores of all senses of an Object File, as a build prints them."""

from typing import Any


def summary_row(key: str, metrics: dict[str, Any]) -> dict[str, str]:
    """Return an object's row of the table printed at the end of a build."""
    v, a, t = metrics["vision"], metrics["audio"], metrics["touch"]

    def beside(values: dict[str, Any], *scores: str, form: str = ".1f", none: str = "silent") -> str:
        return " / ".join(f"{values[name]:{form}}" for name in scores) if scores[0] in values else none

    kept, found = a["modes"], a.get("modes_found")

    return {
        "object": key,
        "vision / white": beside(v, "psnr", "baseline_white"),
        "lit": f"{v['psnr_lit_foreground']:.1f}" if "psnr_lit_foreground" in v else "-",
        "audio / silence": beside(a, "psnr", "baseline_silence") + ", uncertain" * a.get("uncertain", False),
        "gain error / nearest": beside(a, "gain_error", "baseline_nearest", form=".1%", none="-"),
        "modes": f"{kept}" if found in (None, kept) else f"{kept} of {found}",
        "touch / mean": beside(t, "psnr", "baseline_mean_image"),
        "kB": f"{metrics['file_bytes'] / 1000:.0f}",
    }
