"""No writer follows a link that it did not make, at what it writes or at a name that it uses meanwhile.

Files are written through `objectfolder.base.io.atomic` and `objectfolder.base.disk.new_folder`, or they are
listed here with the reason why not.
"""

import ast
import os
import shutil
from contextlib import chdir
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from folders import contents
from own_workspace import ROOT
from refusals import refused

from objectfolder.base import arrays, io
from objectfolder.base.figures import page, save_page
from objectfolder.benchmarks.datasets.export import write_datasets, write_webdataset
from objectfolder.benchmarks.datasets.lerobot import write_lerobot
from objectfolder.benchmarks.datasets.nerfstudio import write_nerfstudio
from objectfolder.benchmarks.datasets.observations import Observations, find_folders
from objectfolder.benchmarks.datasets.sampling import sample_observations
from objectfolder.benchmarks.datasets.settings import ObserveConfig
from objectfolder.benchmarks.datasets.splits import named_split
from objectfolder.benchmarks.reporting.film import write_gif
from objectfolder.benchmarks.tasks.photograph import write_mesh
from objectfolder.benchmarks.tasks.running import write_results
from objectfolder.cli import app
from objectfolder.cli.encoding import write_video
from objectfolder.engine.dvc.inputs import hold_params
from objectfolder.engine.dvc.lockfile import LockFiles
from objectfolder.engine.process import Children, Command, CommandResult
from objectfolder.engine.records import record_cost, record_failure
from objectfolder.engine.summary import StageOutcome, StageResult
from objectfolder.hub.fetch.run import record_checksums
from objectfolder.nets.checkpoint import Checkpoint
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.samples import sample_path
from objectfolder.sim.export import write_mjcf, write_urdf
from objectfolder.sim.gltf import write_glb
from objectfolder.touch.calibration import SensorFit, save_fit
from objectfolder.touch.profiles import load_profile
from objectfolder.workspace.creation import create_workspace
from objectfolder.workspace.layout import Benchmarks, Build
from objectfolder.workspace.objects import add_catalogue, add_mesh, set_material
from objectfolder.workspace.template import note_foreign_code

MODULES = sorted([*ROOT.glob("objectfolder/**/*.py"), *ROOT.glob("stages/*.py")])

#: Blocks whose target is a path or a stream of their own.
OWN = {"atomic", "atomic_stream", "new_folder", "_new_folder", "export_folder"}
OWN |= {"TemporaryDirectory", "TemporaryFile"}
#: Calls that write a file at a path, or move or remove more than a name, by the name of the function.
WRITES = {
    *("write_text", "write_bytes", "save_file", "savefig", "savez", "savez_compressed", "tofile", "imwrite"),
    *("copyfile", "copy2", "copytree", "copyfileobj", "rmtree", "rename", "renames", "symlink_to"),
    *("symlink", "hardlink_to", "mkdtemp", "mkstemp", "NamedTemporaryFile", "ParquetWriter", "Export"),
    *("write_glb", "write_surface", "write_scene", "extractall"),
}
#: Functions that write otherwise, and why no link leads them astray.
EXCEPTIONS = {
    # What the two ways are made of.
    "objectfolder/base/disk.py:new_folder": "makes and removes the folder, whose name is random",
    "objectfolder/base/disk.py:_place": "renames it over an empty folder that it has made itself",
    "objectfolder/base/io.py:_replace": "renames the file, whose name is random",
    "objectfolder/base/io.py:atomic_stream": "opens the descriptor of the file",
    "objectfolder/base/io.py:keep": "a hard link of a random name",
    "objectfolder/base/locks.py:claim_file": "O_EXCL and O_NOFOLLOW",
    "objectfolder/base/locks.py:remove_unused": "rmtree follows no links; in a progress folder",
    # The caller gives a path or a folder of its own.
    "objectfolder/benchmarks/datasets/lerobot.py:_write_frames": "in the new folder of write_lerobot",
    "objectfolder/sim/export.py:_write_meshes": "in an export_folder",
    "objectfolder/sim/gltf.py:fill_glb": "in an export_folder, or the new folder of an asset",
    "objectfolder/sim/usd.py:fill_usd": "in an export_folder, or the new folder of an asset",
    "objectfolder/hub/fetch/files.py:collect": "in a folder that it makes, in a temporary one",
    "objectfolder/hub/fetch/archive.py:extract": "removes the folder that it has made",
    "objectfolder/hub/fetch/archive.py:_extract_tar": "in the folder that extract has made; no links",
    "objectfolder/mesh/ply.py:write_surface": "callers give the path of an atomic",
    "objectfolder/mesh/textured.py:TexturedMesh.write_glb": "callers give the path of an atomic",
    "objectfolder/vision/renderers/cycles.py:CyclesRenderer.__init__": "in a TemporaryDirectory",
    "objectfolder/vision/renderers/cycles.py:write_scene": "in the TemporaryDirectory of the renderer",
    "objectfolder/vision/renderers/blender_scene.py:main": "in the TemporaryDirectory of the renderer",
    # Names that were written before, or are new.
    "objectfolder/benchmarks/datasets/grasp_data.py:collect_grasps": "removes its batches; refuse_links",
    "objectfolder/benchmarks/tasks/running.py:write_results": "a rename, which replaces links; refuse_links",
    "objectfolder/cli/view.py:view": "a new folder of mkdtemp",
    "objectfolder/engine/dvc/lockfile.py:LockFiles._restore": "a rename, which replaces links",
    "objectfolder/engine/dvc/replacements.py:replacements": "DVC gives a random name in the run cache",
    "objectfolder/engine/dvc/runcache.py:remove_saved_run": "a rename to a random name",
    "objectfolder/engine/process.py:Children.run": "a pipe",
    "objectfolder/engine/process.py:open_log": "O_NOFOLLOW; a link is removed before",
    "objectfolder/engine/verify.py:restore_files": "rmtree of an output, which follows no link",
    "objectfolder/base/download.py:_receive": "O_EXCL, or goes on with a file of its own",
    "objectfolder/base/download.py:download_to": "a rename, which replaces links, into a new folder",
    "objectfolder/hub/fetch/run.py:_fetch": "temporary folders; those that were left, under a lock",
    "objectfolder/objectfile/online.py:WebRelease.fetch": "a rename, which replaces links, under a lock",
    "objectfolder/workspace/creation.py:_create": "removes what it has made under the lock of the folder",
    "objectfolder/workspace/objects.py:add_mesh": "removes the folder that it has placed",
    "objectfolder/cli/__init__.py:main": "opens the null device",
    "objectfolder/engine/warm.py:serve": "opens the null device",
}


