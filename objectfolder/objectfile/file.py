"""The Object File: one safetensors file that answers how an object looks, sounds and feels.

docs/objectfile.md describes the format. Reading it needs no mesh, no pickle and no network.
"""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.audio.contact import Striker, load_striker
from objectfolder.audio.synthesis import checked_sample_rate
from objectfolder.audio.tuning import Tuning
from objectfolder.checks import real_array, require_memory, whole_number
from objectfolder.errors import ObjectFolderError, shortened
from objectfolder.io import open_safetensors, safetensors_bytes, write_safetensors
from objectfolder.materials import Material, friction_of
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.arguments import (
    Answer,
    Rows,
    Scalars,
    broadcast_rows,
    finite_rows,
    like_first,
)
from objectfolder.objectfile.header import checked_header
from objectfolder.objectfile.parts import StoredParts
from objectfolder.objectfile.radiation import Listening
from objectfolder.objectfile.samples import available_samples, sample_path
from objectfolder.objectfile.sound_settings import SoundSettings, struck_object
from objectfolder.objectfile.surface import TOLERANCE
from objectfolder.objectfile.torch_modes import each_in_usual_modes, usual_modes
from objectfolder.objectfile.touch import (
    UNMOVED,
    ContactPoses,
    FixedContact,
    GeometricSense,
    TouchSense,
    concatenate_touches,
    sideways_motion,
)
from objectfolder.objectfile.vision import BaseColors, render_views, view_images
from objectfolder.touch.contact import NORMAL_RADIUS, contact_normals
from objectfolder.touch.markers import Markers
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.sheared import shear_touches
from objectfolder.touch.simulate import Touches
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.environment import gather_lamps
from objectfolder.vision.lighting import Lamp
from objectfolder.vision.picture import Views

if TYPE_CHECKING:
    import trimesh

    from objectfolder.objectfile.gradients.answers import Answers
    from objectfolder.objectfile.voice import Voice

#: Name of a sensor profile that comes with the package, a ``.yaml`` file, or a profile; None: the stored one.
Sensor = str | Path | SensorProfile | None
#: "studio", or lights.
Lights = str | Sequence[Lamp] | None
Device = str | torch.device  #: of nets
#: Equirectangular picture of linear radiance, (H, W, 3), or its path.
Environment = str | Path | np.ndarray | None

_BYTES_PER_POINT = 84  # that drawing a random point takes


