"""A public name of the package stands for one thing."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "objectfolder"
ENTRY_POINT = "main"  # of a process: the command line, the supervisor, Blender's script

#: Names that two modules still share. Shrink this list; never extend it.
SHARED = {
    "Episodes": {"benchmarks.tasks.reach", "envs.grasp"},
    "Finding": {"engine.verify", "workspace.discover"},
    "Material": {"materials", "mesh.reading.part"},
    "Occupancy": {"benchmarks.datasets.occupancy", "fem.occupancy"},
    "Options": {"engine.build", "released.convert"},
    "Outcome": {"engine.process", "fetch.run"},
    "Part": {"mesh.procedural.assembly", "mesh.reading.part", "released.checkpoint"},
    "Parts": {"mesh.reading.part", "objectfile.parts"},
    "Plan": {"benchmarks.datasets.grasp_data", "engine.dvc.graph"},
    "Status": {"engine.summary", "fetch.run"},
    "Surface": {"benchmarks.scoring.shapes", "mesh.closing.surface"},
    "Voxels": {"fem.voxel", "fem.voxelize"},
    "array_path": {"benchmarks.datasets.grasps", "benchmarks.datasets.observations"},
    "check": {"engine.node", "fetch.checksums"},
    "checks": {"fem.modal", "workspace.validate"},
    "describe": {"engine.dvc.full_disk", "engine.process"},
    "environment": {"benchmarks.tasks.reach", "engine.process"},
    "film": {"benchmarks.tasks.grasp_policy", "benchmarks.tasks.reach"},
    "fused": {"benchmarks.tasks.grasp_stability", "benchmarks.tasks.recognition"},
    "inside": {"mesh.reading.part", "mesh.scanline"},
    "joined": {"mesh.procedural.assembly", "objectfile.query", "vision.vectors"},
    "lattice": {"mesh.closing.contour", "mesh.procedural.texture"},
    "pack": {"mesh.procedural.atlas", "nets.int8", "objectfile.packing"},
    "play": {"benchmarks.tasks.grasp_policy", "benchmarks.tasks.reach"},
    "prepare": {"benchmarks.models.encoders", "engine.dvc.steps"},
    "read_checkpoint": {"benchmarks.models.training", "released.checkpoint"},
    "read_picture": {"benchmarks.tasks.photograph", "touch.photographs"},
    "read_rows": {"benchmarks.datasets.arrays", "io"},
    "record": {"engine.failures", "fetch.checksums"},
    "rounded": {"mesh.procedural.section", "nets.int8"},
    "select": {"fetch.catalogue", "vision.vectors"},
    "split": {"mesh.closing.topology", "mesh.normals"},
    "stage_params": {"benchmarks.params", "workspace.params"},
    "stored": {"fem.elements", "nets.released.network"},
    "survey": {"engine.prune", "workspace.discover"},
    "table": {"benchmarks.scoring.tables", "mesh.procedural.table", "workspace.discover"},
    "tetrahedra": {"fem.tetrahedra", "mesh.closing.topology"},
    "unit": {"mesh.normals", "touch.optics", "vision.vectors"},
    "unpack": {"fetch.archive", "nets.int8"},
    "validate": {"workspace.params", "workspace.validate"},
    "weld": {"mesh.closing.weld", "mesh.procedural.solid"},
}


def public_names():
    """Modules that define each public class or function at their top level, by name.

    Functions of ``cli`` are left out: a command is named as the function that it calls.
    """
    places = defaultdict(set)
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for node in ast.parse(path.read_text()).body:
            function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if not (function or isinstance(node, ast.ClassDef)) or node.name.startswith("_"):
                continue
            if not function or (parts[0] != "cli" and node.name != ENTRY_POINT):
                places[node.name].add(".".join(parts).removesuffix(".__init__"))
    return places


def test_a_name_stands_for_one_thing():
    names = {name: places for name, places in public_names().items() if len(places) > 1}
    found = {name: places for name, places in names.items() if not places <= SHARED.get(name, set())}
    assert not found
