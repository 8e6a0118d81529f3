"""Adds the pipeline of the top level to a wheel, for `objectfolder init`; all else is in pyproject.toml."""

import ast
import atexit
import shutil
import tempfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
MODULE = ROOT / "objectfolder" / "workspace" / "installed.py"


def constants() -> dict[str, tuple[str, ...]]:
    """Tuples of a module that a build does not import, as its dependencies are not there."""
    found: dict[str, tuple[str, ...]] = {}
    for node in ast.parse(MODULE.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            found[ast.unparse(node.targets[0])] = ast.literal_eval(node.value)
    return found


class BuildWithPipeline(build_py):
    """Copies the pipeline into the package; an editable install takes it from the repository."""

    def run(self) -> None:  # noqa: D102
        super().run()
        if self.editable_mode:
            return
        for pattern in constants()["PIPELINE_FILES"]:
            sources = sorted(ROOT.glob(pattern))
            if not sources:
                raise FileNotFoundError(f"{ROOT / pattern}, which a wheel needs")
            for source in sources:
                target = Path(self.build_lib, "objectfolder/workspace/pipeline", source.relative_to(ROOT))
                self.mkpath(str(target.parent))
                self.copy_file(str(source), str(target))


# Not build/, which holds the objects of this workspace, and would put files of earlier wheels into this one.
folder = tempfile.mkdtemp()
atexit.register(shutil.rmtree, folder, ignore_errors=True)
setup(cmdclass={"build_py": BuildWithPipeline}, options={"build": {"build_base": folder}})
