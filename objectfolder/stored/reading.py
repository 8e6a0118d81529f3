"""Reading of an Object File's parts: once, by one thread, and with damage named."""

import lzma
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import friction_of
from objectfolder.stored.header import PARTS, RADIATION
from objectfolder.stored.kinds import known_kinds, known_net, net_kinds
from objectfolder.stored.released import RELEASED, released_net
from objectfolder.stored.surface import ObjectSurface

_Value = TypeVar("_Value")


class once(cached_property[Any]):
    """Property computed at first use by a single thread; the instance has a reentrant ``_lock``."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None or self.attrname in instance.__dict__:
            return super().__get__(instance, owner)
        with instance._lock:
            return super().__get__(instance, owner)


def read_once(read: Callable[[], _Value]) -> Callable[[], _Value]:
    """Return a function that reads at its first call, by a single thread, and keeps what it read."""
    lock, found = threading.RLock(), list[_Value]()

    def read_or_recall() -> _Value:
        if not found:
            with lock:
                if not found:
                    found.append(read())
        return found[0]

    return read_or_recall


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


def held_parts(header: dict[str, Any]) -> list[str]:
    """Return the names of the parts that a file holds."""
    return [part for part in (*PARTS, RADIATION) if part in header]


def described_part(header: dict[str, Any], part: str) -> dict[str, Any]:
    """Return the header of a part.

    Raises ObjectFolderError if the file lacks it, or a newer version made it.
    """
    if part not in header:
        held = ", ".join(held_parts(header)) or "nothing"
        raise ObjectFolderError(f"{header['key']}: the file holds no {part}; it holds {held}")
    found: dict[str, Any] = header[part]
    if found["kind"] not in known_kinds(part):
        raise ObjectFolderError(
            f"{header['key']}: {part} is of kind {found['kind']!r}, which this version does not know; "
            "update objectfolder"
        )
    return found


def checked_tensor(key: str, tensors: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Return a tensor of an object; it must be an array of finite numbers."""
    if name not in tensors:
        raise ObjectFolderError(f"{key}: the Object File lacks tensor {name}")
    value = tensors[name]
    if not isinstance(value, np.ndarray) or isinstance(value, np.ma.MaskedArray):
        raise ObjectFolderError(f"{key}: tensor {name} is a {type(value).__name__}, expected an array")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        raise ObjectFolderError(f"{key}: tensor {name} holds values that are not finite; rebuild it")
    return value


class StoredObject:
    """What all queries know of their `objectfolder.objectfile.file.ObjectFile`."""

    _parts: Any  # StoredParts, which import the queries

    @property
    def key(self) -> str:
        """Object key."""
        return str(self._parts.key)

    @property
    def material(self) -> str:
        """Material name."""
        return str(self._parts.header["material"])

    @property
    def friction(self) -> float:
        """Coefficient of dry sliding friction of the object's material, against a table or an elastomer."""
        stored = self._parts.header.get("material_properties", {})
        return float(stored.get("friction", friction_of(self.material)))

    @property
    def scale(self) -> float:
        """Longest side, metres."""
        return float(self._parts.header["scale"])


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

    @property
    def answers(self) -> str:
        """What the net is asked for: a key of ``SENSES`` beside its kind."""
        if self.kind in RELEASED:
            return RELEASED[self.kind][2]
        return str(net_kinds(self.part)[self.kind].answers)

    def load(self) -> Any:
        """Build the net, on its device."""
        released = self.kind in RELEASED
        net = released_net(self.kind) if released else net_kinds(self.part)[self.kind].net
        with report_damage(self.key, f"{self.part} net"):
            return net.from_tensors(self.tensors, self.config).to(self.device)