class Writers(ast.NodeVisitor):
    """Collects the functions that write to a path which no block of `OWN` gave them."""

    def __init__(self, module: str):
        self.module, self.found = module, {}
        self.where: list[str] = []
        self.own: set[str] = set()

    def visit_FunctionDef(self, node):
        outer = set(self.own)
        self.where.append(node.name)
        self.generic_visit(node)
        self.where.pop()
        self.own = outer

    visit_ClassDef = visit_FunctionDef

    def visit_With(self, node):
        for item in node.items:
            self.visit(item.context_expr)
            of_block = isinstance(item.context_expr, ast.Call) and called(item.context_expr) in OWN
            if item.optional_vars is not None and (of_block or self.is_own(item.context_expr)):
                self.own |= names(item.optional_vars)
        for statement in node.body:
            self.visit(statement)

    def visit_Assign(self, node):
        self.generic_visit(node)
        if self.is_own(node.value):
            for target in node.targets:
                self.own |= names(target)

    def visit_Call(self, node):
        if writes(node) and not self.is_own(node):
            self.found.setdefault(f"{self.module}:{'.'.join(self.where)}", ast.unparse(node))
        self.generic_visit(node)

    def is_own(self, node):
        return bool(names(node) & self.own)


def names(node):
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)}


def called(call):
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def writes(call):
    name, module = called(call), getattr(getattr(call.func, "value", None), "id", "")
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    if name in ("open", "fdopen"):
        parts = [part for value in given for part in ast.walk(value)]
        modes = {part.value for part in parts if isinstance(part, ast.Constant)}
        flags = ast.unparse(call)
        plain = any(isinstance(mode, str) and len(mode) < 4 and set(mode) & set("wax+") for mode in modes)
        return plain or any(flag in flags for flag in ("O_WRONLY", "O_RDWR", "O_CREAT"))
    if name == "replace":  # of a path; that of a text takes two
        return module == "os" or (len(call.args) == 1 and not call.keywords)
    if name == "write_table":  # of pyarrow; that of objectfolder.base.io takes three
        return len(given) == 2
    if name == "save":
        return module in ("np", "numpy", "torch")
    if name in ("write_text", "write_bytes"):  # of a path; those of objectfolder.base.io are functions
        return isinstance(call.func, ast.Attribute)
    named = {"os": ("link", "truncate"), "shutil": ("copy", "move")}.get(module, ())
    return name in WRITES or name in named


def written(module):
    writers = Writers(module.relative_to(ROOT).as_posix())
    writers.visit(ast.parse(module.read_text()))
    return writers.found


def test_no_module_writes_otherwise():
    found = {where: call for module in MODULES for where, call in written(module).items()}
    assert len(MODULES) > 400
    assert {where: call for where, call in found.items() if where not in EXCEPTIONS} == {}
    assert sorted(EXCEPTIONS.keys() - found.keys()) == []  # an exception that nobody needs


# Every writer, run


