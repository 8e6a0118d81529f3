"""A mesh as an asset for simulators, without a build: mass, inertia, friction, hulls and look."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from objectfolder.base.checks import check_mass, finite_number, one_of
from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.installation import installed_version
from objectfolder.base.io import file_digest, write_json
from objectfolder.base.materials import Material, own_material
from objectfolder.mesh.hollow import hollow_out, thickest_part
from objectfolder.mesh.normalize import mass_properties
from objectfolder.mesh.scanline import check_winding
from objectfolder.mesh.sdf import fit_grid
from objectfolder.mesh.settings import NormalizeConfig
from objectfolder.mesh.topology import Mesh, face_areas
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.packing import pack_shape
from objectfolder.sim.body import RigidBody, rigid_body
from objectfolder.sim.drawing import draw_look
from objectfolder.sim.export import NEEDED, PhysicsModel
from objectfolder.sim.hulls import MAX_HULLS, convex_hulls
from objectfolder.sim.visual import source_look
from objectfolder.sim.weight import Weight, judge_weight
from objectfolder.sound.fem.settings import VoxelizeConfig
from objectfolder.workspace.discover import slug
from objectfolder.workspace.examine import UNITS, Candidate, ClosedCandidate, close_candidate

#: Functions that write a format, by its name.
FILLS = {
    "mjcf": "export.fill_mjcf",
    "urdf": "export.fill_urdf",
    "usd": "usd.fill_usd",
    "glb": "gltf.fill_glb",
}
FORMATS = tuple(FILLS)  #: of assets
REPORT, THUMBNAIL = "asset.json", "thumbnail.png"  #: files of every asset
#: Names of mesh files that say nothing of the object: the folder's counts.
NAMELESS = ("mesh", "model", "object", "scene", "textured", "nontextured", "visual")


@dataclass(frozen=True)
class Asset:
    """An object for physics engines: its surface, mass and look. Hulls are computed when they are needed."""

    file: ObjectFile  #: surface, mass properties and material; it neither sounds nor feels
    look: trimesh.Trimesh  #: textured; object frame, metres
    weight: Weight
    source: Path  #: the mesh
    digest: str  #: SHA-256 of the mesh file
    closed_by: str  #: step of the repair that closed the surface; ``keep``: it was closed
    notes: tuple[str, ...]  #: of reading and closing the mesh

    @property
    def key(self) -> str:
        """Name of the object."""
        return self.file.key

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against using the asset as it is."""
        return (self.weight.warning,) if self.weight.warning else ()

    @cached_property
    def body(self) -> RigidBody:
        """Mass, inertia, friction and convex hulls; takes 10 to 20 s at its first use."""
        return self.make_body()

    def make_body(self, max_hulls: int = MAX_HULLS) -> RigidBody:
        """Return the rigid body with at most this many hulls."""
        return rigid_body(self.file, convex_hulls(self.file.to_mesh(), max_hulls))

    def write(
        self,
        out: str | Path,
        formats: Sequence[str] = ("mjcf", "urdf", "glb"),
        max_hulls: int = MAX_HULLS,
        inputs: str = "",
    ) -> Path:
        """Write the folder ``OUT/<key>``: the formats, ``asset.json`` and ``thumbnail.png``.

        Parameters
        ----------
        out : path
        formats : sequence of str
            Of `FORMATS`: ``<key>.xml``, ``<key>.urdf``, ``usd/<key>.usd``, ``<key>.glb``, with hulls and
            textured surface beside them. The body frame is the object frame: metres, z up, origin in the
            centre of the bounding box.
        max_hulls : int
        inputs : str
            Digest of what the asset is made from, by which a run knows it again.

        Returns
        -------
        Path
            Of the folder.

        Raises
        ------
        ObjectFolderError
            If the folder exists already, a format is unknown, or an extra is not installed.
        """
        fills = [_fill(name) for name in dict.fromkeys(formats)]
        place = Path(out) / self.key
        with new_folder(f"{self.key}: asset", place, NEEDED, "") as new:
            body = self.body if max_hulls == MAX_HULLS else self.make_body(max_hulls)
            model = PhysicsModel(self.file, body, self.look, self.facts())
            for fill in fills:
                fill(new, model)
            Image.fromarray(draw_look(self.look)).save(new / THUMBNAIL)
            write_json(new / REPORT, self.report(body) | {"formats": list(formats), "inputs": inputs})
        return place

    def facts(self) -> dict[str, str]:
        """Return what each file of the asset states in words."""
        warned = {"warning": "; ".join(self.warnings)} if self.warnings else {}
        made = f"objectfolder {installed_version()} of {self.source.name}, SHA-256 {self.digest}"
        return {"mass": str(self.weight), **warned, "made": made}

    def report(self, body: RigidBody) -> dict[str, Any]:
        """Return the content of ``asset.json``; SI units, object frame."""
        return {
            "key": self.key,
            "mesh": self.source.name,
            "sha256": self.digest,
            "made": f"objectfolder {installed_version()}",
            "material": self.file.material,
            "size": self.file.scale,
            "mass": body.mass,
            "weight": self.weight.report(),
            "centre": body.centre.tolist(),
            "inertia": body.inertia.tolist(),
            "friction": body.friction,
            "bounds": body.bounds.tolist(),
            "hulls": len(body.hulls),
            "closed_by": self.closed_by,
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }


