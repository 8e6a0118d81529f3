"""The Object File: its format, its parts, and the queries that it answers."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from objectfolder.objectfile.file import ObjectFile

__all__ = ["ObjectFile"]


def __getattr__(name: str) -> Any:
    # Lazy, so that a stage that reads only the header depends on that module alone.
    if name == "ObjectFile":
        return import_module("objectfolder.objectfile.file").ObjectFile
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
