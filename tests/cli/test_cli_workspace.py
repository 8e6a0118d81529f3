"""`objectfolder build` and `inspect`: what they print."""

import io
import json

import pytest
from refusals import refused
from rich.console import Console

from objectfolder.cli import app, workspace
from objectfolder.report.inspect_stage import STAGES
from objectfolder.workspace.layout import Build

METRICS = {
    "vision": {"psnr": 42.0, "baseline_white": 10.5, "psnr_lit_foreground": 31.3},
    "audio": {
        **{"psnr": 106.1, "baseline_silence": 57.2, "gain_error": 0.104, "baseline_nearest": 0.149},
        **{"modes": 110, "modes_found": 396},
    },
    "touch": {"psnr": 55.8, "baseline_mean_image": 34.6},
    "file_bytes": 836 * 1024,
}
MODAL = {"frequency_uncertainty": 0.22, "resolution": 96, "discretisation_error": [0.1, 0.22]}
MODAL |= {"element": "hex20 cut cells"}


@pytest.fixture
def printed(tmp_path, monkeypatch):
    """What is printed about the scores of an object, in a terminal of 80 columns."""
    monkeypatch.chdir(tmp_path)
    built = Build("polyhaven_teapot")
    for path, content in ((built.metrics, METRICS), (built.modal, MODAL)):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(content))
    terminal = Console(file=io.StringIO(), width=80, force_terminal=True)
    monkeypatch.setattr(workspace, "console", terminal)
    workspace._print_metrics(["polyhaven_teapot"])
    return terminal.file.getvalue()


def test_scores_stay_whole_beside_those_of_a_baseline_in_eighty_columns(printed):
    (row,) = [line.split() for line in printed.splitlines() if line.startswith("polyhaven_teapot ")]
    assert row[1:5] == ["42.0/10.5", "31.3", "106.1/57.2", "10.4%/14.9%"]
    assert row[5:] == ["110", "of", "396", "55.8/34.6", "856"]


def test_a_warning_has_one_colour(printed):
    assert "\x1b[33mwarning: polyhaven_teapot: frequencies may be 22% wrong, mode 2 most" in printed
    assert "; thicken them, or raise modal.fine.max_degrees_of_freedom in params.yaml" in printed


@pytest.mark.usefixtures("workspace")
def test_an_inspection_of_no_stage_lists_the_stages():
    message = "'mug' is not STAGE@OBJECT, such as modal@mug; the stages are normalize, .*, evaluate$"
    caught = refused(message, app, ["inspect", "mug"], standalone_mode=False)
    assert all(stage in caught for stage in STAGES)
