"""A project in miniature with the patterns of the real dvc.yaml, and what a build of it from nothing gives.

Every output is the text of what it was made from, so that the truth is a short function of the sources.
"""

import hashlib
import json
import shutil
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path

from dvc.repo import Repo

ROOT = Path(__file__).parents[2]
#: The first is tracked with DVC; the second is generated.
KEYS = ("bell", "mug")
STAGES = ("generate", "normalize", "observe", "recognize")
LIBRARY = ("shape", "sound")
#: Of every module; a stage with the last one writes half of its outputs and fails.
VERSIONS = ("1", "2", "!")

PIPELINE = """
stages:
  hash_code:
    cmd: python -m stages.hash_code
    deps: [objectfolder, stages]
    outs: [build/.code]
  generate:
    foreach: ${procedural}
    do:
      cmd: python -m stages.generate ${key}
      deps: [build/.code/generate.sha256]
      params: ["procedural.${key}"]
      outs: ["data/objects/${key}"]
  normalize:
    foreach: ${objects}
    do:
      cmd: python -m stages.normalize ${key}
      deps: [build/.code/normalize.sha256, "data/objects/${key}"]
      params: ["objects.${key}.size"]
      outs: ["build/${key}/surface.txt"]
  observe:
    foreach: ${objects}
    do:
      cmd: python -m stages.observe ${key}
      deps: [build/.code/observe.sha256, "build/${key}/surface.txt"]
      params: ["objects.${key}.material"]
      outs: ["benchmarks/observations/${key}"]
      metrics: ["benchmarks/${key}.json"]
  recognize:
    cmd: python -m stages.recognize
    deps: [build/.code/recognize.sha256, benchmarks/observations]
    params: [objects]
    metrics: [benchmarks/recognize.json]
"""

# Files are written in halves. `HALT` names a file after whose first half the engine gets a signal.
COMMON = """
import json, os, sys, time
from pathlib import Path

params = json.loads(Path(os.environ.get("OBJECTFOLDER_PARAMS", "params.yaml")).read_text())
key = sys.argv[1] if len(sys.argv) > 1 else ""


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
            sys.exit(f"half of {path} is written")
        stream.write(text[len(text) // 2 :])
"""
SCRIPTS = {
    "generate": """
from stages import key, params, write
text = f"generate {VERSION} ({params['procedural'][key]})"
write(f"data/objects/{key}/mesh.obj", text, VERSION)
""",
    "normalize": """
from objectfolder.shape import SHAPE
from stages import key, params, read, write
mesh = read(f"data/objects/{key}/mesh.obj")
text = f"normalize {VERSION} {SHAPE} ({params['objects'][key]['size']}, {mesh})"
write(f"build/{key}/surface.txt", text, VERSION)
""",
    "observe": """
from objectfolder.sound import SOUND
from stages import key, params, read, write
surface = read(f"build/{key}/surface.txt")
text = f"observe {VERSION} {SOUND} ({params['objects'][key]['material']}, {surface})"
folder = f"benchmarks/observations/{key}"
write(f"{folder}/shared.txt", "the same for all", "")
write(f"{folder}/text.txt", text, VERSION)
write(f"benchmarks/{key}.json", f'"{len(text)}"', VERSION)
""",
    "recognize": """
from objectfolder.shape import SHAPE
from stages import params, read, write
texts = [read(f"benchmarks/observations/{key}/text.txt") for key in sorted(params["objects"])]
write("benchmarks/recognize.json", f'"{VERSION} {SHAPE} ({", ".join(texts)})"', VERSION)
""",
}
IO = """
import hashlib
from pathlib import Path


def file_digest(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def write_text(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
"""


