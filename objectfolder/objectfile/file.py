"""The Object File: one safetensors file that answers how an object looks, sounds and feels.

The format is described in docs/objectfile.md. Reading it needs no mesh, no pickle and no network.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch

from objectfolder import materials
from objectfolder.audio.bank import Bank
from objectfolder.audio.tuning import Tuning, retune, stored_modes
from objectfolder.errors import ObjectFolderError
from objectfolder.io import open_safetensors, write_safetensors
from objectfolder.materials import Material
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.mesh.sampling import sample_surface
from objectfolder.nets.audio_gains import GainsNet
from objectfolder.nets.audio_spectrogram import SpectrogramNet
from objectfolder.nets.released.gains import ReleasedGains
from objectfolder.nets.released.spectrogram import ReleasedSpectrogram
from objectfolder.nets.released.touch import ReleasedDepth, ReleasedImage
from objectfolder.nets.touch_geometric import GeometricTouch
from objectfolder.nets.touch_image import ImageTouch
from objectfolder.nets.vision_surface import SurfaceNet
from objectfolder.objectfile import query
from objectfolder.objectfile.arguments import Rows, Scalars, alike, rows
from objectfolder.objectfile.header import checked_header
from objectfolder.objectfile.parts import Parts
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.simulate import Touches
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.picture import Drawer, Views
from objectfolder.vision.view import draw

if TYPE_CHECKING:
    import trimesh

_BANKS = 4  # kinds of sound whose responses are kept
log = logging.getLogger(__name__)


class ObjectFile:
    """One object. Points of contacts and strikes are in the object frame (metres), cameras and lights in
    the unit frame (the object's longest side is 1); docs/conventions.md draws both.

    Queries take numpy arrays, lists, or torch tensors of any real type. Where the first argument is a tensor,
    so is the answer of `view`, `impact` and `touch`, on its device; no gradients flow. The answer to a row
    depends on that row only. Several threads may ask one object.

    Parameters
    ----------
    header : dict
    tensors : mapping of arrays
        Named ``geometry.*``, ``vision.*``, ``audio.*``, ``touch.*``.
    path : path, optional
        Named in errors.
    device : str or torch.device, optional
        Where nets are evaluated. Rays are cast on the CPU.

    Raises
    ------
    ObjectFolderError
        If the header is not that of an Object File this version can read.

    Examples
    --------
    >>> mug = ObjectFile.load("build/mug/ObjectFile.safetensors")
    >>> mug.view(camera=[[2.0, 1.0, 1.2]], light=[[0.5, 0.5, 0.7]]).shape
    (1, 256, 256, 3)
    >>> mug.render([2.0, 1.0, 1.2], [0.5, 0.5, 0.7], resolution=64).depth.shape
    (1, 64, 64)
    >>> points = mug.sample_surface(5)
    >>> mug.impact(points, forces=[0, 0, 1.0], duration=0.5).shape
    (5, 8000)
    >>> mug.touch(points, depth=0.001).shape
    (5, 160, 120, 3)
    >>> mug.press(points, depth=[0.0005, 0.001, 0.001, 0.002, 0.002]).force.shape
    (5,)
    >>> nearest, distance = mug.nearest(points * 1.01)
    >>> bool((distance < 0.01 * mug.scale).all())
    True
    """

    def __init__(
        self,
        header: dict[str, Any],
        tensors: Mapping[str, np.ndarray],
        path: str | Path = "Object File",
        device: str | torch.device = "cpu",
    ):
        self.header = checked_header(header, path)
        self.tensors = tensors
        self.device = torch.device(device)
        self._parts = Parts(self.header, tensors, self.device)
        self._bank = lru_cache(_BANKS)(self._new_bank)

    @classmethod
    def load(cls, path: str | Path, device: str | torch.device = "cpu") -> "ObjectFile":
        """Open an Object File: its header is checked, and what a question needs is read when it is asked.

        Parameters
        ----------
        path : path
        device : str or torch.device, optional
            Where nets are evaluated, such as "cuda".

        Raises
        ------
        ObjectFolderError
            If the file is missing, damaged, or not an Object File.
        """
        tensors, header = open_safetensors(path)
        return cls(header, tensors, path, device)

    def check(self) -> None:
        """Read everything that the file holds, as queries do when they first need it.

        Raises
        ------
        ObjectFolderError
            If a part is damaged.
        """
        self._parts.check()

    def save(self, path: str | Path) -> None:
        """Write the Object File; the same object gives the same bytes."""
        write_safetensors(path, dict(self.tensors), self.header)

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
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates of the surface; (2, 3), object frame, metres."""
        return self.surface.bounds * self.scale

    @property
    def surface(self) -> Isosurface:
        """The stored surface, unit frame; extracted at first use."""
        return self._parts.surface

    @property
    def sensor(self) -> str:
        """Name of the stored tactile sensor."""
        stored = self._parts.described("touch")["net"]["sensor"]
        return stored if isinstance(stored, str) else stored["name"]

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies of the modes, Hz; (M,)."""
        return self._parts.audio.damped_frequency.cpu().numpy() / (2 * np.pi)

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
            return stored_modes(net.damped_frequency.cpu(), net.damping.cpu())
        if material is not None and not isinstance(material, Material):
            material = materials.material(material)
        if "band_hz" not in self.header["audio"] or "material_properties" not in self.header:
            raise ObjectFolderError(
                f"{self.key}: the file does not say what its modes are of, as imported ones do not; it "
                "answers in its own material and size only"
            )
        with self._parts.checked("description of the sound"):
            low, high = self.header["audio"]["band_hz"]
            own = Material(self.material, **self.header["material_properties"])
        return retune(
            net.damped_frequency.cpu(),
            net.damping.cpu(),
            (float(low), float(high)),
            (own, self.scale),
            (own if material is None else material, self.scale if scale is None else scale),
        )

    @overload
    def view(
        self,
        camera: torch.Tensor,
        light: Rows,
        resolution: int = ...,
        intrinsics: Intrinsics | None = ...,
        supersample: bool = ...,
    ) -> torch.Tensor: ...

    @overload
    def view(
        self,
        camera: np.ndarray | Sequence[Any],
        light: Rows,
        resolution: int = ...,
        intrinsics: Intrinsics | None = ...,
        supersample: bool = ...,
    ) -> np.ndarray: ...

    def view(
        self,
        camera: Rows,
        light: Rows,
        resolution: int = 256,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
    ) -> np.ndarray | torch.Tensor:
        """Render the object on white; see `objectfolder.objectfile.query.view`.

        Parameters
        ----------
        camera : (N, 3) or (N, 4, 4) array
            Positions, unit frame, that look at the object with z up, or camera-to-world matrices.
        light : (N, 3) array
            Point lights, unit frame.
        resolution : int
            Of a square picture with the default field of view.
        intrinsics : Intrinsics, optional
            Any other camera.
        supersample : bool
            Without, every pixel is the ray through its centre: faster, and jagged at edges. Only a net of
            kind ``surface`` knows the difference.

        Returns
        -------
        (N, H, W, 3) float32, sRGB in [0, 1]
        """
        draw = self._drawer(supersample)
        images = query.view(draw, camera, light, intrinsics or Intrinsics.square(resolution))
        return alike(images, camera)

    def render(
        self,
        camera: Rows,
        light: Rows,
        resolution: int = 256,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
    ) -> Views:
        """Render all that is known of each pixel: colour, alpha, depth, normal; otherwise as `view`.

        Returns
        -------
        Views
            Of numpy arrays.
        """
        draw = self._drawer(supersample)
        return query.render(draw, self.scale, camera, light, intrinsics or Intrinsics.square(resolution))

    @overload
    def impact(
        self,
        points: torch.Tensor,
        forces: Rows,
        sample_rate: float = ...,
        duration: float = ...,
        response: str = ...,
        tolerance: float = ...,
        contact_time: float = ...,
        material: str | Material | None = ...,
        scale: float | None = ...,
    ) -> torch.Tensor: ...

    @overload
    def impact(
        self,
        points: np.ndarray | Sequence[Any],
        forces: Rows,
        sample_rate: float = ...,
        duration: float = ...,
        response: str = ...,
        tolerance: float = ...,
        contact_time: float = ...,
        material: str | Material | None = ...,
        scale: float | None = ...,
    ) -> np.ndarray: ...

    def impact(
        self,
        points: Rows,
        forces: Rows,
        sample_rate: float = 16000,
        duration: float = 2.0,
        response: str = "displacement",
        tolerance: float = query.TOLERANCE,
        contact_time: float = 0.0,
        material: str | Material | None = None,
        scale: float | None = None,
    ) -> np.ndarray | torch.Tensor:
        """Strike the object, or one of its shape, with impulses; see docs/sound.md.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres; snapped to the surface.
        forces : (N, 3) array
            Impulse vectors, N s, object frame; the sound is linear in them.
        sample_rate : float
            Hz. Modes at or above half of it are left out.
        duration : float
            Seconds.
        response : {"displacement", "velocity", "acceleration"}
            Of the modes, summed: m kg^1/2 and its time derivatives.
        tolerance : float
            Refuse points further from the surface, fraction of the size.
        contact_time : float
            Duration of the strike, seconds: half a sine of force whose integral is the impulse. 0 is an
            instant.
        material : str or Material, optional
            What the struck object is made of. Another Poisson ratio makes the answer approximate: a warning
            says how far off it may be.
        scale : float, optional
            Longest side of the struck object, metres, in which ``points`` are given as well. A warning says
            where modes are lacking.

        Returns
        -------
        (N, samples) float32, absolute amplitude

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite or too large, or a point is off the surface.
        """
        size = self.scale if scale is None else scale
        if isinstance(self._parts.audio, SpectrogramNet | ReleasedSpectrogram):
            if material is not None or scale is not None or contact_time:
                raise ObjectFolderError(
                    f"{self.key}: its audio net stores spectrograms; material, scale and contact_time need "
                    "modes, which train_audio.net: gains stores"
                )
            heard = query.impact_spectrogram(
                self._parts.solid,
                self._parts.audio,
                size,
                points,
                forces,
                sample_rate,
                duration,
                response,
                tolerance,
            )
            return alike(heard, points)
        tuning, bank = self._bank(sample_rate, duration, response, contact_time, material, scale)
        for note in tuning.notes:
            log.warning("%s: %s", self.key, note)
        heard = query.impact(self._parts.solid, self._gains, size, points, forces, tuning, bank, tolerance)
        return alike(heard, points)

    def mode_shapes(self, points: Rows, tolerance: float = query.TOLERANCE) -> np.ndarray:
        """Gains of unit impulses along x, y and z; see `objectfolder.objectfile.query.mode_shapes`."""
        return query.mode_shapes(self._parts.solid, self._gains, self.scale, points, tolerance).cpu().numpy()

    @overload
    def touch(
        self,
        points: torch.Tensor,
        depth: Scalars = ...,
        angle: Scalars = ...,
        tilt: Scalars = ...,
        azimuth: Scalars = ...,
        tolerance: float = ...,
        sensor: str | Path | SensorProfile | None = ...,
    ) -> torch.Tensor: ...

    @overload
    def touch(
        self,
        points: np.ndarray | Sequence[Any],
        depth: Scalars = ...,
        angle: Scalars = ...,
        tilt: Scalars = ...,
        azimuth: Scalars = ...,
        tolerance: float = ...,
        sensor: str | Path | SensorProfile | None = ...,
    ) -> np.ndarray: ...

    def touch(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> np.ndarray | torch.Tensor:
        """Press a tactile sensor on the object; see `objectfolder.objectfile.query.touch`.

        Parameters
        ----------
        points : (N, 3) array
            Contact points, object frame, metres.
        depth : float or (N,) array
            How far the gel's apex is pressed past the surface, metres.
        angle : float or (N,) array
            Rotation of the sensor about the outward contact normal, radians.
        tilt, azimuth : float or (N,) array
            Lean of the sensor from the contact normal, and its direction, radians.
        tolerance : float
            Refuse points further from the surface, fraction of the size.
        sensor : str, Path or SensorProfile, optional
            Name of a profile that comes with the package, a ``.yaml`` file, or a profile. Default: the stored
            one.

        Returns
        -------
        (N, H, W, 3) uint8, RGB
        """
        if isinstance(self._parts.touch, ImageTouch | ReleasedImage) and sensor is None:
            images = query.touch_image(
                self._parts.solid,
                self._parts.touch,
                self.scale,
                points,
                depth,
                angle,
                tilt,
                azimuth,
                tolerance,
            )
        else:
            found = self.touches(points, depth, angle, tilt, azimuth, tolerance, sensor)
            images = np.concatenate([part.images for part in found])
        return alike(images, points)

    def press(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> Touches:
        """Press a tactile sensor on the object and get all that is known: images, heights, normals, contact
        masks, displacements, pressures, forces, areas, penetrations, obstruction; otherwise as `touch`.
        """
        return query.joined(self.touches(points, depth, angle, tilt, azimuth, tolerance, sensor))

    def touches(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = query.TOLERANCE,
        sensor: str | Path | SensorProfile | None = None,
    ) -> Iterator[Touches]:
        """Answer as `press`, a few contacts at a time: for more of them than the memory holds."""
        profile = sensor if isinstance(sensor, SensorProfile | None) else load_profile(sensor)
        if isinstance(self._parts.touch, ReleasedDepth):
            return query.touch_depth(
                self._parts.solid,
                self._parts.touch,
                self.scale,
                points,
                depth,
                angle,
                tilt,
                azimuth,
                tolerance,
                profile,
            )
        net = self._geometric
        if profile is not None:
            net = net.with_sensor(profile)
        return query.touch(net, points, depth, angle, tilt, azimuth, tolerance)

    def depth_maps(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = query.TOLERANCE,
    ) -> np.ndarray:
        """Depth maps that the touch net of an imported 2.0 file answers itself; otherwise as `touch`.

        Returns
        -------
        (N, 120, 160) float32, metres from the released sensor's camera

        Raises
        ------
        ObjectFolderError
            If the file holds no such net: `press` has the heights of all others.
        """
        net = self._parts.touch
        if not isinstance(net, ReleasedDepth):
            raise ObjectFolderError(
                f"{self.key}: its touch net stores no depth maps, as those of imported 2.0 files; "
                "press() gives heights"
            )
        return query.depth_maps(self._parts.solid, net, self.scale, points, depth, tilt, azimuth, tolerance)

    def sample_surface(self, count: int, seed: int = 0) -> np.ndarray:
        """Random surface points, uniform by area; (count, 3), object frame, metres."""
        rng = np.random.default_rng(seed)
        return sample_surface(self.surface.vertices, self.surface.faces, count, rng) * self.scale

    def nearest(self, points: Rows) -> tuple[np.ndarray, np.ndarray]:
        """Points of the surface that are nearest to given ones.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres.

        Returns
        -------
        nearest : (N, 3) float64, object frame, metres
        distance : (N,) float64, metres
        """
        places = rows("points", points, 3)
        if not len(places):
            return places, np.zeros(0)
        nearest, distance = self.surface.nearest(places / self.scale)
        return nearest * self.scale, distance * self.scale

    def to_mesh(self) -> "trimesh.Trimesh":
        """Return the stored surface as triangles, object frame, metres, with its normals."""
        import trimesh

        surface = self.surface
        return trimesh.Trimesh(
            surface.vertices * self.scale, surface.faces, vertex_normals=surface.normals, process=False
        )

    def _drawer(self, supersample: bool) -> Drawer:
        if not isinstance(self._parts.vision, SurfaceNet):
            return self._parts.vision.picture
        return partial(draw, self.surface, self._parts.shader, supersample=supersample)

    @property
    def _gains(self) -> GainsNet | ReleasedGains:
        if not isinstance(self._parts.audio, GainsNet | ReleasedGains):
            raise ObjectFolderError(
                f"{self.key}: its audio net stores spectrograms, no modes; train_audio.net: gains stores them"
            )
        return self._parts.audio

    def _new_bank(
        self,
        sample_rate: float,
        duration: float,
        response: str,
        contact_time: float,
        material: str | Material | None,
        scale: float | None,
    ) -> tuple[Tuning, Bank]:
        tuning = self.tuning(material, scale)
        return tuning, Bank(tuning, sample_rate, duration, response, contact_time, self.device)

    @property
    def _geometric(self) -> GeometricTouch:
        if not isinstance(self._parts.touch, GeometricTouch):
            raise ObjectFolderError(
                f"{self.key}: its touch net stores images of one sensor, no shapes or forces; "
                "train_touch.net: geometric answers with them, and for other sensors"
            )
        return self._parts.touch