@dataclass(frozen=True)
class Given:
    """What writers get: a folder, in which they run, and things that cost time to make."""

    brick: ObjectFile
    path: Path  #: of the brick
    observed: Path  #: observations of two objects


def command(*words):
    """A command line, whose FILE is the brick."""

    def write(given):
        app([str(given.path) if word == "FILE" else word for word in words], standalone_mode=False)

    return write


def with_queries(modality):
    def write(given):
        Path("in").mkdir()
        command("sample", modality, *["FILE"] * (modality != "vision"), "in/q.npy", "-n1")(given)
        command("query", modality, "FILE", "in/q.npy", "out")(given)

    return write


def add(given):
    Path("in").mkdir(exist_ok=True)
    given.brick.to_mesh().export("in/brick.glb")
    add_mesh(Path("in/brick.glb"), "brick", "wood", 0.2, "z", track=lambda path, root: None)


def release(given):
    io.write_bytes(Build("die").object_file, sample_path("die").read_bytes())
    command("release", "die", "out", "--licence", "CC0-1.0", "--draft")(given)


def video(given):
    encode = Path("encode.sh")
    encode.write_text('#!/bin/sh\nfor out in "$@"; do :; done; cat > "$out"\n')
    encode.chmod(0o755)
    frames = [np.zeros((4, 4, 3), np.uint8)] * 2
    write_video(str(encode.absolute()), Path("a.mp4"), frames, 2, 2.0, (4, 4), np.zeros(100), 100)


def sensor_fit(given):
    profile = load_profile("digit")
    fit = SensorFit(profile, np.zeros((profile.height, profile.width, 3), np.uint8), [], [], 1.0, 2.0)
    save_fit(fit, "mine.yaml", "mine", "a test")


def lock_file(given):
    files, path = LockFiles(Path()), Path("dvc.lock")
    files.stages(path).update(a={"cmd": "true"}, b={"cmd": "true"})
    files.remove(path, "b")
    files.flush()


def log(given):
    children = Children()
    assert children.run(Command(["echo hello"], Path(), dict(os.environ), Path("logs/a@b.log"))).code == 0


def results(given):
    progress, task = Path("progress"), SimpleNamespace(name="recognize", columns=["step"])
    io.write_json(progress / "model.safetensors", 1)
    write_results(task, "seen", Benchmarks("out"), progress, {"accuracy": 1}, [[1]])


def exported(write):
    def written(given):
        observations = Observations(find_folders([given.observed]))
        write(observations, named_split("seen", observations.keys, observations.count), Path("out"))

    return written


OBSERVED = ObserveConfig(observations=10, resolution=8)
HULL = trimesh.creation.box((0.1, 0.06, 0.03))
SMALL = {"a": np.zeros(2)}
WRITERS = {
    "json": lambda given: io.write_json("a.json", {}),
    "text": lambda given: io.write_text("a.txt", "a"),
    "bytes": lambda given: io.write_bytes("sub/a.bin", b"a"),
    "npz": lambda given: arrays.write_npz("a.npz", **SMALL),
    "npy": lambda given: arrays.write_npy("a.npy", SMALL["a"]),
    "safetensors": lambda given: arrays.write_safetensors("a.safetensors", SMALL, {}),
    "png": lambda given: arrays.write_png("a.png", np.zeros((2, 2), np.uint8)),
    "table": lambda given: io.write_table("a.csv", ["a"], [[1.0]]),
    "kept": lambda given: io.keep(given.path, "a.safetensors"),
    "page": lambda given: save_page(page(1, 1, "a"), Path("a.png")),
    "film": lambda given: write_gif(Path("a.gif"), [np.zeros((2, 2, 3), np.uint8)] * 2, 0.1),
    "object file": lambda given: given.brick.save("a.safetensors"),
    "mesh": lambda given: write_mesh("a.glb", HULL.vertices, HULL.faces),
    "view": command("view", "FILE", "--out", "page.html", "--no-open"),
    "report": command("report", "FILE", "--out", "site", "--no-open"),
    "page of a report": command("report", "FILE", "--single-file", "--out", "report.html", "--no-open"),
    "video": video,
    "sample vision": command("sample", "vision", "a.npy"),
    "sample audio": command("sample", "audio", "FILE", "a.npy", "--forces", "b.npy"),
    "sample touch": command("sample", "touch", "FILE", "a.npy", "--gelinfo", "b.npy"),
    "query vision": with_queries("vision"),
    "query audio": with_queries("audio"),
    "query touch": with_queries("touch"),
    "sensor export": command("sensor", "export", "digit", "--taxim", "out"),
    "sensor fit": sensor_fit,
    "preset": command("preset", "standard"),
    "material": lambda given: set_material("mug", {"like": "steel", "density": 1.0}),
    "add": add,
    "catalogue": lambda given: add_catalogue(ROOT / "catalogs/thin.yaml"),
    "release": release,
    "checksums": lambda given: record_checksums(Path("data/checksums.yaml"), "mug", {"a": "b"}),
    "lock file": lock_file,
    "held parameters": lambda given: hold_params([], Path(), Path("held")),
    "own code": lambda given: note_foreign_code(Path.cwd(), [Path.cwd() / "params.yaml"], Path("notes")),
    "cost": lambda given: record_cost(Path("logs"), "a@b", CommandResult(0, 1.0, 1.0)),
    "failure": lambda given: record_failure(Path("logs"), StageResult("a@b", StageOutcome.FAILED), {}),
    "log": log,
    "checkpoint": lambda given: Checkpoint(Path("a.pt"), "x").save({}),
    "results": results,
    "workspace": lambda given: create_workspace(Path("new"), lambda root: None),
    "observations": lambda given: sample_observations(given.brick, OBSERVED, 0, "out"),
    "webdataset": exported(write_webdataset),
    "datasets": exported(write_datasets),
    "lerobot": lambda given: write_lerobot([given.brick], "out", 1, 0.2, 25),
    "nerfstudio": lambda given: write_nerfstudio(given.brick, "out", 1, 8),
    "mjcf": lambda given: write_mjcf(given.brick, "out", hulls=[HULL]),
    "urdf": lambda given: write_urdf(given.brick, "out", hulls=[HULL]),
    "glb": lambda given: write_glb(given.brick, "out", hulls=[HULL]),
}
#: Those that replace nothing: they refuse an output that exists, or ask for an empty folder.
NEW_ONLY = {
    *("query vision", "query audio", "query touch", "sensor export", "add", "release", "workspace"),
    *("webdataset", "datasets", "lerobot", "nerfstudio", "mjcf", "urdf", "glb"),
}
#: Inputs that writers of the table make.
INPUTS = ("in/", "build/", "encode.sh", "progress/")
#: Contents of outputs that are inputs, too.
TEXTS = {"params.yaml": (ROOT / "params.yaml").read_text(), "data/checksums.yaml": "{}\n"}


