"""The parts of an Object File: each is read and checked when a query first needs it."""

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.featurecodec import COUNTED, Features, unpack_features
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import unpack_grid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.released.registry import trained_box
from objectfolder.objectfile.audio import AudioSense, audio_sense
from objectfolder.objectfile.header import PARTS, RADIATION, known_kinds
from objectfolder.objectfile.radiation import Radiation
from objectfolder.objectfile.reading import StoredNet, once, report_damage
from objectfolder.objectfile.surface import TOLERANCE, ObjectSurface
from objectfolder.objectfile.touch import TouchSense, touch_sense
from objectfolder.objectfile.vision import VisionSense, vision_sense

TAPS = 2000  #: points of the surface whose mode shapes are kept for rough answers


class StoredGeometry:
    """Header and tensors of an Object File, and the surface that they hold.

    `StoredParts` and `ObjectSurface` share it, so that neither has to hold the other.

    Parameters
    ----------
    header : dict
    tensors : mapping of arrays
    """

    def __init__(self, header: dict[str, Any], tensors: Mapping[str, np.ndarray]):
        self.header, self.tensors, self.key = header, tensors, str(header["key"])
        self._lock = threading.RLock()

    @once
    def surface(self) -> Isosurface:
        """The stored surface, unit frame."""
        config = self.described("geometry")
        packed = self.tensor("geometry.distances")
        with report_damage(self.key, "distance grid"):
            values = unpack_grid(packed, int(config["resolution"]), config["predictor"])
            surface = Isosurface(DistanceGrid(values, config["band"], self._features(config)))
            if not len(surface.faces):
                raise ValueError("no surface")
            return surface

    def _features(self, config: dict[str, Any]) -> Features | None:
        counts = {name: config.get(name, 0) for name in COUNTED}
        if not any(counts.values()):
            return None
        return unpack_features(self.tensor("geometry.features"), counts, int(config["resolution"]))

    def held(self) -> list[str]:
        """Return the names of the parts that the file holds."""
        return [part for part in (*PARTS, RADIATION) if part in self.header]

    def described(self, part: str) -> dict[str, Any]:
        """Return the header of a part.

        Raises
        ------
        ObjectFolderError
            If the file lacks it, or a newer version made it.
        """
        if part not in self.header:
            raise ObjectFolderError(
                f"{self.key}: the file holds no {part}; it holds {', '.join(self.held()) or 'nothing'}"
            )
        found = self.header[part]
        if found["kind"] not in known_kinds(part):
            raise ObjectFolderError(
                f"{self.key}: {part} is of kind {found['kind']!r}, which this version does not know; "
                "update objectfolder"
            )
        return found

    def tensor(self, name: str) -> np.ndarray:
        """Return a tensor, checked."""
        if name not in self.tensors:
            raise ObjectFolderError(f"{self.key}: the Object File lacks tensor {name}")
        value = self.tensors[name]
        if not isinstance(value, np.ndarray) or isinstance(value, np.ma.MaskedArray):
            raise ObjectFolderError(
                f"{self.key}: tensor {name} is a {type(value).__name__}, expected an array"
            )
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ObjectFolderError(f"{self.key}: tensor {name} holds values that are not finite; rebuild it")
        return value


class StoredParts:
    """Surface and senses of an Object File.

    Parameters
    ----------
    header : dict
        Checked; see `objectfolder.objectfile.header.checked_header`.
    tensors : mapping of arrays
    device : torch.device
        Where nets are evaluated.
    """

    def __init__(self, header: dict[str, Any], tensors: Mapping[str, np.ndarray], device: torch.device):
        self.header, self.tensors, self.device = header, tensors, device
        self.key = str(header["key"])
        self._stored = stored = StoredGeometry(header, tensors)
        self.surface = ObjectSurface(lambda: stored.surface, float(header["scale"]), "geometry" in header)
        self._lock = threading.RLock()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.header, self.tensors, self.device)  # parts are read again

    def check(self) -> None:
        """Read all parts that the file holds.

        Raises
        ------
        ObjectFolderError
            If one is damaged.
        """
        for part in self.held():
            getattr(self, part)

    def held(self) -> list[str]:
        """Return the names of the parts that the file holds."""
        return self._stored.held()

    def described(self, part: str) -> dict[str, Any]:
        """Return the header of a part; see `StoredGeometry.described`."""
        return self._stored.described(part)

    @property
    def geometry(self) -> Isosurface:
        """The stored surface, unit frame."""
        surface: Isosurface = self._stored.surface
        return surface

    @once
    def vision(self) -> VisionSense:
        """How the object looks."""
        return vision_sense(self._net("vision"))

    @once
    def audio(self) -> AudioSense:
        """How the object sounds."""
        return audio_sense(self._net("audio"))

    @once
    def taps(self) -> tuple[np.ndarray, np.ndarray]:
        """`TAPS` fixed points of the surface, (T, 3) metres, and the mode shapes there, (T, 3, M) kg^-1/2."""
        points = self.surface.sample(TAPS, np.random.default_rng(0))
        return points, self.audio.mode_shapes(points, TOLERANCE)

    @once
    def touch(self) -> TouchSense:
        """How the object feels."""
        return touch_sense(self._net("touch"))

    @once
    def radiation(self) -> Radiation:
        """What of the object's sound reaches a listener."""
        if RADIATION not in self.header:
            raise ObjectFolderError(
                f"{self.key}: the file does not say how its modes sound at a listener, as those from before "
                "format 1.3 and imported ones; rebuild it with `objectfolder build`"
            )
        return Radiation(self._net(RADIATION))

    def _net(self, part: str) -> StoredNet:
        self.described(part)
        start = f"{part}."
        tensors = {
            name[len(start) :]: self._stored.tensor(name) for name in self.tensors if name.startswith(start)
        }
        surface = replace(self.surface, box=trained_box(self.header[part]))
        return StoredNet(part, self.header, tensors, surface, self.device)
