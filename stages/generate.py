"""generate: parameters of a procedural object -> data/objects/<key>/mesh.glb."""

from pathlib import Path

from objectfolder.base.io import atomic
from objectfolder.shapes import generate
from objectfolder.workspace.params import procedural_entry
from stages import run


def main(key: str) -> None:
    generator, parameters = procedural_entry(key)
    mesh = generate(generator, **parameters)
    with atomic(Path("data/objects") / key / "mesh.glb") as path:
        mesh.write_glb(path)


if __name__ == "__main__":
    run(main, __doc__)
