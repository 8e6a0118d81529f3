"""Export to physics engines: folders with MJCF (MuJoCo) or URDF (PyBullet, MuJoCo and others)."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as xml

import mujoco
import numpy as np
import trimesh
from trimesh.exchange.obj import export_obj

from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.base.io import write_text
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import ROLLING, TORSIONAL, RigidBody, add_body, body_density, rigid_body
from objectfolder.sim.hulls import MAX_HULLS, convex_hulls
from objectfolder.sim.visual import GREY, visual_mesh

OwnHulls = Sequence[trimesh.Trimesh] | None  #: hulls of an object; None: computed
_VISUAL, _COLLISION = 2, 3  # groups of geoms; MuJoCo's viewer shows only the first
NEEDED = 8 * 2**20  #: approximate size of a folder with mesh and texture, bytes


@dataclass(frozen=True)
class PhysicsModel:
    """What files for physics engines are made from."""

    file: ObjectFile
    body: RigidBody
    look: trimesh.Trimesh  #: textured surface; object frame, metres
    #: Stated in each file, such as where the mass is from.
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def density(self) -> float:
        """Mean density of the solid, kg/m^3."""
        return body_density(self.file)


def write_mjcf(file: ObjectFile, out: str | Path, max_hulls: int = MAX_HULLS, hulls: OwnHulls = None) -> Path:
    """Write a folder that MuJoCo loads: ``mujoco.MjModel.from_xml_path("OUT/<key>/<key>.xml")``.

    The body, named after the object, has a free joint and the mass and inertia of `rigid_body`. Hulls collide
    (group 3); the textured surface is visual only (group 2).

    Parameters
    ----------
    file : ObjectFile
    out : path
        Parent of the new folder, which is named after the object.
    max_hulls : int
    hulls : sequence of trimesh.Trimesh, optional
        Default: computed, which takes up to half a minute.

    Returns
    -------
    Path
        Of the XML file.

    Raises
    ------
    ObjectFolderError
        If the folder exists already, the file holds no geometry, or an extra is not installed.
    """
    with export_folder(file, out, max_hulls, hulls) as (new, model):
        fill_mjcf(new, model)
    return Path(out) / file.key / f"{file.key}.xml"


def write_urdf(file: ObjectFile, out: str | Path, max_hulls: int = MAX_HULLS, hulls: OwnHulls = None) -> Path:
    """Write a folder with a URDF of one link; otherwise as `write_mjcf`.

    PyBullet reads the inertia only on request:
    ``loadURDF("OUT/<key>/<key>.urdf", flags=URDF_USE_INERTIA_FROM_FILE)``. Friction is an extension of
    PyBullet that others ignore. MuJoCo welds the link to the world: URDF has no free joints.

    Returns
    -------
    Path
        Of the URDF file.
    """
    with export_folder(file, out, max_hulls, hulls) as (new, model):
        fill_urdf(new, model)
    return Path(out) / file.key / f"{file.key}.urdf"


def fill_mjcf(folder: Path, model: PhysicsModel) -> None:
    """Write what `write_mjcf` does into a folder, which may hold other formats of the same object."""
    textured = _write_meshes(folder, model)
    write_text(folder / f"{model.body.key}.xml", _mjcf(folder, model, textured))


def fill_urdf(folder: Path, model: PhysicsModel) -> None:
    """Write what `write_urdf` does into a folder, which may hold other formats of the same object."""
    textured = _write_meshes(folder, model)
    write_text(folder / f"{model.body.key}.urdf", _urdf(model.body, textured, model.facts))


def _write_meshes(folder: Path, model: PhysicsModel) -> bool:
    """Write the hulls and visual.obj with its texture, if any; return whether there is a texture.

    Another format may have written them before.
    """
    if (folder / "visual.obj").exists():
        return (folder / "visual.png").exists()
    for k, hull in enumerate(model.body.hulls):
        write_text(folder / _hull_name(k), export_obj(hull, include_normals=False, header=None))
    options = {"include_normals": True, "return_texture": True, "mtl_name": "visual.mtl", "header": None}
    text, more = export_obj(model.look, **options)
    write_text(folder / "visual.obj", text)
    for name, content in more.items():
        (folder / name).write_bytes(content)
    return "visual.png" in more


def _hull_name(k: int) -> str:
    return f"hull{k:02d}.obj"


def _mjcf(folder: Path, model: PhysicsModel, textured: bool) -> str:
    """Return the model of one body, compiled once so that no model is written that MuJoCo refuses."""
    body = model.body
    spec = mujoco.MjSpec()
    spec.modelname = body.key
    for name, fact in model.facts.items():
        spec.add_text(name=f"{body.key}_{name}", data=fact)
    spec.assets = {path.name: path.read_bytes() for path in folder.iterdir()}
    added = add_body(spec, body, body.key)
    for k, (mesh, geom) in enumerate(zip(spec.meshes, added.geoms)):
        mesh.uservert, mesh.userface, mesh.file = [], [], _hull_name(k)
        geom.group, geom.density = _COLLISION, model.density
    name = f"{body.key}_look"  # unlike those of other objects in a scene
    look = spec.add_material(name=name, rgba=[1, 1, 1, 1] if textured else [GREY] * 3 + [1])
    if textured:
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file="visual.png")
        look.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    visual = f"{body.key}_visual"
    spec.add_mesh(name=visual, file="visual.obj", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    alone = {"contype": 0, "conaffinity": 0, "density": 0, "group": _VISUAL}
    added.add_geom(name=visual, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=visual, material=name, **alone)
    try:
        spec.compile()
    except ValueError as error:  # such as of an object that is too small
        raise ObjectFolderError(f"{body.key}: MuJoCo refuses the model: {shortened(error)}") from error
    return spec.to_xml()


def _urdf(body: RigidBody, textured: bool, facts: Mapping[str, str]) -> str:
    """Return the robot with one link; facts are comments, as URDF has no place for them."""
    robot = xml.Element("robot", name=body.key)
    for name, fact in facts.items():
        robot.append(xml.Comment(f" {name}: {fact.replace('--', '- -')} "))
    compiler = {"fusestatic": "false", "discardvisual": "false", "balanceinertia": "false"}
    xml.SubElement(xml.SubElement(robot, "mujoco"), "compiler", compiler)
    link = xml.SubElement(robot, "link", name=body.key)
    contact = xml.SubElement(link, "contact")
    frictions = {"lateral": body.friction, "spinning": TORSIONAL, "rolling": ROLLING}
    for name, value in frictions.items():
        xml.SubElement(contact, f"{name}_friction", value=_numbers(value))
    inertial = xml.SubElement(link, "inertial")
    xml.SubElement(inertial, "origin", xyz=_numbers(*body.centre), rpy="0 0 0")
    xml.SubElement(inertial, "mass", value=_numbers(body.mass))
    axes = {f"i{'xyz'[i]}{'xyz'[j]}": _numbers(body.inertia[i, j]) for i in range(3) for j in range(i, 3)}
    xml.SubElement(inertial, "inertia", axes)
    names = {"visual": ["visual.obj"], "collision": [_hull_name(k) for k in range(len(body.hulls))]}
    for kind, files in names.items():
        for name in files:
            part = xml.SubElement(link, kind, name=Path(name).stem)
            xml.SubElement(part, "origin", xyz="0 0 0", rpy="0 0 0")
            xml.SubElement(xml.SubElement(part, "geometry"), "mesh", filename=name, scale="1 1 1")
            if kind == "visual" and not textured:
                grey = xml.SubElement(part, "material", name="plain")
                xml.SubElement(grey, "color", rgba=_numbers(GREY, GREY, GREY, 1))
    xml.indent(robot)
    return xml.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _numbers(*values: float | np.floating) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


@contextmanager
def export_folder(
    file: ObjectFile, out: str | Path, max_hulls: int, hulls: OwnHulls
) -> Iterator[tuple[Path, PhysicsModel]]:
    """Give a folder to fill, which becomes ``OUT/<key>`` if all goes well, and what to fill it with.

    Hulls are computed if none are given. Raises ObjectFolderError if the folder exists already, the file
    holds no geometry, or an extra is not installed.
    """
    with new_folder(f"{file.key}: export", Path(out) / file.key, NEEDED, "") as new:
        body = rigid_body(file, convex_hulls(file.to_mesh(), max_hulls) if hulls is None else hulls)
        yield new, PhysicsModel(file, body, visual_mesh(file))
