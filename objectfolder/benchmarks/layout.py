"""Where benchmarks leave their files: the only place that names a path in the folder of a run."""

import hashlib
from pathlib import Path
from typing import Any


class Benchmarks:
    """Paths of observations and results.

    Parameters
    ----------
    folder : Path
        Default: that of the workspace's stages.
    """

    def __init__(self, folder: str | Path = "benchmarks"):
        self.dir = Path(folder)
        self.hulls = self.dir / "hulls"  #: undeclared: made anew where the Object File has changed

    def observations(self, key: str) -> Path:
        """Folder of one object's observations."""
        return self.dir / "observations" / key

    def grasps(self, key: str) -> Path:
        """Folder of one object's grasps."""
        return self.dir / "grasps" / key

    def result(self, task: str, split: str) -> Path:
        """Scores (JSON)."""
        return self.dir / f"{task}_{split}.json"

    def curve(self, task: str, split: str) -> Path:
        """Training curves (CSV)."""
        return self.dir / f"{task}_{split}.csv"

    def machine(self, task: str, split: str) -> Path:
        """Undeclared: how long it took, on what (JSON)."""
        return self.dir / f"{task}_{split}_machine.json"

    def model(self, task: str, split: str) -> Path:
        """A net that can be asked later."""
        return self.dir / f"{task}_{split}.safetensors"

    def sheet(self, task: str, split: str) -> Path:
        """A picture to look at."""
        return self.dir / f"{task}_{split}.png"

    def film(self, task: str, split: str) -> Path:
        """A moving picture to look at."""
        return self.dir / f"{task}_{split}.gif"

    def progress(self, task: str, split: str, identity: Any) -> Path:
        """Undeclared: what an interrupted run goes on from, as long as nothing that it depends on changed."""
        digest = hashlib.sha256(repr(identity).encode()).hexdigest()
        return self.dir / ".progress" / f"{task}_{split}_{digest[:16]}"
