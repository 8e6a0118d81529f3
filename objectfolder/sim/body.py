"""Objects as rigid bodies: mass and inertia of the solid, and convex hulls for collisions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from platformdirs import user_cache_path
from scipy.spatial.transform import Rotation

from objectfolder.base import materials
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.calls import object_file
from objectfolder.sim.hulls import cached_hulls
from objectfolder.sim.solid import close_holes

#: Folder in which convex hulls are cached, or the hulls, object frame, m; None: a folder of the user's.
Hulls = str | Path | Sequence[trimesh.Trimesh] | None
TORSIONAL, ROLLING = 0.005, 0.0001  #: friction, m: MuJoCo's defaults


@dataclass(frozen=True)
class RigidBody:
    """Mass properties and collision shape of an object; object frame, metres."""

    key: str
    hulls: tuple[trimesh.Trimesh, ...]  #: closed and convex; their union is the collision shape
    mass: float  #: kg
    centre: np.ndarray  #: centre of mass; (3,)
    inertia: np.ndarray  #: about the centre of mass, object axes; (3, 3), kg m^2
    friction: float  #: sliding
    bounds: np.ndarray  #: lowest and highest coordinates of the surface; (2, 3)

    @property
    def points(self) -> np.ndarray:
        """Vertices of all hulls; (P, 3)."""
        return np.concatenate([hull.vertices for hull in self.hulls])

    def principal(self, turn: np.ndarray | None = None) -> tuple[np.ndarray, Rotation]:
        """Return the principal moments of inertia, (3,) kg m^2, ascending, and the rotation to their axes.

        They are wanted in axes to which ``turn`` (3, 3) rotates; by default, in the object's.
        """
        turn = np.eye(3) if turn is None else turn
        moments, axes = np.linalg.eigh(turn @ self.inertia @ turn.T)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        return moments, Rotation.from_matrix(axes)


def rigid_body(file: ObjectFile, hulls: Sequence[trimesh.Trimesh]) -> RigidBody:
    """Compute the mass properties of the solid, evenly filled: with the object's material, or to its mass.

    The file stores volume, centre and inertia of the source's closed surface. Files older than format 1.1 do
    not; their solid is bounded by the stored surface. If the file holds the mass of the real object, which
    may be hollow where the solid is not, that counts, and the inertia is in proportion.

    Parameters
    ----------
    file : ObjectFile
    hulls : sequence of trimesh.Trimesh
        Convex parts of this object, object frame, metres; see `objectfolder.sim.hulls`.

    Raises
    ------
    ObjectFolderError
        If the file holds no geometry or an impossible inertia, there are no hulls, or they belong to another
        object: their bounds differ from the surface's by over a tenth of its size.
    """
    if not hulls:
        raise ObjectFolderError(f"{file.key}: no hulls to collide with; expected at least one")
    if not all(isinstance(hull, trimesh.Trimesh) for hull in hulls):
        raise ObjectFolderError(
            f"{file.key}: hulls is {quoted(hulls)}, expected a list of meshes, such as `cached_hulls` returns"
        )
    surface = close_holes(file.to_mesh())
    _check_fit(file.key, surface.bounds, hulls)
    if "solid" in file.header:
        volume, centre, inertia = solid_moments(file)
    else:
        found = surface.mass_properties
        volume, centre = float(found.volume), np.asarray(found.center_mass)
        inertia = np.asarray(found.inertia)
    filled = body_density(file)
    return RigidBody(
        key=file.key, hulls=tuple(hulls), mass=file.header.get("mass", filled * volume), centre=centre,
        inertia=filled * inertia, friction=file.friction, bounds=np.asarray(surface.bounds),
    )  # fmt: skip


def as_rigid_body(file: ObjectFile | RigidBody | str | Path, hulls: Hulls = None) -> RigidBody:
    """Return the rigid body of an object; to compute hulls takes up to half a minute.

    Raises ObjectFolderError as `rigid_body` and `cached_hulls`, or if ``hulls`` is none of `Hulls`.
    """
    if isinstance(file, RigidBody):
        return file
    file = object_file(file)
    if hulls is None or isinstance(hulls, str | Path):
        return rigid_body(file, cached_hulls(file, user_folder() if hulls is None else hulls))
    given = hulls if isinstance(hulls, Sequence) else [hulls]
    meshes = [hull for hull in given if isinstance(hull, trimesh.Trimesh)]
    if len(meshes) < len(given) or hulls is not given:
        raise ObjectFolderError(
            f"{file.key}: hulls is {quoted(hulls)}, expected a folder to cache them in, or a list of meshes"
        )
    return rigid_body(file, meshes)


def user_folder() -> Path:
    """Return the folder in which hulls are cached for the user."""
    return user_cache_path("objectfolder") / "hulls"


def scaled_body(body: RigidBody, ratio: float, density: float = 1.0) -> RigidBody:
    """Return the body of another size and density.

    Parameters
    ----------
    body : RigidBody
    ratio, density : float
        Of the new body's lengths and densities to the old one's.
    """
    hulls = tuple(trimesh.Trimesh(hull.vertices * ratio, hull.faces, process=False) for hull in body.hulls)
    return replace(
        body, hulls=hulls, mass=body.mass * density * ratio**3, centre=body.centre * ratio,
        inertia=body.inertia * density * ratio**5, bounds=body.bounds * ratio,
    )  # fmt: skip


def density(file: ObjectFile) -> float:
    """Return the density of the object's material, kg/m^3: the file's own, else from the materials table.

    Raises ObjectFolderError if neither has it.
    """
    stored = file.header.get("material_properties")
    if stored:
        return float(stored["density"])
    if file.material.lower() not in materials.material_names():
        raise ObjectFolderError(
            f"{file.key}: its density is not known: the file stores none, and {file.material!r} is "
            f"none of {', '.join(materials.material_names())}; import the file again with --material"
        )
    return materials.material(file.material).density


def body_density(file: ObjectFile) -> float:
    """Return the mean density of the object's solid, kg/m^3: of its mass, if the file holds it.

    Else that of its material; raises ObjectFolderError as `density`.
    """
    given = file.header.get("mass")
    return density(file) if given is None else given / (file.header["solid"]["volume"] * file.scale**3)


def add_body(
    spec: mujoco.MjSpec, body: RigidBody, name: str = "object", parent: "mujoco.MjsBody | None" = None,
    free: bool | None = None,
) -> "mujoco.MjsBody":  # fmt: skip
    """Add an object to a MuJoCo model; the body frame is the object frame.

    The object does not depend on the scene: the scene's default classes do not apply to it.

    Parameters
    ----------
    spec : mujoco.MjSpec
    body : RigidBody
    name : str
        Name of the body and its free joint; geoms and their meshes are ``<name>_hull0``, ...
    parent : mujoco.MjsBody, optional
        Default: the world.
    free : bool, optional
        Whether the object moves freely, which only children of the world can; else it is fixed to its parent,
        and moves as that does. Default: whether its parent is the world.

    Raises
    ------
    ObjectFolderError
        If it shall be free, but has another parent, or if the compiler's settings would change its mass or
        inertia.
    """
    parent = parent or spec.worldbody
    on_world = parent == spec.worldbody
    free = on_world if free is None else free
    if free and not on_world:
        raise ObjectFolderError(
            f"{name}: only children of the world move freely, but its parent is {parent.name!r}; leave out "
            "the parent, or fix it to that with free=False"
        )
    _check_compiler(spec, body, name)
    try:
        added = parent.add_body(name=name)
    except ValueError as error:  # such as "world"
        raise ObjectFolderError(
            f"name is {name!r}, which MuJoCo refuses for a body: {error}; give another name"
        ) from error
    if free:
        added.add_freejoint(name=name).align = mujoco.mjtAlignFree.mjALIGNFREE_FALSE  # keeps the frame
    added.explicitinertial = True
    added.mass, added.ipos = body.mass, body.centre
    added.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    plain = mujoco.MjSpec().default  # MuJoCo's own, instead of the scene's
    for k, hull in enumerate(body.hulls):
        part = f"{name}_hull{k}"
        spec.add_mesh(plain, name=part, uservert=hull.vertices.ravel(), userface=hull.faces.ravel())
        added.add_geom(
            plain, name=part, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=part, condim=4,
            friction=[body.friction, TORSIONAL, ROLLING],
        )  # fmt: skip
    return added


def _check_compiler(spec: mujoco.MjSpec, body: RigidBody, name: str) -> None:
    """Raise ObjectFolderError if the settings of a spec's compiler would change the body."""
    settings, least = spec.compiler, float(body.principal()[0][0])
    wrong = {
        "inertiafromgeom": settings.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE,
        "settotalmass": settings.settotalmass > 0,
        "boundmass": settings.boundmass > body.mass,
        "boundinertia": settings.boundinertia > least,
    }
    for setting, changes in wrong.items():
        if changes:
            raise ObjectFolderError(
                f"{name}: the scene's compiler would change its mass, {body.mass:.4g} kg, or its inertia, "
                f"{least:.4g} kg m^2 and more: {setting} is {getattr(settings, setting)}; leave it out"
            )


