"""The Object File: one safetensors file that answers how an object looks, sounds and feels.

The format is described in docs/objectfile.md. Reading it needs no mesh, no pickle and no network.
"""

import dataclasses
import logging
import lzma
import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from objectfolder import materials, query
from objectfolder.artifacts import read_safetensors, write_safetensors
from objectfolder.audio.tuning import Tuning, retune, stored_modes
from objectfolder.errors import ObjectFolderError
from objectfolder.materials import Material
from objectfolder.mesh.grid import DistanceGrid
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.nets.audio_gains import GainsNet
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.touch_geometric import GeometricTouch
from objectfolder.nets.touch_image import ImageTouch
from objectfolder.nets.vision_osf import OsfNet
from objectfolder.nets.vision_surface import SurfaceNet
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.simulate import Touches
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.picture import Drawer, Views
from objectfolder.vision.view import Shader, draw

SCHEMA = 2
MAX_RESOLUTION = 512  #: of the stored distance grid
MODALITIES = ("vision", "audio", "touch")
_VISION: dict[str, type[SurfaceNet] | type[OsfNet]] = {"surface": SurfaceNet, "osf": OsfNet}
_AUDIO: dict[str, type[GainsNet] | type[SpectrogramNet]] = {"gains": GainsNet, "spectrogram": SpectrogramNet}
_KINDS = {"vision": tuple(_VISION), "audio": tuple(_AUDIO), "touch": ("geometric", "image")}
log = logging.getLogger(__name__)
_REQUIRED = ("schema", "key", "material", "scale", "geometry", "vision", "audio", "touch")