class ObjectFile:
    """One object. Points of contacts and strikes are in the object frame (metres), cameras and lights in
    the unit frame (the object's longest side is 1); docs/conventions.md defines both.

    Queries take numpy arrays, lists, or torch tensors of any real type. If the first argument of `view`,
    `impact` or `touch` is a tensor, so is the answer, on the same device; no gradients flow. The answer to a
    row depends on that row only. Queries are thread-safe.

    The file is in memory: what happens to it later changes no answer. A pickle or a copy holds its bytes, not
    its path, so that it answers the same in another process, on another machine and after a rebuild; parts
    are read again there. docs/queries.md tells how to query in worker processes.

    Parameters
    ----------
    header : dict
    tensors : mapping of arrays
        Named ``geometry.*``, ``vision.*``, ``audio.*``, ``touch.*``, ``radiation.*``.
    path : path, optional
        Named in errors.
    device : str or torch.device, optional
        Where nets are evaluated. Rays are cast on the CPU.

    Raises
    ------
    ObjectFolderError
        If this version cannot read the header, or torch cannot use the device.

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
        device: Device = "cpu",
    ):
        self._header = checked_header(header, path)
        self.tensors = tensors
        self.device = _usable(device)
        self._path = path
        self._parts = StoredParts(self._header, tensors, self.device)
        self._answers: dict[torch.dtype, Answers] = {}

    @classmethod
    def load(cls, path: str | Path, device: Device = "cpu") -> "ObjectFile":
        """Read an Object File and check its header. Its parts are unpacked when a query first needs them.

        Parameters
        ----------
        path : path
        device : str or torch.device, optional
            Where nets are evaluated, such as "cuda".

        Raises
        ------
        ObjectFolderError
            If the file is missing, damaged, or not an Object File, or torch cannot use the device.
        """
        name = str(path)
        if name in available_samples() and not Path(name).exists():
            raise ObjectFolderError(f"{name} does not exist; ObjectFile.sample({name!r}) is the sample")
        tensors, header = open_safetensors(path)
        return cls(header, tensors, path, device)

    @classmethod
    def sample(cls, name: str) -> "ObjectFile":
        """Return an Object File that comes with the package: mug, die or bell.

        Raises
        ------
        ObjectFolderError
            If there is none of this name.
        """
        return cls.load(sample_path(name))

    def __reduce__(self) -> tuple[Any, ...]:
        # Locks and ray casters cannot be pickled; every part can be read again.
        return type(self), (self._header, self.tensors, self._path, self.device)

    @usual_modes()
    def check(self) -> None:
        """Read all parts of the file, which queries otherwise do on demand.

        Raises
        ------
        ObjectFolderError
            If a part is damaged.
        """
        self._parts.check()

    def require(self, *parts: str) -> None:
        """Check that the file holds some parts, such as "audio", without reading them.

        Raises
        ------
        ObjectFolderError
            If it lacks one, or this version does not know its kind.
        """
        for part in parts:
            self._parts.described(part)

    def save(self, path: str | Path) -> None:
        """Write the Object File; the same object gives the same bytes."""
        write_safetensors(path, dict(self.tensors), self._header)

    def __repr__(self) -> str:
        parts = ", ".join(self._parts.held()) or "nothing"
        return f"{type(self).__name__}({self.key!r}: {self.material}, {self.scale:.4g} m; {parts})"

    def _repr_html_(self) -> str:
        """Return the page of `objectfolder view`, which notebooks show."""
        from objectfolder.viewer.page import viewer_frame

        return viewer_frame({self.key: safetensors_bytes(self.tensors, self._header)})

    @property
    def header(self) -> dict[str, Any]:
        """A copy of the header, which docs/objectfile.md describes."""
        return copy.deepcopy(self._header)

    @property
    def key(self) -> str:
        """Object key."""
        return self._header["key"]

    @property
    def material(self) -> str:
        """Material name."""
        return self._header["material"]

    @property
    def friction(self) -> float:
        """Coefficient of dry sliding friction of the object's material, against a table or an elastomer."""
        stored = self._header.get("material_properties", {})
        return float(stored.get("friction", friction_of(self.material)))

    @property
    def scale(self) -> float:
        """Longest side, metres."""
        return float(self._header["scale"])

    @property
    @usual_modes()
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates of the surface; (2, 3), object frame, metres."""
        return self._parts.surface.bounds()

    @property
    @usual_modes()
    def surface(self) -> Isosurface:
        """The stored surface, unit frame; extracted at first use. Its arrays are read-only."""
        return self._parts.geometry

    @property
    @usual_modes()
    def base_colors(self) -> BaseColors | None:
        """Function from points near the surface, (N, 3), unit frame, to base colours, (N, 3) sRGB uint8.

        None if the vision net does not separate them from the light.
        """
        return self._parts.vision.base_colors

    @property
    def sensor(self) -> str:
        """Name of the stored tactile sensor."""
        stored = self._touch_config["sensor"]
        return stored if isinstance(stored, str) else stored["name"]

    @property
    def sensor_profile(self) -> SensorProfile:
        """Profile of the stored tactile sensor."""
        stored = self._touch_config["sensor"]
        if isinstance(stored, str):
            return load_profile(stored)
        return SensorProfile.from_dict(stored, stored=True)

    @property
    @usual_modes()
    def sensor_background(self) -> np.ndarray:
        """Image of the stored tactile sensor while nothing touches it; (H, W, 3) uint8.

        A photographed background is stored with the net, and not named by `sensor_profile`.
        """
        sense = self._parts.touch
        if isinstance(sense, GeometricSense):
            return sense.net.background.cpu().numpy().copy()
        return Optics(self.sensor_profile).background.numpy()

    @property
    def fixed_contact(self) -> FixedContact | None:
        """Depth and angle of the one press that the touch net answers, with images alone.

        None if it answers any press, with all that `press` returns.
        """
        return FixedContact.of(self._touch_config)

    @property
    @usual_modes()
    def touch_sense(self) -> TouchSense:
        """What answers `touch` and `press`, for sensors in any direction, also away from the surface."""
        return self._parts.touch

    @usual_modes()
    def press_range(self, sensor: Sensor = None) -> tuple[float, float]:
        """Return the least and the greatest press depth of usual contacts, metres.

        They are the ``press_depth`` of the sensor's profile, as far as the touch net answers them: one of an
        imported 2.0 file answers 0.5 to 2 mm.

        Parameters
        ----------
        sensor : as in `touch`
        """
        return self._parts.touch.press_range(_profile(sensor) or self.sensor_profile)

    @property
    @usual_modes()
    def has_modes(self) -> bool:
        """Whether the audio net knows mode shapes, which `mode_shapes`, `tuning` and other sizes need."""
        return self._parts.audio.has_modes

    @property
    @usual_modes()
    def frequencies(self) -> np.ndarray:
        """Frequencies of the modes, Hz; (M,), empty if the file does not know them."""
        return self._parts.audio.damped_frequency.numpy() / (2 * math.pi)

    @usual_modes()
    def tuning(self, material: str | Material | None = None, scale: float | None = None) -> Tuning:
        """Return the modes of this shape in another material or size; see `objectfolder.audio.tuning.retune`.

        Parameters
        ----------
        material : str or Material, optional
            Default: the object's own.
        scale : float, optional
            Longest side, metres. Default: the object's own.
        """
        return self._parts.audio.tuning(material, scale)

    @usual_modes()
    def view(
        self,
        camera: Answer | Sequence[Any],
        light: Rows | None = None,
        resolution: int | None = None,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
        lights: Lights = None,
        environment: Environment = None,
    ) -> Answer:
        """Render the object on white, under one light, several, or the light of its surroundings.

        Parameters
        ----------
        camera : (N, 3) or (N, 4, 4) array
            Positions, unit frame, that look at the object with z up, or camera-to-world matrices (OpenGL
            axes). One row may be given without its first axis.
        light : (N, 3) array, optional
            Point lights, unit frame. A white Lambertian surface that faces one at distance 1 has radiance 1.
        resolution : int, optional
            Side of a square image with the default field of view, pixels. Default: 256.
        intrinsics : Intrinsics, optional
            Any other camera, instead.
        supersample : bool
            False takes one ray through the centre of each pixel: faster, with jagged edges. Nets of other
            kinds than ``surface`` always do.
        lights : "studio" or sequence, optional
            Lights of `objectfolder.vision.lighting`, of all rows; "studio" stands for its three. Radiances
            add up, before they are clipped and encoded.
        environment : path or (H, W, 3) array, optional
            Equirectangular picture of linear radiance around the object, which 64 distant lights stand for;
            see `objectfolder.vision.environment.environment_lamps`. It is light only: the background stays
            white.

        Returns
        -------
        (N, H, W, 3) float32, sRGB in [0, 1]

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite or too large, a matrix is not a rotation and
            position, there is no light, or the images do not fit into memory.
        """
        smooth, seen_by = _flag("supersample", supersample), Intrinsics.given(intrinsics, resolution)
        lamps = gather_lamps(lights, environment)
        images = view_images(lambda: self._parts.vision.drawer(smooth), camera, light, seen_by, lamps)
        return like_first(images, camera)

    @usual_modes()
    def render(
        self,
        camera: Rows,
        light: Rows | None = None,
        resolution: int | None = None,
        intrinsics: Intrinsics | None = None,
        supersample: bool = True,
        lights: Lights = None,
        environment: Environment = None,
    ) -> Views:
        """Render colour, alpha, depth and normals; otherwise as `view`.

        Returns
        -------
        Views
            Of numpy arrays.
        """
        smooth, seen_by = _flag("supersample", supersample), Intrinsics.given(intrinsics, resolution)
        lamps = gather_lamps(lights, environment)
        return render_views(
            lambda: self._parts.vision.drawer(smooth), self.scale, camera, light, seen_by, lamps
        )

    @usual_modes()
    def impact(
        self,
        points: Answer | Sequence[Any],
        forces: Rows,
        sample_rate: float = 16000,
        duration: float = 2.0,
        response: str = "displacement",
        tolerance: float = TOLERANCE,
        contact_time: float | None = None,
        material: str | Material | None = None,
        scale: float | None = None,
        striker: str | Striker | None = None,
        listener: Rows | None = None,
        delay: bool = False,
    ) -> Answer:
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
            Greatest distance of a point from the surface, fraction of the size.
        contact_time : float, optional
            Duration of the strike, seconds: half a sine of force whose integral is the impulse. 0 is an
            ideal impulse. Default: that of the striker, see `contact_time`. Give one of both.
        material : str or Material, optional
            Material of the struck object. Another Poisson ratio makes the answer approximate: a warning
            gives the error bounds.
        scale : float, optional
            Longest side of the struck object, metres; ``points`` are metres of that object. A warning names
            the band where modes are missing.
        striker : str or Striker, optional
            What strikes the object: a name of `objectfolder.audio.contact.striker_names`, or a file.
            Default: steel, or an ideal impulse where the contact time is not known.
        listener : (N, 3) array, optional
            Where the strikes are heard, object frame, metres; outside the ball about the origin that holds
            the object. The answer is then the sound pressure there, in pascals, of the modes and of the
            recoil of the object as a whole.
        delay : bool
            Whether sounds reach a listener after the time that they need, rather than with the strikes.

        Returns
        -------
        (N, samples) float32, absolute amplitude

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite or too large, a point is off the surface, the sounds
            do not fit into memory, the file does not say how the struck object sounds at a listener, or it
            does not say how long a given striker touches. If the material is undamped, both a striker and a
            contact time are given, or a delay without a listener.
        """
        places = finite_rows("points", points, 3)
        longer = "points" if len(places) > 1 else "forces"
        strikes = broadcast_rows("points", places, "forces", finite_rows("forces", forces, 3))
        late = _flag("delay", delay)
        if late and listener is None:
            raise ObjectFolderError("delay=True needs a listener; give listener, or leave delay out")
        ears = None
        if listener is not None:
            ears = finite_rows("listener", listener, 3)
            struck, ears = broadcast_rows(longer, strikes[0], "listener", ears)
            strikes = broadcast_rows("points", struck, "forces", strikes[1])
        settings = SoundSettings.checked(
            *(sample_rate, duration, response, contact_time, material, scale, striker, len(strikes[0])),
            heard=ears is not None,
        )
        if ears is None:
            return like_first(self._parts.audio.impact(*strikes, settings, tolerance), points)
        listening = Listening(ears, late)
        parts = self._parts
        sounds = parts.audio.heard(*strikes, settings, tolerance, lambda: parts.radiation, listening)
        return like_first(sounds, points)

    def listen(
        self,
        points: Rows,
        forces: Rows,
        sample_rate: float | None = None,
        duration: float = 2.0,
        response: str | None = None,
        **strike: Any,
    ) -> list[Any]:
        """Strike the object in a notebook, and return a player of each sound.

        Parameters
        ----------
        points, forces, sample_rate, duration, response
            As of `impact`. By default those of the viewer: acceleration at 44.1 kHz, or the pressure at a
            listener; of a file that stores spectrograms, what they hold: displacement at 16 kHz.
        **strike
            Others of `impact`.

        Returns
        -------
        list of IPython.display.Audio
            The loudest sound has 0.9 of full scale.
        """
        pressure = strike.get("listener") is not None
        rate = sample_rate if sample_rate is not None else 44100 if self.has_modes else 16000
        if response is None:
            response = "acceleration" if self.has_modes and not pressure else "displacement"
        sounds = self.impact(real_array("points", points), forces, rate, duration, response, **strike)
        # As for gradients: no stage asks for players.
        players: list[Any] = import_module("objectfolder.audio.notebook").players(sounds, rate)
        return players

    @usual_modes()
    def contact_time(
        self,
        striker: str | Striker = "steel",
        material: str | Material | None = None,
        scale: float | None = None,
    ) -> float:
        """Return how long a striker touches the object, or one of its shape, seconds.

        0, an ideal impulse, if the file does not say what its modes are of, as imported ones do not, or
        stores spectrograms.

        Parameters
        ----------
        striker : str or Striker
            One of `objectfolder.audio.contact.striker_names`, or a file with a striker.
        material, scale
            As in `impact`.
        """
        tip, struck = load_striker(striker), struck_object(material, scale)
        return self._parts.audio.contact_time(tip, *struck) or 0.0

    @usual_modes()
    def voice(
        self, sample_rate: float = 48000, material: str | Material | None = None, scale: float | None = None
    ) -> "Voice":
        """Return the modes of the object, or of one of its shape, for sounds that go on; see docs/senses.md.

        Parameters
        ----------
        sample_rate : float
            Hz. Modes at or above half of it are left out.
        material, scale
            As in `impact`.

        Raises
        ------
        ObjectFolderError
            If the file knows no modes or not what they are of, all are above half the sample rate, or the
            material is undamped.
        """
        rate, (stuff, size) = checked_sample_rate(sample_rate), struck_object(material, scale)
        if isinstance(stuff, Material):
            stuff.require_damping()
        voice = import_module("objectfolder.objectfile.voice")  # as in `torch`
        return voice.Voice(self._parts, rate, stuff, size)

    @usual_modes()
    def mode_shapes(self, points: Rows, tolerance: float = TOLERANCE) -> np.ndarray:
        """Return mass-normalised mode shapes: the modal gains of unit impulses along x, y and z.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres; snapped to the surface.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.

        Returns
        -------
        (N, 3, M) float32, kg^-1/2
        """
        return self._parts.audio.mode_shapes(finite_rows("points", points, 3), tolerance)

    @usual_modes()
    def touch(
        self,
        points: Answer | Sequence[Any],
        depth: Scalars | None = None,
        angle: Scalars | None = None,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
    ) -> Answer:
        """Press a tactile sensor on the object.

        Parameters
        ----------
        points : (N, 3) array
            Contact points, object frame, metres. Those within a quarter voxel of the stored surface stay
            where they are; others are snapped to it. A single point serves all depths and angles.
        depth : float or (N,) array
            How far the gel's apex is pressed past the surface, metres. Default: 1 mm, or that of a net which
            knows one press alone (`fixed_contact`).
        angle : float or (N,) array
            Rotation of the sensor about the outward contact normal, radians. Default: 0, or as the depth.
        tilt, azimuth : float or (N,) array
            Lean of the sensor from the contact normal, at most a right angle, and its direction in the
            tangent plane (from image up towards image right), radians.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.
        sensor : str, Path or SensorProfile, optional
            Name of a profile that comes with the package, a ``.yaml`` file, or a profile. Default: the stored
            one.

        Returns
        -------
        (N, H, W, 3) uint8, RGB

        Raises
        ------
        ObjectFolderError
            If shapes do not fit, values are not finite, a depth is negative or beyond the gel, a tilt is
            beyond a right angle, a point is off the surface, or the touch net does not know such contacts.
        """
        profile = _profile(sensor)
        usual = self.fixed_contact or FixedContact(depth=0.001, angle=0.0)
        depth, angle = usual.depth if depth is None else depth, usual.angle if angle is None else angle
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth)
        return like_first(self._parts.touch.images(contacts, tolerance, profile), points)

    @usual_modes()
    def press(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
        shear: Rows | None = None,
        twist: Scalars = 0.0,
        friction: Scalars | None = None,
        markers: bool | Markers = False,
    ) -> Touches:
        """Press a tactile sensor on the object, then move the object sideways and turn it.

        Parameters
        ----------
        points, depth, angle, tilt, azimuth, tolerance, sensor : as in `touch`
        shear : (2,) or (N, 2) array, optional
            Motion of the object against the sensor after the press, along image right and image up, metres;
            at most as long as the sensor's ``max_indentation``.
        twist : float or (N,) array
            Turn of the object about the sensor's axis after the press, anticlockwise in the image, radians;
            at most half a turn.
        friction : float or (N,) array, optional
            Coefficient of friction between object and gel. Default: that of the object's material
            (`objectfolder.touch.friction`).
        markers : bool or Markers
            Draw dots on the gel into the images: a default grid, or another.

        Returns
        -------
        Touches
            Images, heights, normals, contact masks, displacements, pressures, forces, areas, penetrations and
            obstruction. With shear, a twist or markers it is a `ShearedTouches`, whose images, of every kind,
            are those after the motion, and which also has the gel's sideways displacement, tractions, shear
            force, torque and the markers' flow.

        Raises
        ------
        ObjectFolderError
            As `touch`; also if the gel that is to be sheared is rigid, a shear is too long, a twist is beyond
            half a turn, or a friction is negative.
        """
        profile, dots = _profile(sensor), _dots(markers)
        rubbing = self.friction if friction is None else friction
        moved = max(
            1 if shear is None else len(finite_rows("shear", shear, 2)),
            real_array("twist", twist).size,
            real_array("friction", rubbing).size,
        )
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth, moved)
        count = len(contacts.points)
        motion = sideways_motion(shear, twist, rubbing, count, profile or self.sensor_profile)
        found = concatenate_touches(self._parts.touch.touches(contacts, tolerance, profile), count)
        if shear is None and not motion.twist.any() and dots is None:
            return found
        return shear_touches(
            found,
            motion.shear,
            motion.twist,
            motion.friction,
            dots,
            lambda displacement: self._parts.touch.shown(displacement, found.profile),
        )

    @usual_modes()
    def touches(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        angle: Scalars = 0.0,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
        sensor: Sensor = None,
    ) -> Iterator[Touches]:
        """Answer as `press`, a few contacts at a time: for more of them than fit into memory."""
        profile = _profile(sensor)
        contacts = ContactPoses.checked(points, depth, angle, tilt, azimuth)
        return each_in_usual_modes(self._parts.touch.touches(contacts, tolerance, profile))

    @usual_modes()
    def depth_maps(
        self,
        points: Rows,
        depth: Scalars = 0.001,
        tilt: Scalars = 0.0,
        azimuth: Scalars = 0.0,
        tolerance: float = TOLERANCE,
    ) -> np.ndarray:
        """Return the depth maps that the touch net of an imported 2.0 file stores; parameters as in `touch`.

        Returns
        -------
        (N, 120, 160) float32, metres from the released sensor's camera

        Raises
        ------
        ObjectFolderError
            If the file holds no such net (`press` returns heights for all others), or the net does not know
            such contacts.
        """
        contacts = ContactPoses.checked(points, depth, 0.0, tilt, azimuth)
        return self._parts.touch.depth_maps(contacts, tolerance)

    @usual_modes()
    def sample_surface(self, count: int, seed: int | np.random.Generator | None = 0) -> np.ndarray:
        """Draw random surface points, uniform by area; (count, 3), object frame, metres.

        Parameters
        ----------
        count : int
        seed : int, numpy Generator or None
            The same number draws the same points each time; a generator goes on to others, and None draws
            others in every call.

        Raises
        ------
        ObjectFolderError
            If the count is not a whole number of at least 0, the seed is none of these, or the points do not
            fit into memory.
        """
        drawn, rng = whole_number("count", count), _generator(seed)
        require_memory(f"{drawn} points on the surface", _BYTES_PER_POINT * drawn, "draw fewer at a time")
        return self._parts.surface.sample(drawn, rng)

    @usual_modes()
    def nearest(self, points: Rows) -> tuple[np.ndarray, np.ndarray]:
        """Return the nearest surface points.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres.

        Returns
        -------
        nearest : (N, 3) float64, object frame, metres
        distance : (N,) float64, metres

        Raises
        ------
        ObjectFolderError
            If the points are not finite rows of three, or are further away than a million times the object's
            size.
        """
        return self._parts.surface.nearest(finite_rows("points", points, 3))

    @usual_modes()
    def contact_normals(self, points: Rows, tolerance: float = TOLERANCE) -> np.ndarray:
        """Return the directions against which `touch` and `press` move a sensor that is not tilted.

        They are means over a neighbourhood, so that they lean at edges;
        `objectfolder.touch.contact.contact_normals` defines them.

        Parameters
        ----------
        points : (N, 3) array
            Object frame, metres; snapped to the surface as by `touch`.
        tolerance : float
            Greatest distance of a point from the surface, fraction of the size.

        Returns
        -------
        (N, 3) float64, outward unit vectors

        Raises
        ------
        ObjectFolderError
            If the points are not finite rows of three, or one is off the surface.
        """
        places = self._parts.surface.unit_feet(finite_rows("points", points, 3), tolerance, UNMOVED)
        normals: np.ndarray = contact_normals(self.surface.grid.smooth_distance, places, NORMAL_RADIUS)
        return normals

    @usual_modes()
    def to_mesh(self) -> "trimesh.Trimesh":
        """Return the stored surface as a triangle mesh with normals, object frame, metres."""
        import trimesh

        surface = self.surface
        return trimesh.Trimesh(
            surface.vertices * self.scale,
            surface.faces.copy(),
            vertex_normals=surface.normals.copy(),
            process=False,
        )

    def torch(self, dtype: "torch.dtype | None" = None) -> "Answers":
        """Return modules whose answers carry gradients, the same at each call; see docs/gradients.md.

        Parameters
        ----------
        dtype : torch.dtype, optional
            float32, the default, or float64.

        Raises
        ------
        ObjectFolderError
            If the type is another.
        """
        # Not an import statement: stages use ObjectFile, none asks for gradients, so none depends on them.
        answers = import_module("objectfolder.objectfile.gradients.answers")
        made: Answers = answers.Answers(self._parts, dtype)
        return self._answers.setdefault(made.dtype, made)

    @property
    def _touch_config(self) -> dict[str, Any]:
        return self._parts.described("touch")["net"]


