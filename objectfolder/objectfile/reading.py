"""Reading of an Object File's parts: once, by one thread, and with damage named."""

import lzma
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.header import known_net
from objectfolder.objectfile.surface import ObjectSurface


class once(cached_property[Any]):
    """Property computed at first use by a single thread; the instance has a reentrant ``_lock``."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None or self.attrname in instance.__dict__:
            return super().__get__(instance, owner)
        with instance._lock:
            return super().__get__(instance, owner)


@contextmanager
def report_damage(key: str, part: str) -> Iterator[None]:
    """Turn what goes wrong while a part is built into an error that names the object and the part."""
    try:
        yield
    except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, lzma.LZMAError) as error:
        raise ObjectFolderError(f"{key}: the stored {part} is damaged ({error}); rebuild it") from error


def damaged_net(key: str, part: str) -> ObjectFolderError:
    """Return the error of a net whose answers are not finite."""
    return ObjectFolderError(
        f"{key}: the stored {part} net is damaged: it gives values that are not finite; rebuild it"
    )


@dataclass(frozen=True)
class StoredNet:
    """One net as it is stored, and the object that it belongs to."""

    part: str  #: vision, audio or touch
    header: dict[str, Any]  #: of the file
    tensors: dict[str, np.ndarray]  #: of the net
    surface: ObjectSurface
    device: torch.device  #: where the net is evaluated

    @property
    def key(self) -> str:
        """Object key."""
        return str(self.header["key"])

    @property
    def kind(self) -> str:
        """Kind of the net."""
        return str(self.header[self.part]["kind"])

    @property
    def config(self) -> dict[str, Any]:
        """Configuration of the net, without fields that only a newer version knows."""
        return known_net(self.part, self.header[self.part])

    def load(self, net: Any) -> Any:
        """Build the net from its class, on its device."""
        with report_damage(self.key, f"{self.part} net"):
            return net.from_tensors(self.tensors, self.config).to(self.device)