class ObjectFile:
    """One object. Points of contacts and strikes are in the object frame (metres), cameras and lights in
    the unit frame (the object's longest side is 1); docs/conventions.md draws both.

    Parameters
    ----------
    header : dict
    tensors : dict of arrays
        Named ``geometry.*``, ``vision.*``, ``audio.*``, ``touch.*``.
    path : path, optional
        Named in errors.

    Raises
    ------
    ObjectFolderError
        If the header is not that of an Object File this version can read.
    """

    def __init__(
        self, header: dict[str, Any], tensors: dict[str, np.ndarray], path: str | Path = "Object File"
    ):
        missing = [name for name in _REQUIRED if name not in header]
        if missing:
            raise ObjectFolderError(f"{path} is not an Object File: its header lacks {', '.join(missing)}")
        if header["schema"] != SCHEMA:
            older = header["schema"] in range(SCHEMA)
            raise ObjectFolderError(
                f"{path} has schema {header['schema']}, this version reads {SCHEMA}; "
                + ("rebuild it with `objectfolder build`" if older else "update objectfolder")
            )
        for modality, kinds in _KINDS.items():
            found = header[modality].get("kind") if isinstance(header[modality], dict) else None
            if found not in kinds:
                expected = " or ".join(map(repr, kinds))
                raise ObjectFolderError(f"{path}: {modality} net of kind {found!r}, expected {expected}")
        scale = header["scale"]
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < math.inf:
            raise ObjectFolderError(f"{path}: scale is {scale!r}, expected the object's size in metres")
        self.header = header
        self.tensors = tensors

    @classmethod
    def load(cls, path: str | Path) -> "ObjectFile":
        """Read an Object File.

        Raises
        ------
        ObjectFolderError
            If the file is missing, damaged, or not an Object File.
        """
        tensors, header = read_safetensors(path)
        return cls(header, tensors, path)

    def check(self) -> None:
        """Read everything that the file holds, as queries do when they first need it.

        Raises
        ------
        ObjectFolderError
            If a part is damaged.
        """
        for part in ("surface", "_vision", "_audio", "_touch"):
            getattr(self, part)

    def save(self, path: str | Path) -> None:
        """Write the Object File; the same object gives the same bytes."""
        write_safetensors(path, self.tensors, self.header)

    @property
    def key(self) -> str:
        """Object key."""
        return self.header["key"]

    @property
    def material(self) -> str:
        """Material name."""
        return self.header["material"]

    @property
    def scale(self) -> float:
        """Longest side, metres."""
        return float(self.header["scale"])

    @property
    def sensor(self) -> str:
        """Name of the stored tactile sensor."""
        stored = self.header["touch"]["net"]["sensor"]
        return stored if isinstance(stored, str) else stored["name"]

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the modes, Hz; (M,)."""
        return self._audio.damped_frequency.numpy() / (2 * np.pi)

    def tuning(self, material: str | Material | None = None, scale: float | None = None) -> Tuning:
        """Return the modes of this shape in another material or size; see `objectfolder.audio.tuning.retune`.

        Parameters
        ----------
        material : str or Material, optional
            Default: the object's own.
        scale : float, optional
            Longest side, metres. Default: the object's own.
        """
        net = self._gains
        if material is None and scale is None:
            return stored_modes(net.damped_frequency, net.damping)
        if material is not None and not isinstance(material, Material):
            material = materials.material(material)
        with self._checked("description of the sound"):
            low, high = self.header["audio"]["band_hz"]
            own = Material(self.material, **self.header["material_properties"])
        return retune(
            net.damped_frequency,
            net.damping,
            (float(low), float(high)),
            (own, self.scale),
            (own if material is None else material, self.scale if scale is None else scale),
        )

    def view(
        self,
        camera: np.ndarray,
        light: np.ndarray,
        resolution: int = 256,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
    ) -> np.ndarray:
        """Render the object on white; see `objectfolder.query.view`.

        Parameters
        ----------
        resolution : int
            Of a square picture with the default field of view.
        intrinsics : Intrinsics, optional
            Any other camera.
        supersample : bool
            Without, every pixel is the ray through its centre: faster, and jagged at edges. A net of kind
            ``osf`` knows no other.
        """
        draw = self._drawer(supersample)
        return query.view(draw, camera, light, intrinsics or Intrinsics.square(resolution))

    def render(
        self,
        camera: np.ndarray,
        light: np.ndarray,
        resolution: int = 256,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
    ) -> Views:
        """Render all that is known of each pixel: colour, alpha, depth, normal; otherwise as `view`."""
        draw = self._drawer(supersample)
        return query.render(draw, self.scale, camera, light, intrinsics or Intrinsics.square(resolution))

    def impact(
        self,
        points: np.ndarray,
        forces: np.ndarray,
        sample_rate: float = 16000,
        duration: float = 2.0,
        response: str = "displacement",
        tolerance: float = query.TOLERANCE,
        contact_time: float = 0.0,
        material: str | Material | None = None,
        scale: float | None = None,
    ) -> np.ndarray:
        """Strike the object, or one of its shape; see `objectfolder.query.impact`.

        Parameters
        ----------
        material : str or Material, optional
            What the struck object is made of. Another Poisson ratio makes the answer approximate: a warning
            says how far off it may be.
        scale : float, optional
            Longest side of the struck object, metres, in which ``points`` are given as well. A warning says
            where modes are lacking.
        """
        size = self.scale if scale is None else scale
        if isinstance(self._audio, SpectrogramNet):
            if material is not None or scale is not None or contact_time:
                raise ObjectFolderError(
                    f"{self.key}: its audio net stores spectrograms; material, scale and contact_time need "
                    "modes, which train_audio.net: gains stores"
                )
            return query.impact_spectrogram(
                self.surface,
                self._audio,
                size,
                points,
                forces,
                sample_rate,
                duration,
                response,
                tolerance,
            )
        tuning = self.tuning(material, scale)
        for note in tuning.notes:
            log.warning("%s: %s", self.key, note)
        return query.impact(
            self.surface,
            self._gains,
            size,
            points,
            forces,
            sample_rate,
            duration,
            response,
            tolerance,
            contact_time,
            tuning,
        )

    def mode_shapes(self, points: np.ndarray, tolerance: float = query.TOLERANCE) -> np.ndarray:
        """Gains of unit impulses along x, y and z; see `objectfolder.query.mode_shapes`."""
        return query.mode_shapes(self.surface, self._gains, self.scale, points, tolerance).numpy()

    def touch(
        self,
        points: np.ndarray,
        depth: np.ndarray | float = 0.001,
        angle: np.ndarray | float = 0.0,
        tilt: np.ndarray | float = 0.0,
        azimuth: np.ndarray | float = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> np.ndarray:
        """Press a tactile sensor on the object; see `objectfolder.query.touch`.

        Parameters
        ----------
        sensor : str, Path or SensorProfile, optional
            Name of a profile that comes with the package, a ``.yaml`` file, or a profile. Default: the stored
            one.

        Returns
        -------
        (N, H, W, 3) uint8, RGB
        """
        if isinstance(self._touch, ImageTouch) and sensor is None:
            return query.touch_image(
                self.surface, self._touch, self.scale, points, depth, angle, tilt, azimuth, tolerance
            )
        found = self.touches(points, depth, angle, tilt, azimuth, tolerance, sensor)
        return np.concatenate([part.images for part in found])

    def press(
        self,
        points: np.ndarray,
        depth: np.ndarray | float = 0.001,
        angle: np.ndarray | float = 0.0,
        tilt: np.ndarray | float = 0.0,
        azimuth: np.ndarray | float = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> Touches:
        """Press a tactile sensor on the object and get all that is known: images, heights, normals, contact
        masks, displacements, pressures, forces, areas, penetrations, obstruction; otherwise as `touch`.
        """
        return query.joined(self.touches(points, depth, angle, tilt, azimuth, tolerance, sensor))

    def touches(
        self,
        points: np.ndarray,
        depth: np.ndarray | float = 0.001,
        angle: np.ndarray | float = 0.0,
        tilt: np.ndarray | float = 0.0,
        azimuth: np.ndarray | float = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> Iterator[Touches]:
        """Answer as `press`, a few contacts at a time: for more of them than the memory holds."""
        net = self._geometric
        if sensor is not None:
            net = net.with_sensor(sensor if isinstance(sensor, SensorProfile) else load_profile(sensor))
        return query.touch(net, points, depth, angle, tilt, azimuth, tolerance)

    def sample_surface(self, count: int, seed: int = 0) -> np.ndarray:
        """Random surface points, uniform by area; (count, 3), object frame, metres."""
        rng = np.random.default_rng(seed)
        return sample_surface(self.surface.vertices, self.surface.faces, count, rng) * self.scale

    @cached_property
    def surface(self) -> Isosurface:
        """The stored surface, unit frame; extracted at first use."""
        packed = self._tensor("geometry.sdf_lzma").tobytes()
        with self._checked("distance grid"):
            config = self.header["geometry"]
            resolution = int(config["resolution"])
            # The limits stop a hostile file from filling the memory.
            if not 2 <= resolution <= MAX_RESOLUTION:
                raise ValueError(f"resolution {resolution}")
            raw = lzma.LZMADecompressor(memlimit=2**30).decompress(packed, resolution**3)
            values = np.frombuffer(raw, np.int8).reshape((resolution,) * 3)
            return Isosurface(DistanceGrid(values, config["band"]))

    @cached_property
    def _vision(self) -> SurfaceNet | OsfNet:
        vision = self.header["vision"]
        with self._checked("vision net"):
            return _VISION[vision["kind"]].from_tensors(self._group("vision"), vision["net"])

    @cached_property
    def _shader(self) -> Shader:
        with self._checked("vision net"):
            return cast("SurfaceNet", self._vision).shader(self.surface)

    def _drawer(self, supersample: bool) -> Drawer:
        if isinstance(self._vision, OsfNet):
            return self._vision.picture
        return partial(draw, self.surface, self._shader, supersample=supersample)

    @cached_property
    def _audio(self) -> GainsNet | SpectrogramNet:
        audio = self.header["audio"]
        with self._checked("audio net"):
            return _AUDIO[audio["kind"]].from_tensors(self._group("audio"), audio["net"])

    @property
    def _gains(self) -> GainsNet:
        if not isinstance(self._audio, GainsNet):
            raise ObjectFolderError(
                f"{self.key}: its audio net stores spectrograms, no modes; train_audio.net: gains stores them"
            )
        return self._audio

    @cached_property
    def _touch(self) -> GeometricTouch | ImageTouch:
        tensors = self._group("touch")
        tensors.pop("mean_image", None)  # for the evaluation
        touch, surface = self.header["touch"], self.surface
        with self._checked("touch net"):
            if touch["kind"] == "image":
                return ImageTouch.from_tensors(tensors, touch["net"])
            return GeometricTouch.from_tensors(surface, self.scale, tensors, touch["net"])

    @property
    def _geometric(self) -> GeometricTouch:
        if not isinstance(self._touch, GeometricTouch):
            raise ObjectFolderError(
                f"{self.key}: its touch net stores images of one sensor, no shapes or forces; "
                "train_touch.net: geometric answers with them, and for other sensors"
            )
        return self._touch

    @contextmanager
    def _checked(self, what: str) -> Iterator[None]:
        """Name the object and the part that its header or tensors do not describe."""
        try:
            yield
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError, lzma.LZMAError) as error:
            raise ObjectFolderError(
                f"{self.key}: the stored {what} is damaged ({error}); rebuild it"
            ) from error

    def _group(self, prefix: str) -> dict[str, np.ndarray]:
        start = prefix + "."
        return {name[len(start) :]: value for name, value in self.tensors.items() if name.startswith(start)}

    def _tensor(self, name: str) -> np.ndarray:
        if name not in self.tensors:
            raise ObjectFolderError(f"{self.key}: the Object File lacks tensor {name}")
        return self.tensors[name]


def pack(
    key: str,
    material: str,
    normalize: dict[str, Any],
    sdf: dict[str, np.ndarray],
    nets: dict[str, tuple[dict[str, np.ndarray], dict[str, Any]]],
    provenance: dict[str, str],
) -> ObjectFile:
    """Join geometry and the three nets.

    Parameters
    ----------
    key, material : str
    normalize : dict
        ``normalize.json``: scale and the transform to the source mesh.
    sdf : dict
        ``values`` int8 and ``band``.
    nets : dict
        Per modality its tensors and header, as the training stages wrote them.
    provenance : dict
        SHA-256 of each input, by name.
    """
    properties = dataclasses.asdict(materials.material(material))
    del properties["name"]
    # xz's default; a preset of 9 saves under 1 %.
    packed = lzma.compress(sdf["values"].tobytes(), preset=6)
    tensors = {"geometry.sdf_lzma": np.frombuffer(packed, np.uint8)}
    header: dict[str, Any] = {
        "schema": SCHEMA,
        "key": key,
        "material": material,
        "material_properties": properties,
        "scale": normalize["scale_m"],
        "source": {name: normalize[name] for name in ("source_centre", "source_size", "source_up")},
        "geometry": {"resolution": len(sdf["values"]), "band": float(sdf["band"])},
        "provenance": provenance,
    }
    for modality in MODALITIES:
        net_tensors, net_header = nets[modality]
        tensors.update({f"{modality}.{name}": value for name, value in net_tensors.items()})
        header[modality] = net_header
    return ObjectFile(header, tensors, key)
