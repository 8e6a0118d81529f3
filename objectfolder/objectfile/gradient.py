"""The modules of an Object File, made when first asked for."""

from functools import cached_property
from typing import Any, TypeVar

import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.parts import StoredParts
from objectfolder.sound.gradient import Sound
from objectfolder.stored.arguments import usual_modes
from objectfolder.stored.gradient_module import AnswerModule
from objectfolder.touch.gradient import Touch
from objectfolder.vision.gradient import View

DTYPES = (torch.float32, torch.float64)
_Made = TypeVar("_Made", bound=AnswerModule)


class Answers:
    """How an object looks, sounds and feels, as torch modules whose answers carry gradients.

    They compute on the CPU, in float32, or float64 for checks of gradients; their weights are copies, and
    need no gradients. A module is made when it is first asked for.
    """

    def __init__(self, parts: StoredParts, dtype: torch.dtype | None = None):
        dtype = torch.float32 if dtype is None else dtype
        if dtype not in DTYPES:
            raise ObjectFolderError(f"dtype is {dtype}, expected torch.float32 or torch.float64")
        self._parts, self.dtype = parts, dtype

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._parts, self.dtype)  # modules are made again

    @cached_property
    @usual_modes()
    def sound(self) -> Sound:
        """Strikes in, sounds out."""
        return self._made(Sound(self._parts.audio, self._parts.surface, self.dtype), "sound")

    @cached_property
    @usual_modes()
    def touch(self) -> Touch:
        """Poses of a tactile sensor in, images and contacts out."""
        return self._made(Touch(self._parts.touch, self.dtype), "touch")

    @cached_property
    @usual_modes()
    def view(self) -> View:
        """Cameras and lights in, images out."""
        return self._made(View(self._parts.vision, self.dtype), "view")

    def _made(self, module: _Made, name: str) -> _Made:
        module.source = _again, (self._parts, self.dtype, name)
        return module


def _again(parts: StoredParts, dtype: torch.dtype, name: str) -> AnswerModule:
    module: AnswerModule = getattr(Answers(parts, dtype), name)
    return module
