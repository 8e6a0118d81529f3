"""The Object File: one safetensors file that answers how an object looks, sounds and feels.

docs/objectfile.md describes the format. Reading it needs no mesh, no pickle and no network.
"""

import copy
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from objectfolder.base.arrays import open_safetensors, safetensors_bytes, write_safetensors
from objectfolder.base.checks import require_memory, whole_number
from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.materials import Material
from objectfolder.mesh.isosurface import Isosurface
from objectfolder.objectfile.parts import StoredParts
from objectfolder.objectfile.samples import available_samples, sample_path
from objectfolder.sound.query import SoundQueries, struck_object
from objectfolder.sound.synthesis import checked_sample_rate
from objectfolder.stored.arguments import Rows, finite_rows, usual_modes
from objectfolder.stored.header import checked_header
from objectfolder.stored.kinds import checked_nets, net_kinds
from objectfolder.stored.reading import described_part, held_parts
from objectfolder.touch.query import TouchQueries
from objectfolder.vision.query import VisionQueries

if TYPE_CHECKING:
    import trimesh

    from objectfolder.objectfile.gradient import Answers
    from objectfolder.objectfile.voice import Voice

Device = str | torch.device  #: of nets

_BYTES_PER_POINT = 84  # that drawing a random point takes


class ObjectFile(VisionQueries, SoundQueries, TouchQueries):
    """One object. Points of contacts and strikes are in the object frame (metres), cameras and lights in
    the unit frame (the object's longest side is 1); docs/conventions.md defines both.

    Queries take numpy arrays, lists, or torch tensors of any real type. If the first argument of `view`,
    `impact` or `touch` is a tensor, so is the answer, on the same device; no gradients flow. The answer to a
    row depends on that row only. Queries are thread-safe.

    The file is read into memory: later changes to the file do not affect results. A pickle or a copy holds
    its bytes, not its path, so it gives the same results in another process, on another machine and after a
    rebuild; parts are read again there. docs/queries.md tells how to query in worker processes.

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
        self._header = checked_nets(checked_header(header, path), path)
        self.tensors = tensors
        self.device = usable_device(device)
        self._path = path
        self._parts = StoredParts(self._header, tensors, self.device)
        self._answers: dict[torch.dtype, Answers] = {}

    @classmethod
    def load(cls, path: str | Path, device: Device = "cpu") -> "ObjectFile":
        """Read an Object File and check its header. Its parts are unpacked when a query first needs them.

        Nets are evaluated on the device, such as "cuda".

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
        """Return an Object File that comes with the package, mug, die or bell.

        Raises ObjectFolderError if there is none of this name.
        """
        return cls.load(sample_path(name))

    def __reduce__(self) -> tuple[Any, ...]:
        # Locks and ray casters cannot be pickled; every part can be read again.
        return type(self), (self._header, self.tensors, self._path, self.device)

    @usual_modes()
    def check(self) -> None:
        """Read all parts of the file, which queries otherwise do on demand.

        Raises ObjectFolderError if a part is damaged.
        """
        self._parts.check()

    def require(self, *parts: str) -> None:
        """Check that the file holds some parts, such as "audio", without reading them.

        Raises ObjectFolderError if it lacks one, or this version does not know its kind.
        """
        for part in parts:
            described_part(self._header, part)

    def save(self, path: str | Path) -> None:
        """Write the Object File; the same object gives the same bytes."""
        write_safetensors(path, dict(self.tensors), self._header)

    def __repr__(self) -> str:
        parts = ", ".join(held_parts(self._header)) or "nothing"
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
    @usual_modes()
    def bounds(self) -> np.ndarray:
        """Lowest and highest coordinates of the surface; (2, 3), object frame, metres."""
        return self._parts.surface.bounds()

    @property
    @usual_modes()
    def surface(self) -> Isosurface:
        """The stored surface, unit frame; extracted at first use. Its arrays are read-only."""
        return self._parts.geometry

    @usual_modes()
    def sample_surface(self, count: int, seed: int | np.random.Generator | None = 0) -> np.ndarray:
        """Draw random surface points, uniform by area; (count, 3), object frame, metres.

        The same number as seed draws the same points each time; a generator goes on to others, and None draws
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
        """Return the surface points nearest to points (N, 3), object frame, metres.

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
    def to_mesh(self) -> "trimesh.Trimesh":
        """Return the stored surface as a triangle mesh with normals, object frame, metres."""
        import trimesh

        surface = self.surface
        vertices, faces, normals = surface.vertices * self.scale, surface.faces.copy(), surface.normals.copy()
        return trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)

    @usual_modes()
    def voice(
        self, sample_rate: float = 48000, material: str | Material | None = None, scale: float | None = None
    ) -> "Voice":
        """Return the modes of the object, or of one of its shape, for sounds that go on; see docs/senses.md.

        Modes at or above half the sample rate, Hz, are left out; material and scale are as in `impact`.

        Raises
        ------
        ObjectFolderError
            If the file knows no modes or not what they are of, all are above half the sample rate, or the
            material is undamped.
        """
        rate, (stuff, size) = checked_sample_rate(sample_rate), struck_object(material, scale)
        if isinstance(stuff, Material):
            stuff.require_damping()
        # Not an import statement: stages use ObjectFile, none asks for voices, so none depends on them.
        module = import_module("objectfolder.objectfile.voice")
        made: Voice = module.Voice(self._parts, rate, stuff, size)
        return made

    def torch(self, dtype: "torch.dtype | None" = None) -> "Answers":
        """Return modules whose answers carry gradients, the same at each call; see docs/gradients.md.

        Raises ObjectFolderError if the type is another than float32, the default, or float64.
        """
        answers = import_module("objectfolder.objectfile.gradient")  # as in `voice`
        made: Answers = answers.Answers(self._parts, dtype)
        return self._answers.setdefault(made.dtype, made)


def _generator(seed: int | np.random.Generator | None) -> np.random.Generator:
    if seed is None or isinstance(seed, np.random.Generator):
        return np.random.default_rng(seed)
    try:
        return np.random.default_rng(whole_number("seed", seed))
    except ObjectFolderError as error:
        raise ObjectFolderError(f"{error}, a numpy Generator or None") from None


def usable_device(device: Device) -> torch.device:
    """Return a device on which a tensor has been, and come back; raise ObjectFolderError if that fails."""
    try:
        found = torch.device(device)
        torch.zeros(1, device=found).cpu()
    except Exception as error:  # each kind of device has its own
        raise ObjectFolderError(
            f"device is {device!r}, which torch cannot use here ({shortened(error, 200)}); "
            "expected a device of this machine, such as 'cpu'"
        ) from error
    return found


def load_placed(path: str | Path) -> ObjectFile:
    """Load an Object File for many queries: one with the paper's VisionNet on a GPU, if torch finds one.

    That net takes minutes for a view on a CPU. All others stay on the CPU, where they answer the same bytes
    with a GPU and without.
    """
    file = ObjectFile.load(path)
    kind = net_kinds("vision").get(file.header.get("vision", {}).get("kind"))
    return ObjectFile.load(path, "cuda") if kind and kind.slow and torch.cuda.is_available() else file
