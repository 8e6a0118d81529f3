"""A project in miniature with the patterns of the real dvc.yaml, and what a build of it from nothing gives.

Every output is the text of what it was made from, so that the truth is a short function of the sources. Its
params.yaml is the real one: `parameters` has all that the project declares, so that a new one counts.
"""

import hashlib
import inspect
import json
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from dvc.repo import Repo

from objectfolder.shapes import GENERATORS
from objectfolder.workspace import params
from objectfolder.workspace.code_digests import imported_files, source_digest
from objectfolder.workspace.stages import SECTIONS

ROOT = Path(__file__).parents[2]
#: The first is tracked with DVC; the second is generated.
KEYS = ("bell", "mug")
STAGES = ("generate", "normalize", "observe", "recognize")
LIBRARY = ("shape", "materials")
PROFILES = ("digit", "own")
#: Of every module; a stage with the last one writes half of its outputs and fails.
VERSIONS = ("1", "2", "!")
#: Parameters that each stage reads: all of them, shared out.
DECLARED = {
    "generate": ("procedural.{key}",),
    "normalize": (*(f"objects.{{key}}.{name}" for name in ("mesh", "scale", "up", "wall", "bridge")), "seed"),
    "observe": ("objects.{key}.material", "sensor"),
    "recognize": ("objects", "benchmarks", "seed"),
}
for number, section in enumerate(SECTIONS):
    DECLARED[STAGES[1 + number % 3]] += (section,)

PIPELINE = f"""
stages:
  hash_code:
    cmd: python -m stages.hash_code
    deps: [objectfolder, stages]
    outs: [build/.code]
  generate:
    foreach: ${{procedural}}
    do:
      cmd: python -m stages.generate ${{key}}
      deps: [build/.code/generate.sha256]
      params: {json.dumps(DECLARED["generate"]).replace("{key}", "${key}")}
      outs: ["data/objects/${{key}}"]
  normalize:
    foreach: ${{objects}}
    do:
      cmd: python -m stages.normalize ${{key}}
      deps: [build/.code/normalize.sha256, "data/objects/${{key}}"]
      params: {json.dumps(DECLARED["normalize"]).replace("{key}", "${key}")}
      outs: ["build/${{key}}/surface.txt"]
  observe:
    foreach: ${{objects}}
    do:
      cmd: python -m stages.observe ${{key}}
      deps:
        - build/.code/observe.sha256
        - build/${{key}}/surface.txt
        - objectfolder/touch/profiles/${{sensor}}.yaml
      params: {json.dumps(DECLARED["observe"]).replace("{key}", "${key}")}
      outs: ["benchmarks/observations/${{key}}"]
      metrics: ["benchmarks/${{key}}.json"]
  recognize:
    cmd: python -m stages.recognize
    deps: [build/.code/recognize.sha256, benchmarks/observations]
    params: {json.dumps(DECLARED["recognize"])}
    metrics: [benchmarks/recognize.json]
"""


def read_values(values: Mapping[str, Any], stage: str, key: str) -> str:
    """Return a text that tells all values apart which a stage reads."""
    found = {}
    for name in DECLARED[stage]:
        value: Any = values
        for part in name.format(key=key).split("."):
            value = value[part]
        found[name] = value
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()[:16]


# Files are written in halves. `HALT` names a file after whose first half the engine gets a signal.
COMMON = f"""
import hashlib, json, os, sys, time
from pathlib import Path

params = json.loads(Path(os.environ.get("OBJECTFOLDER_PARAMS", "params.yaml")).read_text())
key = sys.argv[1] if len(sys.argv) > 1 else ""
DECLARED = {DECLARED}


{inspect.getsource(read_values).replace("Mapping[str, Any]", "dict").replace(": Any", "")}


def read(path):
    return Path(path).read_text()


def write(path, text, version):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w") as stream:
        stream.write(text[: len(text) // 2])
        stream.flush()
        if os.environ.get("HALT") == path:
            os.kill(int(os.environ["ENGINE"]), int(os.environ["SIGNAL"]))
            time.sleep(60)
        if version == "!":
            sys.exit(f"half of {{path}} is written")
        stream.write(text[len(text) // 2 :])
"""
SCRIPTS = {
    "generate": """
from stages import key, params, read_values, write
text = f"generate {VERSION} ({read_values(params, 'generate', key)})"
write(f"data/objects/{key}/mesh.obj", text, VERSION)
""",
    "normalize": """
from objectfolder.shape import SHAPE
from stages import key, params, read, read_values, write
mesh = read(f"data/objects/{key}/mesh.obj")
text = f"normalize {VERSION} {SHAPE} ({read_values(params, 'normalize', key)}, {mesh})"
write(f"build/{key}/surface.txt", text, VERSION)
""",
    "observe": """
from objectfolder.materials import MATERIALS
from stages import key, params, read, read_values, write
surface = read(f"build/{key}/surface.txt")
profile = read(f"objectfolder/touch/profiles/{params['sensor']}.yaml")
text = f"observe {VERSION} {MATERIALS} ({read_values(params, 'observe', key)}, {profile}, {surface})"
folder = f"benchmarks/observations/{key}"
write(f"{folder}/shared.txt", "the same for all", "")
write(f"{folder}/text.txt", text, VERSION)
write(f"benchmarks/{key}.json", f'"{len(text)}"', VERSION)
""",
    "recognize": """
from objectfolder.shape import SHAPE
from stages import params, read, read_values, write
texts = [read(f"benchmarks/observations/{key}/text.txt") for key in sorted(params["objects"])]
own = read_values(params, "recognize", "")
write("benchmarks/recognize.json", f'"{VERSION} {SHAPE} ({own}, {", ".join(texts)})"', VERSION)
""",
}


