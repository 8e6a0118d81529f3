"""The parts of an Object File: each is read and checked when a query first needs it."""

import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.featurecodec import COUNTED, Features, unpack_features
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import unpack_grid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.sound.far_field import Radiation
from objectfolder.sound.query import SoundSense
from objectfolder.sound.senses import sound_sense
from objectfolder.stored.header import RADIATION
from objectfolder.stored.reading import (
    StoredNet,
    checked_tensor,
    described_part,
    held_parts,
    once,
    read_once,
    report_damage,
)
from objectfolder.stored.released import trained_box
from objectfolder.stored.surface import TOLERANCE, ObjectSurface
from objectfolder.touch.query import TouchSense
from objectfolder.touch.senses import touch_sense
from objectfolder.vision.query import VisionSense
from objectfolder.vision.senses import vision_sense

TAPS = 2000  #: points of the surface whose mode shapes are kept for rough answers


class StoredParts:
    """Surface and senses of an Object File, whose header is checked; nets are evaluated on the device."""

    def __init__(self, header: dict[str, Any], tensors: Mapping[str, np.ndarray], device: torch.device):
        self.header, self.tensors, self.device = header, tensors, device
        self.key = str(header["key"])
        # The surface, which the senses hold, does not hold the parts: these go when nobody needs them.
        read = read_once(partial(_read_geometry, header, tensors))
        self.surface = ObjectSurface(read, float(header["scale"]), "geometry" in header)
        self._lock = threading.RLock()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.header, self.tensors, self.device)  # parts are read again

    def check(self) -> None:
        """Read all parts that the file holds, or raise ObjectFolderError if one is damaged."""
        for part in held_parts(self.header):
            getattr(self, part)

    @property
    def geometry(self) -> Isosurface:
        """The stored surface, unit frame."""
        return self.surface.read()

    @once
    def vision(self) -> VisionSense:
        """How the object looks."""
        return vision_sense(self._net("vision"))

    @once
    def audio(self) -> SoundSense:
        """How the object sounds."""
        return sound_sense(self._net("audio"))

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
        described_part(self.header, part)
        start = f"{part}."
        names = [name for name in self.tensors if name.startswith(start)]
        tensors = {name[len(start) :]: checked_tensor(self.key, self.tensors, name) for name in names}
        surface = replace(self.surface, box=trained_box(self.header[part]))
        return StoredNet(part, self.header, tensors, surface, self.device)


def _read_geometry(header: dict[str, Any], tensors: Mapping[str, np.ndarray]) -> Isosurface:
    config, key = described_part(header, "geometry"), str(header["key"])
    packed = checked_tensor(key, tensors, "geometry.distances")
    with report_damage(key, "distance grid"):
        values = unpack_grid(packed, int(config["resolution"]), config["predictor"])
        surface = Isosurface(DistanceGrid(values, config["band"], _read_features(config, key, tensors)))
        if not len(surface.faces):
            raise ValueError("no surface")
        return surface


def _read_features(config: dict[str, Any], key: str, tensors: Mapping[str, np.ndarray]) -> Features | None:
    counts = {name: config.get(name, 0) for name in COUNTED}
    if not any(counts.values()):
        return None
    packed = checked_tensor(key, tensors, "geometry.features")
    return unpack_features(packed, counts, int(config["resolution"]))
