"""A tiny workspace that runs the real DAG."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from forkserver import ForkServer
from ruamel.yaml import YAML
from sharing import once

ROOT = Path(__file__).parents[2]

TINY = YAML(typ="safe").load("""
normalize: {texture_size: 64}
voxelize: {resolutions: [8], subdivisions: 4, max_degrees_of_freedom: 20000, sdf_resolution: 48}
modal: {fine: {resolutions: [12], subdivisions: 4, max_degrees_of_freedom: 20000, max_error: 0.5},
  max_modes: 12, surface_points: 300, allow_uncertain: true}
radiation: {triangles: 200}
render_views: {resolution: 32, tile: 12, train: 40, val: 6, test: 2, train_samples: 4, test_samples: 4}
render_touch: {train: 4, val: 2, test: 3}
train_vision: {table_bits: 10, levels: 4, finest: 64, width: 16, point_steps: 20, point_batch: 1024,
  steps: 40, batch: 512, osf: {width: 16, depth: 2, branch_width: 8, branch_depth: 1, point_octaves: 2,
  direction_octaves: 1, coarse_samples: 8, fine_samples: 8, hull_cells: 16, steps: 150,
  batch: 128, learning_rate: 0.01, final_rate: 0.01, precision: float32}}
train_audio: {sizes: [{modes: 100, resolution: 6, channels: 4, width: 32, features: 32, most_features: 32,
  frequency: 6.0, steps: 60, learning_rate: 0.005, grid_rate: 3.0}], spectrogram: {width: 16,
  depth: 2, point_octaves: 1, bin_octaves: 3, steps: 40, batch: 256, learning_rate: 0.001,
  final_rate: 0.01, loud: 0.5, target: turned, precision: float32}}
train_touch: {rounds: 1, contacts: 2, image: {width: 16, depth: 2, point_octaves: 2, pixel_octaves: 2,
  steps: 60, batch: 512, learning_rate: 0.005, final_rate: 0.01, precision: float32}}
evaluate: {impacts: 4}
observe: {observations: 10, resolution: 32, depth: null}
encode: {image: 28, spectrogram: [33, 26], touch: [40, 30], subtract: true, shift: 1, flip: true}
recognize: {seeds: 1, epochs: 1, fusion_epochs: 1, batch: 8, schedule: one_cycle}
retrieve: {seeds: 1, epochs: 2, batch: 8, embedding: 16}
reconstruct: {seeds: 1, epochs: 1, batch: 8, points: 64, width: 16, blocks: 1, frequencies: 1,
  pretrain_epochs: 1,
  naming: 1.0, resolution: 16, score_points: 500, views: 1, touches: 2}
decompose: {hulls: 2}
grasp_data: {grasps: 10, perturbations: 0, image: 16, touch: [16, 12]}
grasp_policy: {seeds: 1, episodes: 8, environments: 2, rollout: 4,
  updates: 1, batch: 8, width: 8, rollouts: 4,
  presses: 4}
reach: {steps: 256, goals: 2, horizon: 5, environments: 2, rollout: 8, batch: 8, width: 8}
""")
CLOSING_FIELDS = {"up": "y", "wall": None, "bridge": "all"}
TINY_OBJECTS = {
    "procedural": {
        "cube": {"generator": "die", "edge": 0.16, "fillet": 0.02, "texture_size": 64},
        "bell": {"generator": "bell", "texture_size": 64},
    },
    "objects": {
        key: {"mesh": f"data/objects/{key}/mesh.glb", "material": material, "scale": scale, **CLOSING_FIELDS}
        for key, material, scale in (("cube", "wood", 0.16), ("bell", "steel", 0.09))
    },
}


class Workspace:
    """A copy of the pipeline with tiny parameters, in a git and DVC repository of its own.

    ``root``: where it is; ``server``: runs its commands.
    """

    def __init__(self, root: Path, server: ForkServer):
        self.root = root
        self.server = server

    def create(self) -> "Workspace":
        self.root.mkdir(parents=True)
        for name in ("materials", "objectfolder", "stages", "params"):
            shutil.copytree(ROOT / name, self.root / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("dvc.yaml", ".dvcignore", "params.yaml", ".gitignore"):
            shutil.copy(ROOT / name, self.root)
        (self.root / ".dvc").mkdir()
        shutil.copy(ROOT / ".dvc" / "config", self.root / ".dvc")
        subprocess.run(["git", "init", "-q"], cwd=self.root, check=True)
        with self.edit() as values:
            for section, content in TINY.items():
                values[section] = {**values[section], **content}
            values.update(TINY_OBJECTS)
        return self

    @contextmanager
    def edit(self) -> Iterator[dict]:
        """Edit params.yaml in the block."""
        path = self.root / "params.yaml"
        values = YAML(typ="safe").load(path.read_text())
        yield values
        with path.open("w") as stream:
            YAML().dump(values, stream)

    @contextmanager
    def edited(self, **sections: object) -> Iterator[None]:
        """Have other values in params.yaml, in the block; mappings are merged into those that are there."""
        path = self.root / "params.yaml"
        before = path.read_text()
        with self.edit() as values:
            for name, value in sections.items():
                values[name] = values[name] | value if isinstance(value, dict) else value
        try:
            yield
        finally:
            path.write_text(before)

    def run(self, *command: str, ok: bool = True) -> subprocess.CompletedProcess:
        """Run `objectfolder ...` or `python -m stages...` in the workspace, with its own copy of the code."""
        done = self.server.run(command, self.root)
        assert not ok or done.returncode == 0, f"{command}:\n{done.stdout}\n{done.stderr}"
        return done

    def cli(self, *arguments: str, ok: bool = True) -> subprocess.CompletedProcess:
        return self.run("-c", "from objectfolder.cli import main; main()", *arguments, ok=ok)

    def build(self, *targets: str) -> set[str]:
        """Build; return the addresses of the stages that ran."""
        output = self.cli("build", *targets, "-j", "2").stderr
        return {line.split()[1] for line in output.splitlines() if line.startswith("ran ")}

    def artifacts(self) -> dict[str, bytes]:
        """Contents of all files but logs and what a stage keeps for itself."""
        files = [p for folder in ("build", "metrics", "benchmarks") for p in (self.root / folder).rglob("*")]
        return {
            p.relative_to(self.root).as_posix(): p.read_bytes()
            for p in files
            if p.is_file() and not any(part.startswith(".") for part in p.relative_to(self.root).parts)
        }


@pytest.fixture(scope="session")
def built(tmp_path_factory, fork_server) -> Workspace:
    """A workspace whose two objects are built; each process of a parallel run gets a copy of one build."""
    with once(tmp_path_factory, "tiny") as (done, is_first):
        if is_first:
            first = Workspace(done.with_name("building") / "workspace", fork_server).create()
            first.build()
            first.root.rename(done)
    copy = shutil.copytree(done, tmp_path_factory.mktemp("tiny") / "workspace", symlinks=True)
    return Workspace(copy, fork_server)


@pytest.fixture
def workspace(tmp_path, fork_server) -> Workspace:
    """A workspace that nothing was built in."""
    return Workspace(tmp_path / "workspace", fork_server).create()