def asset(
    mesh: str | Path,
    material: str | Path | Material,
    scale: float | None = None,
    *,
    key: str | None = None,
    mass: float | None = None,
    shell: float | None = None,
    up: str | None = None,
    unit: str = "m",
    wall: float | None = None,
    bridge: str = "all",
) -> Asset:
    """Turn a mesh into an asset for physics engines, without a workspace or a build.

    Mass, inertia and hulls are those that ``objectfolder build`` of the same mesh and then ``objectfolder
    export`` would give.

    Parameters
    ----------
    mesh : path
        In one of `objectfolder.mesh.reading.load.FORMATS`.
    material : str, path or Material
        A name such as "steel", or a material's file.
    scale : float, optional
        Longest side, metres; default: that of the mesh, whose unit is ``unit``.
    key : str, optional
        Name of the object; default: of the file, or of its folder if the file is called ``mesh`` or the like.
    mass : float, optional
        Of the real object, kg.
    shell : float, optional
        Wall of a hollow object whose mesh is closed, such as a bottle or can, metres.
    up : {"y", "z"}, optional
        Default: y for glTF, else z.
    unit : {"m", "cm", "mm"}
        Of the mesh's coordinates.
    wall, bridge
        As for ``objectfolder add``.

    Raises
    ------
    ObjectFolderError
        If the mesh cannot be read or closed, or an argument is impossible.

    Examples
    --------
    >>> can = objectfolder.asset("can.obj", "steel", 0.102, shell=0.0003)
    >>> print(can.weight)
    >>> can.write("assets")
    """
    path = Path(mesh)
    given = material if isinstance(material, Material) else str(material)
    name = key or default_key(path)
    named = given.name if isinstance(given, Material) else given
    candidate = Candidate(name, path, named, size=scale, up=up, wall=wall, mass=mass, shell=shell)
    return candidate_asset(candidate, unit, bridge, given if isinstance(given, Material) else None)


def default_key(mesh: Path) -> str:
    """Return the name of the object in a mesh file."""
    resolved = mesh.resolve()
    return slug(resolved.parent.name if resolved.stem.lower() in NAMELESS else resolved.stem)


def candidate_asset(
    candidate: Candidate, unit: str = "m", bridge: str = "all", material: Material | None = None
) -> Asset:
    """Return the asset of a candidate, as `asset` does; ``material`` replaces the candidate's."""
    key = candidate.key
    if candidate.refusal is not None:
        raise ObjectFolderError(candidate.refusal)
    if candidate.material is None:
        raise ObjectFolderError(f"{key} has no material; give --material, or list it in a table")
    one_of("unit", unit, tuple(UNITS))
    one_of("bridge", bridge, ("all", "fem", "off"))
    for name in ("size", "wall", "mass", "shell"):
        value = getattr(candidate, name)
        if value is not None and not finite_number(f"{key}: {name}", value) > 0:
            unit_of = "kilograms" if name == "mass" else "metres"
            raise ObjectFolderError(f"{key}: {name} is {value:g}, expected {unit_of} above 0, or none")
    stuff = material or own_material(candidate.material, "loss_factor")
    closed = close_candidate(candidate, NormalizeConfig().texture_size, None, None, unit, None, bridge)
    return _closed_asset(closed, stuff, bridge)


def _closed_asset(closed: ClosedCandidate, material: Material, bridge: str) -> Asset:
    candidate, normalized, scale = closed.candidate, closed.normalized, closed.scale
    key, whole = candidate.key, normalized.surface.mesh
    seen = _as_stored(normalized.select_visible(bridge))
    check_winding(*seen, key)
    grid = fit_grid(*seen, VoxelizeConfig().sdf_resolution, key)
    shell = candidate.shell
    if shell is not None:
        if shell >= scale / 2:
            raise ObjectFolderError(
                f"{key}: shell is {1000 * shell:g} mm, expected a wall under half of the size, "
                f"{1000 * scale:g} mm: --shell is in millimetres"
            )
        whole = hollow_out(whole, shell / scale, key)
    report = closed.report | {"solid": mass_properties(whole)}
    volume = report["solid"]["volume"] * scale**3
    thickest = scale * thickest_part(normalized.surface.mesh)
    area = scale**2 * float(face_areas(*normalized.surface.mesh).sum())
    if candidate.mass is not None:
        check_mass(key, candidate.mass, volume)
    weight = judge_weight(material, volume, area, thickest, shell, candidate.mass)
    digest = file_digest(candidate.mesh)
    sdf: dict[str, np.ndarray] = {"values": grid.values, "band": np.array(grid.band), **vars(grid.features)}
    named = material.name, material.properties()
    header, tensors = pack_shape(key, named, scale, report, sdf, {"mesh": digest}, candidate.mass, effort=0)
    file = ObjectFile(header, tensors, candidate.mesh)
    look = source_look(normalized.visual, file)
    closed_by = normalized.surface.last_step
    return Asset(file, look, weight, candidate.mesh, digest, closed_by, tuple(closed.notes))


def _as_stored(surface: Mesh) -> Mesh:
    """Return a surface as a build reads it from ``surface.ply``, in single precision."""
    return surface[0].astype(np.float32).astype(np.float64), surface[1]


def _fill(name: str) -> Callable[[Path, PhysicsModel], None]:
    module, function = FILLS[one_of("format", name, FORMATS)].split(".")
    found: Callable[[Path, PhysicsModel], None] = getattr(
        import_module(f"objectfolder.sim.{module}"), function
    )
    return found


def inputs_digest(files: Mapping[Any, Path], options: Any) -> str:
    """Return the SHA-256 of the files and options that an asset is made from, and of this version."""
    digests = sorted((str(name), file_digest(path)) for name, path in files.items())
    return hashlib.sha256(repr((digests, options, installed_version())).encode()).hexdigest()
