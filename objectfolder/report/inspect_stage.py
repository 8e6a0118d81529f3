"""Inspection of a stage by its name.

Pictures go to ``build/<key>/inspect/``, which no stage declares, so an inspection never makes a stage stale.
"""

from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path

from objectfolder.base.disk import refuse_links
from objectfolder.base.errors import ObjectFolderError
from objectfolder.report.inspect_geometry import export_vtu, inspect_normalize, inspect_voxelize
from objectfolder.report.inspect_images import inspect_render_touch, inspect_render_views
from objectfolder.report.inspect_nets import inspect_evaluate, inspect_net, inspect_pack
from objectfolder.report.inspect_sound import inspect_modal, inspect_radiation
from objectfolder.report.inspection import Inspection
from objectfolder.workspace.layout import Build
from objectfolder.workspace.stages import check_key

#: Inspection of each stage.
STAGES: dict[str, Callable[[Build], Inspection]] = {
    "normalize": inspect_normalize,
    "voxelize": inspect_voxelize,
    "modal": inspect_modal,
    "radiation": inspect_radiation,
    "render_views": inspect_render_views,
    "render_touch": inspect_render_touch,
    "train_vision": lambda build: inspect_net(build, "vision"),
    "train_audio": lambda build: inspect_net(build, "audio"),
    "train_touch": lambda build: inspect_net(build, "touch"),
    "pack": inspect_pack,
    "evaluate": inspect_evaluate,
}


def inspect_stage(stage: str, key: str, root: str | Path = ".", vtu: bool = False) -> Inspection:
    """Summarize and draw the artifacts of a stage, one of `STAGES`, for one object of a workspace.

    With ``vtu`` the solid of voxelize is also written for ParaView. Raises ObjectFolderError if the stage is
    unknown, an artifact is missing, ``vtu`` is requested for another stage than voxelize, or the machine has
    no OpenGL.
    """
    if stage not in STAGES:
        close = get_close_matches(stage, STAGES)
        hint = f"did you mean {' or '.join(close)}?" if close else f"expected one of {', '.join(STAGES)}"
        raise ObjectFolderError(f"there is nothing to inspect in stage {stage!r}; {hint}")
    build = Build(check_key(key), root)
    refuse_links(build.inspections, Path(root))
    if vtu and stage != "voxelize":
        other = f"use `objectfolder inspect voxelize@{key} --vtu`"
        raise ObjectFolderError(f"{stage}@{key} holds no solid to export; {other}")
    inspection = STAGES[stage](build)
    if vtu:
        inspection.files.append(export_vtu(build))
    return inspection
