"""Objects of a MuJoCo model that can be heard or felt: which bodies they are, checked against their files."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import scipy.linalg

from objectfolder.base.checks import finite_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.base.materials import Material, material
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.voice import Voice
from objectfolder.sim.body import body_density, density, rotation, solid_moments
from objectfolder.sound.tuning import HEARING_HZ

#: Half sides of the boxes of simple geoms, by their sizes.
_HALVES: dict[int, Callable[[float, float, float], tuple[float, float, float]]] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): lambda r, *_: (r, r, r),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): lambda r, h, _: (r, r, r + h),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): lambda r, h, _: (r, r, h),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): lambda x, y, z: (x, y, z),
    int(mujoco.mjtGeom.mjGEOM_BOX): lambda x, y, z: (x, y, z),
}
#: Relative differences of mass, size and moments of inertia at which a body is another one.
_MASS, _SIZE, _INERTIA = 0.1, 0.15, 0.3


@dataclass(frozen=True)
class Sounding:
    """An Object File whose body in the scene has another material or size."""

    file: ObjectFile
    material: str | Material | None = None  #: default: the object's own
    scale: float | None = None  #: longest side, m; default: the object's own

    def __post_init__(self) -> None:
        if not isinstance(self.file, ObjectFile):
            raise ObjectFolderError(
                f"the file of a Sounding is of type {type(self.file).__name__}, expected an ObjectFile"
            )
        if not isinstance(self.material, Material | None):
            material(self.material)
        if self.scale is not None and finite_number("scale", self.scale) <= 0:
            raise ObjectFolderError(f"scale is {self.scale} m, expected the longest side, above 0")

    @property
    def friction(self) -> float:
        """Coefficient of dry sliding friction of the body's material."""
        given = material(self.material) if isinstance(self.material, str) else self.material
        return self.file.friction if given is None else given.friction


Objects = Mapping[str, ObjectFile | Sounding] | Iterable[ObjectFile]


def name_objects(objects: Objects) -> dict[str, Sounding]:
    """Return objects by the names of their bodies; without names, these are their keys.

    Raises ObjectFolderError if there are none, one is no ObjectFile or Sounding, two have one key, or a name
    is no text.
    """
    if isinstance(objects, ObjectFile):
        objects = [objects]
    if isinstance(objects, str) or not isinstance(objects, Iterable):
        raise ObjectFolderError(
            f"objects is {quoted(objects)}, expected Object Files, or a mapping from names of bodies to them"
        )
    items = [*objects.items()] if isinstance(objects, Mapping) else [
        (getattr(one, "key", str(one)), one) for one in objects
    ]  # fmt: skip
    if not items:
        raise ObjectFolderError("objects is empty: expected the Object Files of bodies of the scene")
    found: dict[str, Sounding] = {}
    for name, one in items:
        if name in found:
            raise ObjectFolderError(
                f"objects: two have the key {name!r}; give a mapping from the names of their bodies"
            )
        if not isinstance(name, str):
            raise ObjectFolderError(f"objects: {quoted(name)} is not the name of a body, expected a text")
        if not isinstance(one, ObjectFile | Sounding):
            raise ObjectFolderError(
                f"objects: {quoted(name)} is of type {type(one).__name__}, expected an ObjectFile or "
                "a Sounding"
            )
        found[name] = one if isinstance(one, Sounding) else Sounding(one)
    return found


def find_bodies(model: mujoco.MjModel, objects: Objects) -> list[tuple[int, str, Sounding]]:
    """Return the numbers of the bodies of objects, their names, and the objects.

    Raises ObjectFolderError as `name_objects` and `body_number`, or if two objects have one body.
    """
    found: dict[int, tuple[int, str, Sounding]] = {}
    for name, one in name_objects(objects).items():
        number = body_number(model, name)
        if number in found:
            raise ObjectFolderError(
                f"objects: {found[number][1]!r} and {name!r} are both body {model.body(number).name!r}; give "
                "one object for each body"
            )
        found[number] = number, name, one
    return [*found.values()]


def body_number(model: mujoco.MjModel, name: str) -> int:
    """Return the number of the body of an object: of this name, or the only one of a name that ends in /name.

    Models that MuJoCo attaches have such names, if the prefix ends with a slash. Raises ObjectFolderError if
    the scene has none.
    """
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if number < 1:
        names = [model.body(i).name for i in range(1, model.nbody)]
        attached = [i for i, other in enumerate(names, 1) if other.endswith(f"/{name}")]
        if len(attached) == 1:
            return attached[0]
        raise ObjectFolderError(
            f"the scene has no body {name!r}, but {quoted(names)}; name the object's body by its key, as "
            "`objectfolder export mjcf` does, or give a mapping from names of bodies to Object Files"
        )
    return number