def solid_moments(file: ObjectFile) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, centre and inertia (3, 3), at density 1, of the solid that a file stores; metres.

    Raises ObjectFolderError if no body has the inertia.
    """
    solid, size = file.header["solid"], file.scale
    xx, yy, zz, xy, xz, yz = solid["inertia"]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    principal = np.linalg.eigvalsh(inertia)
    if not 0 < principal[0] <= principal[2] <= principal[:2].sum():
        raise ObjectFolderError(
            f"{file.key}: no body has the principal moments of inertia that the file stores, "
            f"{principal.tolist()}; build it again"
        )
    return solid["volume"] * size**3, size * np.array(solid["centre"]), size**5 * inertia


def _check_fit(key: str, bounds: np.ndarray, hulls: Sequence[trimesh.Trimesh]) -> None:
    """Raise unless the bounds of the hulls are about those of the surface."""
    reach = np.array([hull.bounds for hull in hulls])
    lowest, highest = reach[:, 0].min(0), reach[:, 1].max(0)
    size = (bounds[1] - bounds[0]).max()
    if np.abs([lowest - bounds[0], highest - bounds[1]]).max() > 0.1 * size:
        raise ObjectFolderError(
            f"{key}: its hulls reach from {lowest.round(4).tolist()} to {highest.round(4).tolist()}, the "
            f"surface from {bounds[0].round(4).tolist()} to {bounds[1].round(4).tolist()} m; they are of "
            "another object or frame: make them of this file's to_mesh()"
        )


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, np.float64))
    return matrix.reshape(3, 3)


def turn_poses(poses: np.ndarray, yaws: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Rotate poses (N, 7) by yaws (N,) about the vertical through the origin, then shift them by (N, 2)."""
    yaws = np.asarray(yaws, np.float64)
    cos, sin = np.cos(yaws), np.sin(yaws)
    x, y, z = poses[:, :3].T
    moved = np.stack([cos * x - sin * y, sin * x + cos * y, z], 1)
    moved[:, :2] += shifts
    half = np.stack([np.cos(yaws / 2), 0 * yaws, 0 * yaws, np.sin(yaws / 2)], 1)
    quaternions = np.empty((len(poses), 4))
    for out, turn, pose in zip(quaternions, half, poses):
        mujoco.mju_mulQuat(out, turn, pose[3:])
    return np.c_[moved, quaternions]
