"""Taxels on a sensor's gel for MuJoCo's own tactile sensor.

MuJoCo's sensor ``tactile`` reads, at every vertex of a mesh, how deep the geoms in contact with the mesh's
body reach past it, and how fast they slide. It knows no gel; `ObjectFile.touch` gives images of one.
"""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from objectfolder.base.checks import whole_number
from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.sim.state import REMEDY
from objectfolder.touch.camera import gel_depth
from objectfolder.touch.profiles import SensorProfile, load_profile

ROWS, COLUMNS = 16, 12  #: default taxels of a pad: 192
CHANNELS = 3  #: depth, and speed of sliding along the two tangents of the gel
_MESH, _TACTILE = mujoco.mjtGeom.mjGEOM_MESH, int(mujoco.mjtSensor.mjSENS_TACTILE)


def taxel_mesh(
    profile: str | Path | SensorProfile, rows: int = ROWS, columns: int = COLUMNS
) -> trimesh.Trimesh:
    """Return the undeformed gel of a sensor with a vertex at the centre of each taxel.

    There are at least 2 rows along the height of the sensor's image and 2 columns along its width. Vertices
    are in the order of the image: row 0 is its top, column 0 its left. Pad frame, metres: origin at the gel's
    apex, +x out of the gel, +y left and +z up in the image.
    """
    profile = load_profile(profile)
    rows, columns = whole_number("taxels: rows", rows, 2), whole_number("taxels: columns", columns, 2)
    vertical, horizontal = profile.half_extent
    z = (1 - (np.arange(rows) + 0.5) * 2 / rows) * vertical
    y = (1 - (np.arange(columns) + 0.5) * 2 / columns) * horizontal
    rays = np.stack([np.ones((rows, columns)), *np.broadcast_arrays(y, z[:, None])], axis=-1)
    points = rays * gel_depth(profile, rays)[..., None]
    points[..., 0] -= profile.camera_to_gel
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([b, d, c], -1)]).reshape(-1, 3)
    mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
    if mesh.face_normals[:, 0].mean() < 0:
        mesh.invert()
    return mesh


def add_taxels(
    spec: mujoco.MjSpec, body: str, profile: str | Path | SensorProfile, rows: int = ROWS,
    columns: int = COLUMNS, pos: Sequence[float] = (0.0, 0.0, 0.0),
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0), name: str = "taxels",
) -> None:  # fmt: skip
    """Add taxels to a body of a model, with a sensor that reads them.

    The taxels collide with nothing: what touches them has to touch another geom of the body, such as a box or
    a dome behind them. Meshes that collide get the distance field that the sensor needs; a file of MJCF
    cannot say so, hence ``spec`` has to be compiled, or saved with ``mujoco.mj_saveModel``.

    Parameters
    ----------
    spec : mujoco.MjSpec
        With all objects that the taxels may touch, such as those of `objectfolder.sim.body.add_body`.
    body : str
        Of the finger.
    profile : str, Path or SensorProfile
        Gives the shape of the gel.
    rows, columns : int
        As in `taxel_mesh`.
    pos : (3,) sequence of float
        Of the gel's apex, in the frame of the body, metres.
    quat : (4,) sequence of float
        From the pad frame of `taxel_mesh` to that of the body; w first.
    name : str
        Of mesh, geom and sensor.

    Raises
    ------
    ObjectFolderError
        If there is no such body or sensor, or the name is taken.
    """
    found = spec.body(body)
    if found is None:
        known = ", ".join(each.name for each in spec.bodies if each.name)
        raise ObjectFolderError(f"taxels: the model has no body {body!r}; expected one of {known}")
    if any(each.name == name for each in (*spec.meshes, *spec.geoms, *spec.sensors)):
        raise ObjectFolderError(f"taxels: the model has a {name!r} already; give another name")
    mesh = taxel_mesh(profile, rows, columns)
    outward = np.asarray(mesh.vertex_normals)
    right = np.cross(outward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    # Without two tangents after each normal, the sensor reads no speeds.
    frames = np.stack([outward, right, np.cross(right, outward)], axis=1)
    plain = mujoco.MjSpec().default  # MuJoCo's own, instead of the scene's
    arrays = {"uservert": mesh.vertices, "userface": mesh.faces, "usernormal": frames}
    flat = {key: values.ravel() for key, values in arrays.items()}
    spec.add_mesh(plain, name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL, **flat)
    alone = {"contype": 0, "conaffinity": 0, "density": 0, "group": 3}
    found.add_geom(plain, name=name, type=_MESH, meshname=name, pos=pos, quat=quat, **alone)
    kinds = {"objtype": mujoco.mjtObj.mjOBJ_MESH, "reftype": mujoco.mjtObj.mjOBJ_GEOM}
    spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TACTILE, objname=name, refname=name, **kinds)
    collide = (each for each in spec.geoms if each.contype or each.conaffinity)
    touched = {each.meshname for each in collide if each.type == _MESH}
    for each in spec.meshes:
        each.needsdf = int(each.needsdf or each.name in touched)


def read_taxels(model: mujoco.MjModel, data: mujoco.MjData, name: str = "taxels") -> np.ndarray:
    """Return what the taxels of `add_taxels` read; (3, rows, columns) float64.

    Depth past each taxel, metres, zero without a contact; and the speeds of sliding along the gel, towards
    image right and up, without sign, m/s.

    Parameters
    ----------
    model : mujoco.MjModel
    data : mujoco.MjData
    name : str
        Of the sensor.

    Raises
    ------
    ObjectFolderError
        If the model has no such taxels, the data are of another model, or a reading is not finite.
    """
    if not isinstance(data, mujoco.MjData) or data.model.nsensordata != model.nsensordata:
        raise ObjectFolderError(f"data is {quoted(data)}, expected the mujoco.MjData of the model")
    sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    if sensor < 0 or model.sensor_type[sensor] != _TACTILE:
        known = [model.sensor(i).name for i in np.flatnonzero(model.sensor_type == _TACTILE)]
        raise ObjectFolderError(f"the model has no taxels {name!r}, but {quoted(known)}")
    # The first triangle of `taxel_mesh` is of taxels 0 and 1, and the first one of the second row.
    columns = int(model.mesh_face[model.mesh_faceadr[model.sensor_objid[sensor]]].max())
    start = model.sensor_adr[sensor]
    values: np.ndarray = data.sensordata[start : start + model.sensor_dim[sensor]]
    if not np.isfinite(values).all():
        raise ObjectFolderError(
            f"taxels {name!r} read numbers that are not finite at {data.time:g} s; {REMEDY}"
        )
    return values.reshape(CHANNELS, -1, columns).copy()
