"""Compiled modules that Python compares with the source by content."""

import py_compile
from contextlib import suppress
from importlib.util import cache_from_source
from pathlib import Path

from objectfolder.workspace.code_digests import PACKAGES

#: Offset in a ``.pyc`` file of the flags; 0: compared by time and size of the source.
FLAGS = slice(4, 8)


def compare_by_content(root: Path) -> None:
    """Compile again what Python would compare with its source by size and time alone.

    The time counts whole seconds: after an edit that keeps the size, a stage could run the old code. Python
    keeps the kind of comparison when it compiles an edited module again.

    Parameters
    ----------
    root : Path
        Directory that contains the packages of the project.
    """
    for source in (path for package in PACKAGES for path in (root / package).rglob("*.py")):
        compiled = cache_from_source(str(source))
        with suppress(OSError):  # never imported, or a read-only directory
            if not any(Path(compiled).read_bytes()[FLAGS]):
                mode = py_compile.PycInvalidationMode.CHECKED_HASH
                py_compile.compile(str(source), compiled, invalidation_mode=mode, quiet=2)
