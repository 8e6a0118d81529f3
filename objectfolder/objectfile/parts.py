"""The parts of an Object File, each read and checked when a question first needs it."""

import lzma
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
import torch

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.gridcodec import unpack_grid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.nets.audio_gains import GainsNet
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.released.gains import ReleasedGains
from objectfolder.nets.released.kilo import ReleasedKilo
from objectfolder.nets.released.spectrogram import ReleasedSpectrogram
from objectfolder.nets.released.touch import ReleasedDepth, ReleasedImage
from objectfolder.nets.released.vision import ReleasedNerf
from objectfolder.nets.touch_geometric import GeometricTouch
from objectfolder.nets.touch_image import ImageTouch
from objectfolder.nets.vision_osf import OsfNet
from objectfolder.nets.vision_surface import SurfaceNet
from objectfolder.objectfile.header import PARTS, known_kinds, known_net
from objectfolder.vision.view import Shader

VisionNet = SurfaceNet | OsfNet | ReleasedNerf | ReleasedKilo
AudioNet = GainsNet | SpectrogramNet | ReleasedGains | ReleasedSpectrogram
TouchNet = GeometricTouch | ImageTouch | ReleasedImage | ReleasedDepth

_VISION: dict[str, type[VisionNet]] = {
    "surface": SurfaceNet,
    "osf": OsfNet,
    "released_nerf": ReleasedNerf,
    "released_kilo": ReleasedKilo,
}
_AUDIO: dict[str, type[AudioNet]] = {
    "gains": GainsNet,
    "spectrogram": SpectrogramNet,
    "released_gains": ReleasedGains,
    "released_spectrogram": ReleasedSpectrogram,
}
#: Those that are complete without the surface.
_TOUCH: dict[str, type[ImageTouch | ReleasedImage | ReleasedDepth]] = {
    "image": ImageTouch,
    "released_image": ReleasedImage,
    "released_depth": ReleasedDepth,
}


class _once(cached_property[Any]):
    """Computed at first use, by one thread, whoever else asks meanwhile."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None or self.attrname in instance.__dict__:
            return super().__get__(instance, owner)
        with instance._lock:
            return super().__get__(instance, owner)


class Parts:
    """Surface and nets of an Object File.

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
        self.key, self.scale = str(header["key"]), float(header["scale"])
        self._lock = threading.RLock()

    def check(self) -> None:
        """Read all that there are.

        Raises
        ------
        ObjectFolderError
            If one is damaged.
        """
        readers = {"geometry": "surface", "vision": "vision", "audio": "audio", "touch": "touch"}
        for part in self.held():
            getattr(self, readers[part])

    def held(self) -> list[str]:
        """Names of the parts that the file holds."""
        return [part for part in PARTS if part in self.header]

    def described(self, part: str) -> dict[str, Any]:
        """Header of a part.

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

    @_once
    def surface(self) -> Isosurface:
        """The stored surface, unit frame; extracted at first use."""
        config = self.described("geometry")
        packed = self._tensor("geometry.distances")
        with self.checked("distance grid"):
            values = unpack_grid(packed, int(config["resolution"]), config["predictor"])
            surface = Isosurface(DistanceGrid(values, config["band"]))
            if not len(surface.faces):
                raise ValueError("no surface")
            return surface

    @property
    def solid(self) -> Isosurface | None:
        """The surface, or None where the file stores none: then points are taken as they are."""
        return self.surface if "geometry" in self.header else None

    @_once
    def vision(self) -> VisionNet:
        """The vision net."""
        vision = self.described("vision")
        with self.checked("vision net"):
            kind, net = _VISION[vision["kind"]], known_net("vision", vision)
            return kind.from_tensors(self._group("vision"), net).to(self.device)

    @_once
    def shader(self) -> Shader:
        """What shades samples of the surface; of a net of kind ``surface``."""
        net = self.vision
        assert isinstance(net, SurfaceNet)
        with self.checked("vision net"):
            return net.shader(self.surface, self.device)

    @_once
    def audio(self) -> AudioNet:
        """The audio net."""
        audio = self.described("audio")
        with self.checked("audio net"):
            kind, net = _AUDIO[audio["kind"]], known_net("audio", audio)
            return kind.from_tensors(self._group("audio"), net).to(self.device)

    @_once
    def touch(self) -> TouchNet:
        """The touch net."""
        touch = self.described("touch")
        tensors, net = self._group("touch"), known_net("touch", touch)
        if touch["kind"] in _TOUCH:
            with self.checked("touch net"):
                return _TOUCH[touch["kind"]].from_tensors(tensors, net).to(self.device)
        surface = self.surface
        with self.checked("touch net"):
            return GeometricTouch.from_tensors(surface, self.scale, tensors, net, self.device)

    @contextmanager
    def checked(self, what: str) -> Iterator[None]:
        """Name the object and the part that its header or tensors do not describe."""
        try:
            yield
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, lzma.LZMAError) as error:
            raise ObjectFolderError(
                f"{self.key}: the stored {what} is damaged ({error}); rebuild it"
            ) from error

    def _group(self, part: str) -> dict[str, np.ndarray]:
        start = part + "."
        return {name[len(start) :]: self._tensor(name) for name in self.tensors if name.startswith(start)}

    def _tensor(self, name: str) -> np.ndarray:
        if name not in self.tensors:
            raise ObjectFolderError(f"{self.key}: the Object File lacks tensor {name}")
        value = self.tensors[name]
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise ObjectFolderError(f"{self.key}: tensor {name} holds values that are not finite; rebuild it")
        return value