def site_number(model: mujoco.MjModel, name: str, argument: str) -> int:
    """Return the number of a site, or raise ObjectFolderError that names the argument."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if number < 0:
        names = [model.site(i).name for i in range(model.nsite)]
        raise ObjectFolderError(f"{argument}: the scene has no site {name!r}, but {quoted(names)}")
    return number


def require_audible(
    files: Sequence[ObjectFile], materials: Sequence[str], ratio: float, sample_rate: float
) -> None:
    """Raise ObjectFolderError unless each object has a mode that is heard, in each material.

    ``ratio`` is that of the smallest object, whose modes are the highest, to the size that its file says.
    """
    limit = min(sample_rate / 2, HEARING_HZ[1])
    for file in files:
        for name in materials:
            scale = ratio * file.scale
            lowest = float(min(file.tuning(name, scale).frequencies, default=math.inf))
            if lowest >= limit:
                found = f"at {lowest:.0f} Hz" if lowest < math.inf else "above hearing"
                raise ObjectFolderError(
                    f"{file.key} of {name} and {scale:.3g} m has its lowest mode {found}, not below "
                    f"{limit:.0f} Hz, and would only click: leave out the material or the object, or raise "
                    "the sample rate"
                )


def check_body(model: mujoco.MjModel, name: str, one: Sounding, voice: Voice) -> None:
    """Raise ObjectFolderError if a body is not of the mass, inertia and size that its object says."""
    body = body_number(model, name)
    advice = (
        "give Sounding(file, material=..., scale=...) with what the body is, or add the object again with "
        "`objectfolder.sim.body.add_body`"
    )
    mass = float(model.body_mass[body])
    # A real object that was weighed is as full of another material, and in another size, as of its own.
    fill = body_density(one.file) / density(one.file) if "mass" in one.file.header else 1.0
    if abs(mass / (fill * voice.mass) - 1) > _MASS:
        raise ObjectFolderError(
            f"body {name!r} weighs {mass:.4g} kg in the scene, but {one.file.key} of {voice.material.name} "
            f"and {voice.scale:.4g} m weighs {fill * voice.mass:.4g} kg; {advice}"
        )
    if "solid" in one.file.header:  # since format 1.1
        ratio = voice.scale / one.file.scale
        expected = fill * voice.material.density * ratio**5 * solid_moments(one.file)[2]
        axes = rotation(model.body_iquat[body])
        found = axes * model.body_inertia[body] @ axes.T
        times = scipy.linalg.eigvalsh(found, expected)  # of the object's own, about the axes that differ most
        if times[-1] > 1 + _INERTIA or times[0] < 1 / (1 + _INERTIA):
            raise ObjectFolderError(
                f"body {name!r} has {times[0]:.3g} to {times[-1]:.3g} times the moments of inertia of "
                f"{one.file.key} of {voice.material.name} and {voice.scale:.4g} m in the scene; do without "
                "settings of the compiler that change them, such as boundinertia, inertiafromgeom or "
                f"alignfree, or {advice}"
            )
    check_extent(model, name, one.file, voice.scale, advice)


def check_extent(model: mujoco.MjModel, name: str, file: ObjectFile, scale: float, advice: str) -> None:
    """Raise ObjectFolderError, with advice, if a body is not of the size of an object of this scale, m."""
    reach = _extent(model, body_number(model, name))
    if reach is None:
        return
    expected = file.bounds * (scale / file.scale)
    if abs(reach - expected).max() > _SIZE * scale:
        raise ObjectFolderError(
            f"the geoms of body {name!r} reach from {reach[0].round(4).tolist()} to "
            f"{reach[1].round(4).tolist()} m, but {file.key} of {scale:.4g} m from "
            f"{expected[0].round(4).tolist()} to {expected[1].round(4).tolist()}; {advice}"
        )


def _extent(model: mujoco.MjModel, body: int) -> np.ndarray | None:
    """Return lowest and highest coordinates (2, 3) of a body's geoms that collide; body frame."""
    corners = []
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    start = model.body_geomadr[body]
    for geom in range(start, start + model.body_geomnum[body]):
        if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            continue
        mesh, box, kind = model.geom_dataid[geom], model.geom_aabb[geom], int(model.geom_type[geom])
        if kind == mujoco.mjtGeom.mjGEOM_MESH:  # turned to its principal axes
            first = model.mesh_vertadr[mesh]
            points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        elif kind in _HALVES:  # their boxes are those with which they were compiled
            points = signs * _HALVES[kind](*model.geom_size[geom])
        else:
            points = box[:3] + signs * box[3:]
        corners.append(points @ rotation(model.geom_quat[geom]).T + model.geom_pos[geom])
    if not corners:
        return None
    points = np.concatenate(corners)
    return np.array([points.min(0), points.max(0)])