@dataclass(frozen=True)
class Sources:
    """All that the outputs depend on.

    Parameters
    ----------
    versions : dict of str to str
        Of every stage and library module.
    size, material : dict of str to str
        Parameters of each object.
    turns : str
        Parameter of the generator.
    mesh : str
        Content of the tracked mesh.
    keys : tuple of str
        Objects in params.yaml.
    """

    versions: dict[str, str] = field(default_factory=lambda: dict.fromkeys((*STAGES, *LIBRARY), "1"))
    size: dict[str, str] = field(default_factory=lambda: dict.fromkeys(KEYS, "1"))
    material: dict[str, str] = field(default_factory=lambda: dict.fromkeys(KEYS, "steel"))
    turns: str = "1"
    mesh: str = "mesh 1"
    keys: tuple[str, ...] = KEYS

    def with_one(self, name: str, key: str, value: str) -> "Sources":
        """Copy with another value of one entry of a mapping."""
        return replace(self, **{name: {**getattr(self, name), key: value}})

    def params(self) -> str:
        """Text of params.yaml: JSON, which is YAML too."""
        objects = {key: {"size": self.size[key], "material": self.material[key]} for key in self.keys}
        generated = {"mug": {"turns": self.turns}} if "mug" in self.keys else {}
        return json.dumps({"objects": objects, "procedural": generated}, indent=1)

    def code(self) -> dict[str, str]:
        """Texts of the modules by path."""
        scripts = {
            f"stages/{name}.py": f'VERSION = "{self.versions[name]}"\n{SCRIPTS[name]}' for name in STAGES
        }
        library = {f"objectfolder/{n}.py": f'{n.upper()} = "{self.versions[n]}"\n' for n in LIBRARY}
        return scripts | library


def outputs(sources: Sources) -> dict[str, dict[str, str] | None]:
    """Files that each stage writes in a build from nothing, by address; None if it does not succeed."""
    v, code = sources.versions, sources.code()
    extra = {"stages/__init__.py": COMMON}
    sounds = {"normalize": "shape", "observe": "sound", "recognize": "shape"}

    def listing(stage: str) -> str:
        names = [f"stages/{stage}.py", "stages/__init__.py"]
        names += [f"objectfolder/{sounds[stage]}.py"] if stage in sounds else []
        texts = code | extra
        return "".join(f"{hashlib.sha256(texts[n].encode()).hexdigest()}  {n}\n" for n in sorted(names))

    found: dict[str, dict[str, str] | None] = {
        "hash_code": {f"build/.code/{stage}.sha256": listing(stage) for stage in STAGES}
    }
    texts = []
    for key in sources.keys:
        mesh: str | None = sources.mesh
        if key == "mug":
            mesh = (
                f"generate {v['generate']} ({{'turns': '{sources.turns}'}})" if v["generate"] != "!" else None
            )
            found["generate@mug"] = None if mesh is None else {"data/objects/mug/mesh.obj": mesh}
        lost = mesh is None or v["normalize"] == "!"
        surface = f"normalize {v['normalize']} {v['shape']} ({sources.size[key]}, {mesh})"
        found[f"normalize@{key}"] = None if lost else {f"build/{key}/surface.txt": surface}
        lost = lost or v["observe"] == "!"
        text = f"observe {v['observe']} {v['sound']} ({sources.material[key]}, {surface})"
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
    scores = f'"{v["recognize"]} {v["shape"]} ({", ".join(whole)})"'
    lost = len(whole) < len(texts) or v["recognize"] == "!"
    found["recognize"] = None if lost else {"benchmarks/recognize.json": scores}
    return found


def make(root: Path) -> None:
    """Make a workspace with the project in it."""
    subprocess.run(["git", "init", "-q", root], check=True)
    with Repo.init(str(root)) as repo, repo.config.edit("repo") as config:
        config["core"].update({"analytics": False, "check_update": False, "remote": "store"})
        config["remote"]["store"] = {"url": str(root.parent / "store")}
    (root / "dvc.yaml").write_text(PIPELINE)
    shutil.copy(ROOT / ".dvcignore", root)
    shutil.copy(ROOT / ".gitignore", root)
    texts = {**Sources().code(), "stages/__init__.py": COMMON, "objectfolder/io.py": IO}
    for name in ("errors", "workspace/code_digests", "workspace/installed", "workspace/layout"):
        texts[f"objectfolder/{name}.py"] = (ROOT / "objectfolder" / f"{name}.py").read_text()
    texts["stages/hash_code.py"] = (ROOT / "stages/hash_code.py").read_text()
    texts |= {"objectfolder/__init__.py": "", "objectfolder/workspace/__init__.py": ""}
    texts["params.yaml"] = Sources().params()
    texts["data/objects/bell/mesh.obj"] = Sources().mesh
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    with Repo(str(root)) as repo:
        repo.add(str(root / "data/objects/bell"))