def _generator(seed: int | np.random.Generator | None) -> np.random.Generator:
    if seed is None or isinstance(seed, np.random.Generator):
        return np.random.default_rng(seed)
    try:
        return np.random.default_rng(whole_number("seed", seed))
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{error}, a numpy Generator or None") from None


def _profile(sensor: Sensor) -> SensorProfile | None:
    return None if sensor is None else load_profile(sensor)


def _dots(markers: bool | Markers) -> Markers | None:
    """Return the dots to draw, if any."""
    if isinstance(markers, Markers):
        return markers
    if not isinstance(markers, bool | np.bool_):
        raise ObjectFolderError(
            f"markers is of type {type(markers).__name__}, expected True, False or a Markers of "
            "objectfolder.touch.markers, such as Markers(spacing=0.0015, radius=0.00025)"
        )
    return Markers() if markers else None


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise ObjectFolderError(f"{name} is of type {type(value).__name__}, expected True or False")
    return bool(value)


def _usable(device: Device) -> torch.device:
    """Return a device on which a tensor has been, and come back."""
    try:
        found = torch.device(device)
        torch.zeros(1, device=found).cpu()
    except Exception as error:  # each kind of device has its own
        raise ObjectFolderError(
            f"device is {device!r}, which torch cannot use here ({shortened(error, 200)}); "
            "expected a device of this machine, such as 'cpu'"
        ) from error
    return found
