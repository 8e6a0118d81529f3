"""Paths of the artifacts of a workspace: the only module that names a file under ``build/``."""

import hashlib
import re
from pathlib import Path
from typing import Any

SPLITS = ("train", "val", "test")
MODALITIES = ("vision", "audio", "touch")
MATERIALS = "materials"  #: folder of a workspace's own materials


class Build:
    """Paths of one object's artifacts; ``root`` is the workspace, the directory that holds ``dvc.yaml``."""

    def __init__(self, key: str, root: str | Path = "."):
        self.key = key
        self.root = Path(root)
        self.dir = self.root / "build" / key
        self.visual = self.dir / "visual.glb"
        self.surface = self.dir / "surface.ply"
        self.solid_surface = self.dir / "solid.ply"
        self.normalize = self.dir / "normalize.json"
        self.solid = self.dir / "solid.npz"
        self.sdf = self.dir / "sdf.npz"
        self.voxelize = self.dir / "voxelize.json"
        self.modes = self.dir / "modes.npz"
        self.modal = self.dir / "modal.json"
        self.radiation = self.dir / "radiation.safetensors"
        self.solved_modes = self.dir / ".solved_modes.npz"  #: undeclared: outlives modes.npz
        self.views_sheet = self.dir / "views.png"
        self.touch_sheet = self.dir / "touch.png"
        self.vision_sheet = self.dir / "vision.png"
        self.sound_sheet = self.dir / "sound.png"
        self.object_file = self.dir / "ObjectFile.safetensors"
        self.hulls = self.dir / "hulls.npz"  #: only of objects that robots grasp
        self.inspections = self.dir / "inspect"  #: undeclared: inspecting makes no stage stale
        self.metrics = self.root / "metrics" / f"{key}.json"

    def views(self, split: str) -> Path:
        """Archive of rendered views of one split."""
        return self.dir / "views" / f"{split}.npz"

    def touch(self, split: str) -> Path:
        """Archive of tactile images of one split."""
        return self.dir / "touch" / f"{split}.npz"

    def net(self, modality: str) -> Path:
        """Trained net of one modality: ``vision``, ``audio`` or ``touch``."""
        return self.dir / f"{modality}.safetensors"

    def curve(self, modality: str) -> Path:
        """Training curve of one net (CSV)."""
        return self.dir / f"{modality}_curve.csv"

    def checkpoint(self, modality: str) -> Path:
        """State of an unfinished training; undeclared: it outlives a killed stage."""
        return self.dir / f".{modality}_checkpoint.pt"

    def artifacts(self) -> list[Path]:
        """List every file that the pipeline writes for the object, existing or not, except its metrics."""
        single = [
            *(self.visual, self.surface, self.solid_surface, self.normalize),
            *(self.solid, self.sdf, self.voxelize, self.modes, self.modal, self.radiation),
            *(self.views_sheet, self.touch_sheet, self.vision_sheet, self.sound_sheet, self.object_file),
        ]
        data = [path for split in SPLITS for path in (self.views(split), self.touch(split))]
        nets = [path for modality in MODALITIES for path in (self.net(modality), self.curve(modality))]
        return [*single, *data, *nets]


class Benchmarks:
    """Paths of the samples and results of benchmarks, by default in the folder of the stages."""

    def __init__(self, folder: str | Path = "benchmarks"):
        self.dir = Path(folder)
        self.hulls = self.dir / "hulls"  #: undeclared: recomputed if the Object File has changed

    def observations(self, key: str) -> Path:
        """Return the folder of an object's observations."""
        return self.dir / "observations" / key

    def grasps(self, key: str) -> Path:
        """Return the folder of an object's grasps."""
        return self.dir / "grasps" / key

    def close_ups(self, key: str) -> Path:
        """Return the folder of an object's close views and touches."""
        return self.dir / "close_ups" / key

    def result(self, task: str, split: str) -> Path:
        """Return the path of the scores (JSON)."""
        return self.dir / f"{task}_{split}.json"

    def curve(self, task: str, split: str) -> Path:
        """Return the path of the training curves (CSV)."""
        return self.dir / f"{task}_{split}.csv"

    def machine(self, task: str, split: str) -> Path:
        """Return the path of run time and machine (JSON); undeclared."""
        return self.dir / f"{task}_{split}_machine.json"

    def model(self, task: str, split: str) -> Path:
        """Return the path of a trained model."""
        return self.dir / f"{task}_{split}.safetensors"

    def sheet(self, task: str, split: str) -> Path:
        """Return the path of a figure."""
        return self.dir / f"{task}_{split}.png"

    def film(self, task: str, split: str) -> Path:
        """Return the path of an animation."""
        return self.dir / f"{task}_{split}.gif"

    def results(self, task: str, split: str) -> list[Path]:
        """List every file that a task may write, existing or not."""
        return [
            path(task, split)
            for path in (self.result, self.curve, self.machine, self.model, self.sheet, self.film)
        ]

    def progress(self, task: str, split: str, identity: Any) -> Path:
        """Return the folder that a run with the same inputs resumes from; undeclared."""
        digest = hashlib.sha256(repr(identity).encode()).hexdigest()
        return self.dir / ".progress" / f"{task}_{split}_{digest[:16]}"

    def outdated_progress(self, task: str, split: str, current: Path) -> list[Path]:
        """Return the other folders that `progress` named for the same task and split."""
        named = re.compile(rf"{re.escape(task)}_{re.escape(split)}_[0-9a-f]{{16}}")
        return [path for path in current.parent.iterdir() if path != current and named.fullmatch(path.name)]


#: Folder of `code_list`.
CODE = Path("build/.code")


def code_list(name: str) -> Path:
    """Return the file with the digests of the modules that a stage imports, or of ``materials/KEY``.

    In a workspace without the package, also that with the digests of a file or folder of the package that
    stages read.
    """
    return CODE / f"{name}.sha256"
