"""Object Files: implicit multisensory objects that can be seen, struck and touched.

>>> from objectfolder import ObjectFile
>>> mug = ObjectFile.load("build/mug/ObjectFile.safetensors")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from objectfolder.objectfile.dataset import Dataset
    from objectfolder.objectfile.file import ObjectFile
    from objectfolder.sim.asset import asset

    __version__: str

__all__ = ["Dataset", "ObjectFile", "__version__", "asset"]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    # Lazy, so that a stage that imports one corner of the library does not load torch,
    # and does not depend on the query code.
    if name == "ObjectFile":
        return import_module("objectfolder.objectfile.file").ObjectFile
    if name == "Dataset":
        return import_module("objectfolder.objectfile.dataset").Dataset
    if name == "asset":
        return import_module("objectfolder.sim.asset").asset
    if name == "__version__":
        return import_module("objectfolder.base.installation").installed_version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
