"""Where benchmarks leave their files: the only place that names a path in the folder of a run."""

from pathlib import Path


class Benchmarks:
    """Paths of observations and results.

    Parameters
    ----------
    folder : Path
        Default: that of the workspace's stages.
    """

    def __init__(self, folder: str | Path = "benchmarks"):
        self.dir = Path(folder)

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

    def progress(self, task: str, split: str, identity: str) -> Path:
        """Undeclared: what an interrupted run goes on from, as long as nothing that it depends on changed."""
        return self.dir / ".progress" / f"{task}_{split}_{identity[:16]}"
