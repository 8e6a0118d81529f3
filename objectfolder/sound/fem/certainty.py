"""How far the report of a modal analysis, ``modal.json``, can be trusted; imports no numerical library."""

from typing import Any

CUT_CELLS = "hex20 cut cells"  #: name of the element
MAX_RESIDUAL = 1e-8
MAX_RIGID = 1e-3  #: frequency of rigid modes, over the lowest elastic one
MAX_UNWARNED_ERROR, MAX_ERROR = 0.1, 0.3  #: of frequencies: largest error without a warning, without a mark


def is_uncertain(report: dict[str, Any]) -> bool:
    """Return whether the lowest frequencies are too uncertain to be used unmarked.

    Their estimated error exceeds `MAX_ERROR`, or is not known: of cut cells half of whose grid falls apart.
    Other elements have no estimates. The report is the content of ``modal.json``.
    """
    error = report["frequency_uncertainty"]
    if error is None:
        return report["element"] == CUT_CELLS and report["modes"] > 0
    return bool(error > MAX_ERROR)


def uncertainty_warning(report: dict[str, Any], name: str) -> str | None:
    """Describe an estimated error of the lowest frequencies above `MAX_UNWARNED_ERROR`; None below.

    Of a report with a mark, ``uncertain``, also what the mark means and how to be rid of it.
    """
    error, cells = report["frequency_uncertainty"], report["resolution"]
    cut = report["element"] == CUT_CELLS
    grid = f"the {cells}^3 grid" if cut else f"elements of 1/{cells} of the longest side"
    if not is_uncertain(report) and (error is None or error <= MAX_UNWARNED_ERROR):
        return None
    if error is None:
        text = f"{name}: frequencies may be wrong; walls are too thin for {grid} to say how much"
    else:
        errors = report["discretisation_error"]
        worst = max(range(len(errors)), key=errors.__getitem__)
        text = (
            f"{name}: frequencies may be {error:.0%} wrong, mode {worst + 1} most: walls or joints are thin "
            f"for {grid}"
        )
    if not report.get("uncertain"):
        return text
    return (
        f"{text}; the sound is marked uncertain, and benchmarks leave it out: thicken them, raise "
        "modal.fine.max_degrees_of_freedom in params.yaml, or accept the error there: "
        "`modal.allow_uncertain: true` (docs/modal.md#accuracy)"
    )


def solver_checks(report: dict[str, Any]) -> dict[str, bool]:
    """Check that residuals are small and that rigid modes have zero frequency."""
    rigid = max(report["rigid_hz"]) < rigid_limit(report)
    return {"residuals_ok": report["residual_max"] < MAX_RESIDUAL, "rigid_modes_ok": rigid}


def solver_warning(report: dict[str, Any], name: str) -> str | None:
    """Return what is to be said of a solve whose checks fail."""
    if report["residuals_ok"] and report["rigid_modes_ok"]:
        return None
    return (
        f"{name}: the solver is less exact than usual (residual {report['residual_max']:.1e}, expected under "
        f"{MAX_RESIDUAL:g}; rigid modes up to {max(report['rigid_hz']):.2g} Hz, expected under "
        f"{rigid_limit(report):.2g}); very thin parts make it so"
    )


def rigid_limit(report: dict[str, Any]) -> float:
    """Return the frequency below which rigid modes count as zero, Hz: rounding grows with the elastic ones.

    Where no mode was kept, all are above the limit of the solve.
    """
    return MAX_RIGID * float([*report["lowest_hz"], report["max_frequency_hz"]][0])
