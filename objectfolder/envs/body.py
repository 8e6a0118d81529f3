"""Objects as rigid bodies: mass and inertia of the true solid, convex hulls to collide with."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from objectfolder import materials
from objectfolder.envs.solid import close_holes
from objectfolder.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile

#: Sliding friction by material, dry, against a table or a silicone elastomer. Assumed: handbooks give
#: ranges of +-0.1 and more, and an elastomer's depends on load and wear.
FRICTION = {
    "ceramic": 0.5,
    "glass": 0.5,
    "wood": 0.6,
    "plastic": 0.5,
    "iron": 0.45,
    "polycarbonate": 0.5,
    "steel": 0.45,
}
_OTHER_FRICTION = 0.5  # of materials that a build defined itself
TORSIONAL, ROLLING = 0.005, 0.0001  #: friction, m: MuJoCo's defaults


@dataclass(frozen=True)
class RigidBody:
    """What a physics engine needs to know of an object; object frame, metres."""

    key: str
    hulls: tuple[trimesh.Trimesh, ...]  #: closed and convex; together they are the shape that collides
    mass: float  #: kg
    centre: np.ndarray  #: of mass; (3,)
    inertia: np.ndarray  #: about the centre of mass, object axes; (3, 3), kg m^2
    friction: float  #: sliding
    bounds: np.ndarray  #: lowest and highest coordinates of the surface; (2, 3)


def rigid_body(file: ObjectFile, hulls: Sequence[trimesh.Trimesh]) -> RigidBody:
    """Mass properties of the solid, full of the object's material.

    The solid is what the source's closed surface encloses, as the file tells; in files of before format 1.1,
    which do not, what the stored surface encloses.

    Parameters
    ----------
    file : ObjectFile
    hulls : sequence of trimesh.Trimesh
        Of this object, object frame, metres; see `objectfolder.envs.hulls`.

    Raises
    ------
    ObjectFolderError
        If the file holds no geometry, no body has the mass properties that it tells, there are no hulls, or
        they are not of this object: their bounds are further from the surface's than a tenth of its size.
    """
    if not hulls:
        raise ObjectFolderError(f"{file.key}: no hulls to collide with; expected at least one")
    surface = close_holes(file.to_mesh())
    _check_fit(file.key, surface.bounds, hulls)
    volume, centre, inertia = _moments(file, surface)
    return RigidBody(
        key=file.key,
        hulls=tuple(hulls),
        mass=density(file) * volume,
        centre=centre,
        inertia=density(file) * inertia,
        friction=FRICTION.get(file.material.lower(), _OTHER_FRICTION),
        bounds=np.asarray(surface.bounds),
    )


def density(file: ObjectFile) -> float:
    """Density of the object's material, kg/m^3: the file's own, else that of the table.

    Raises
    ------
    ObjectFolderError
        If neither knows the material.
    """
    stored = file.header.get("material_properties")
    if stored:
        return float(stored["density"])
    if file.material.lower() not in materials.MATERIALS:
        raise ObjectFolderError(
            f"{file.key}: its density is not known: the file stores none, and {file.material!r} is "
            f"none of {', '.join(materials.MATERIALS)}; import it again with --material"
        )
    return materials.material(file.material).density


def add_body(
    spec: mujoco.MjSpec, body: RigidBody, name: str = "object", parent: "mujoco.MjsBody | None" = None
) -> "mujoco.MjsBody":
    """Add an object to a MuJoCo model; its frame is the object frame.

    Parameters
    ----------
    spec : mujoco.MjSpec
    body : RigidBody
    name : str
        Of the body and its free joint; geoms and their meshes are ``<name>_hull0``, ...
    parent : mujoco.MjsBody, optional
        Default: the world, the only body whose children may have a free joint.
    """
    added = (parent or spec.worldbody).add_body(name=name)
    added.add_freejoint(name=name)
    added.explicitinertial = True
    added.mass, added.ipos = body.mass, body.centre
    added.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for k, hull in enumerate(body.hulls):
        part = f"{name}_hull{k}"
        spec.add_mesh(name=part, uservert=hull.vertices.ravel(), userface=hull.faces.ravel())
        added.add_geom(
            name=part,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=part,
            condim=4,
            friction=[body.friction, TORSIONAL, ROLLING],
        )
    return added


def _moments(file: ObjectFile, surface: trimesh.Trimesh) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre and inertia (3, 3) at density 1, metres."""
    if "solid" not in file.header:
        found = surface.mass_properties
        return float(found.volume), np.asarray(found.center_mass), np.asarray(found.inertia)
    solid, size = file.header["solid"], file.scale
    xx, yy, zz, xy, xz, yz = solid["inertia"]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    principal = np.linalg.eigvalsh(inertia)
    if not 0 < principal[0] <= principal[2] <= principal[:2].sum():
        raise ObjectFolderError(
            f"{file.key}: no body has the principal moments of inertia that the file tells, "
            f"{principal.tolist()}; build it again"
        )
    return solid["volume"] * size**3, size * np.array(solid["centre"]), size**5 * inertia


def _check_fit(key: str, bounds: np.ndarray, hulls: Sequence[trimesh.Trimesh]) -> None:
    """Raise unless hulls are about where the surface is: in its frame, at its size."""
    reach = np.array([[hull.bounds[0] for hull in hulls], [hull.bounds[1] for hull in hulls]])
    lowest, highest = reach[0].min(0), reach[1].max(0)
    size = (bounds[1] - bounds[0]).max()
    if np.abs([lowest - bounds[0], highest - bounds[1]]).max() > 0.1 * size:
        raise ObjectFolderError(
            f"{key}: its hulls reach from {lowest.round(4).tolist()} to {highest.round(4).tolist()}, the "
            f"surface from {bounds[0].round(4).tolist()} to {bounds[1].round(4).tolist()} m; they are of "
            "another object or frame: make them of this file's to_mesh()"
        )