Names = tuple[str | int, ...]


def leaves(value: Any, path: Names = ()) -> Iterator[tuple[Names, Any]]:
    """Yield path and value of every parameter; a list of plain values is one."""
    nested = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(v, dict) for v in value))
    if not nested:
        yield path, value
        return
    for name, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from leaves(inner, (*path, name))


def others(value: Any) -> list[Any]:
    """Return two other values of a parameter; one if there are no more."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int | float):
        return [value + 1, 2 * value + 3]
    if isinstance(value, str):
        return [f"{value}2", f"{value}3"]
    return [0.5, 0.25] if value is None else [[*value, "one more"], [*value, "another"]]


def changed(values: Any, path: Names, value: Any) -> Any:
    """Copy nested parameters with another value of one."""
    if not path:
        return value
    copied = dict(values) if isinstance(values, dict) else list(values)
    copied[path[0]] = changed(copied[path[0]], path[1:], value)  # type: ignore[index,call-overload]
    return copied


@cache
def start() -> dict[str, Any]:
    """Return the real params.yaml with the objects `KEYS`."""
    values = params.read(ROOT / "params.yaml")
    values["objects"] = {key: values["objects"][key] for key in KEYS}
    values["procedural"] = {"mug": {"generator": "mug"}}
    return values


@cache
def parameters() -> dict[Names, list[Any]]:
    """Return three values of every parameter by its path, the first that of `start`, and no more than differ.

    Parameters of a generator stand for the whole entry of the object, as they depend on the generator.
    """
    found = {path: [value, *others(value)] for path, value in leaves(start()) if path[0] != "procedural"}
    found.pop(("sensor",))
    found["sensor",] = list(PROFILES)
    for key in KEYS:
        mixed = {"base": start()["objects"][key]["material"], "density": 1000.0}
        found["objects", key, "material"].append(mixed)
    for name, function in GENERATORS.items():
        entry = {"generator": name}
        entry |= {arg: p.default for arg, p in inspect.signature(function).parameters.items()}
        for arg in entry.keys() - {"generator"}:
            found["procedural", "mug", name, arg] = [entry, *(entry | {arg: v} for v in others(entry[arg]))]
    return found


@dataclass(frozen=True)
class Sources:
    """All that the outputs depend on."""

    #: Statement and docstring of every stage and library module.
    versions: dict[str, str] = field(default_factory=lambda: dict.fromkeys((*STAGES, *LIBRARY), "1"))
    prose: dict[str, str] = field(default_factory=lambda: dict.fromkeys((*STAGES, *LIBRARY), "1"))
    values: dict[str, Any] = field(default_factory=start)  #: params.yaml
    #: Content of the sensors' files.
    profiles: dict[str, str] = field(default_factory=lambda: dict.fromkeys(PROFILES, "1"))
    mesh: str = "mesh 1"  #: content of the tracked mesh
    keys: tuple[str, ...] = KEYS  #: objects in params.yaml

    def with_one(self, name: str, key: str, value: str) -> "Sources":
        """Copy with another value of one entry of a mapping."""
        return replace(self, **{name: {**getattr(self, name), key: value}})

    def with_parameter(self, path: Names, value: Any) -> "Sources":
        """Copy with another value of one of `parameters`."""
        place = path[:2] if path[0] == "procedural" else path
        return replace(self, values=changed(self.values, place, value))

    def params(self) -> str:
        """Text of params.yaml: JSON, which is YAML too."""
        groups = {
            g: {k: v for k, v in self.values[g].items() if k in self.keys} for g in ("objects", "procedural")
        }
        return json.dumps(self.values | groups, indent=1)

    def files(self) -> dict[str, str]:
        """Texts of the modules and the sensors by path."""

        def module(name: str, constant: str) -> str:
            return f'"""{self.prose[name]}"""\n{constant} = "{self.versions[name]}"\n'

        texts = {f"stages/{name}.py": module(name, "VERSION") + SCRIPTS[name] for name in STAGES}
        texts |= {f"objectfolder/{name}.py": module(name, name.upper()) for name in LIBRARY}
        return texts | {f"objectfolder/touch/profiles/{n}.yaml": text for n, text in self.profiles.items()}


def outputs(sources: Sources) -> dict[str, dict[str, str] | None]:
    """Files that each stage writes in a build from nothing, by address; None if it does not succeed."""
    v, code = sources.versions, sources.files()
    values = json.loads(sources.params())
    extra = {"stages/__init__.py": COMMON}
    imports = {"normalize": "shape", "observe": "materials", "recognize": "shape"}

    def listing(stage: str) -> str:
        names = [f"stages/{stage}.py", "stages/__init__.py"]
        names += [f"objectfolder/{imports[stage]}.py"] if stage in imports else []
        texts = code | extra
        return "".join(f"{source_digest(texts[n])}  {n}\n" for n in sorted(names))

    found: dict[str, dict[str, str] | None] = {
        "hash_code": {f"build/.code/{stage}.sha256": listing(stage) for stage in STAGES}
        | {f"build/.code/materials/{key}.sha256": "" for key in sources.keys}  # the project has no material
    }
    texts = []
    for key in sources.keys:
        mesh: str | None = sources.mesh
        if key == "mug":
            made = f"generate {v['generate']} ({read_values(values, 'generate', 'mug')})"
            mesh = made if v["generate"] != "!" else None
            found["generate@mug"] = None if mesh is None else {"data/objects/mug/mesh.obj": mesh}
        lost = mesh is None or v["normalize"] == "!"
        own = read_values(values, "normalize", key)
        surface = f"normalize {v['normalize']} {v['shape']} ({own}, {mesh})"
        found[f"normalize@{key}"] = None if lost else {f"build/{key}/surface.txt": surface}
        lost = lost or v["observe"] == "!"
        own = f"{read_values(values, 'observe', key)}, {sources.profiles[values['sensor']]}"
        text = f"observe {v['observe']} {v['materials']} ({own}, {surface})"
        texts.append(None if lost else text)
        folder = f"benchmarks/observations/{key}"
        found[f"observe@{key}"] = (
            None
            if lost
            else {
                f"{folder}/shared.txt": "the same for all",
                f"{folder}/text.txt": text,
                f"benchmarks/{key}.json": f'"{len(text)}"',
            }
        )
    whole = [text for text in texts if text is not None]
    own = read_values(values, "recognize", "")
    scores = f'"{v["recognize"]} {v["shape"]} ({own}, {", ".join(whole)})"'
    lost = len(whole) < len(texts) or v["recognize"] == "!"
    found["recognize"] = None if lost else {"benchmarks/recognize.json": scores}
    return found


def make(root: Path) -> None:
    """Make a workspace with the project in it."""
    texts = {**Sources().files(), "stages/__init__.py": COMMON}
    texts |= {"dvc.yaml": PIPELINE, "params.yaml": Sources().params()}
    make_workspace(root, texts | {"data/objects/bell/mesh.obj": Sources().mesh})


def make_workspace(root: Path, texts: dict[str, str]) -> None:
    """Make a workspace of files by path, with a tracked mesh of the object "bell"."""
    subprocess.run(["git", "init", "-q", root], check=True)
    with Repo.init(str(root)) as repo, repo.config.edit("repo") as config:
        config["core"].update({"analytics": False, "check_update": False, "remote": "store"})
        config["remote"]["store"] = {"url": str(root.parent / "store")}
    shutil.copy(ROOT / ".dvcignore", root)
    shutil.copy(ROOT / ".gitignore", root)
    real = {name: (ROOT / name).read_text() for name in imported_files("stages/hash_code.py", ROOT)}
    texts = texts | real | {"objectfolder/__init__.py": "", "objectfolder/workspace/__init__.py": ""}
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    with Repo(str(root)) as repo:
        repo.add(str(root / "data/objects/bell"))