@pytest.fixture(scope="module")
def given(brick, brick_path, tmp_path_factory):
    folder = tmp_path_factory.mktemp("observed")
    for key in ("brick", "other"):
        file = ObjectFile(brick.header | {"key": key}, brick.tensors)
        sample_observations(file, OBSERVED, 0, folder / key)
    return Given(brick, brick_path, folder)


@pytest.fixture(scope="module")
def outputs(given, tmp_path_factory):
    """Returns what a writer writes, by name; runs it once."""

    @cache
    def of(name):
        place = tmp_path_factory.mktemp("clean")
        with chdir(place):
            begin()
            before = contents(Path())
            WRITERS[name](given)
            found = [path for path, text in contents(Path()).items() if before.get(path) != text]
        written = [path for path in found if not path.startswith(INPUTS)]
        assert written
        return written

    return of


def begin():
    """Put into the current folder what makes it a workspace."""
    shutil.copyfile(ROOT / "params.yaml", "params.yaml")
    shutil.copytree(ROOT / "params", "params")


def former(path):
    """The name that writers used meanwhile, which others could foresee."""
    return path.with_name(f".{path.stem}.tmp{path.suffix}")


@pytest.mark.parametrize("trap", ["link", "dangling link", "former name", "hard link of the former name"])
@pytest.mark.parametrize("name", WRITERS)
def test_no_writer_follows_a_link(name, trap, given, outputs, tmp_path, monkeypatch):
    workspace, victims = tmp_path / "here", tmp_path / "victims"
    workspace.mkdir()
    victims.mkdir()
    monkeypatch.chdir(workspace)
    begin()
    at_outputs, new_only = "former" not in trap, name in NEW_ONLY
    planted = set(outputs(name))
    if not at_outputs:
        planted = {former(Path(path)) for path in {Path(path).parts[0] for path in planted} | planted}
        if new_only:
            planted = {path for path in planted if len(path.parts) == 1}
    before = {}
    for number, path in enumerate(sorted(map(Path, planted))):
        victim = victims / str(number)
        if "dangling" not in trap:
            before[victim] = TEXTS.get(path.as_posix(), "precious")  # it is read through the link
            victim.write_text(before[victim])
        elif path.exists():
            continue  # an input
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.hardlink_to(victim) if "hard" in trap else path.symlink_to(victim)
    if at_outputs and new_only:
        refused(None, WRITERS[name], given)
    else:
        WRITERS[name](given)
        assert all(Path(output).is_file() and not Path(output).is_symlink() for output in outputs(name))
    assert {path: path.read_text() for path in victims.iterdir()} == before
    if not at_outputs:
        assert all(os.path.lexists(path) for path in planted)  # of others: not removed, either
