"""Export to glTF: look, rigid body and sound of an object in one file.

Rigid bodies follow KHR_physics_rigid_bodies, draft of 29 October 2025 (eoineoineoin/glTF_Physics ac5c413),
and sounds KHR_audio_rigid_bodies, draft of 16 August 2026 (khiner/MeshEditor 806d6e3). Neither is ratified.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from objectfolder.mesh.srgb import decode
from objectfolder.mesh.textured import complete_document, y_up
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import RigidBody
from objectfolder.sim.export import OwnHulls, PhysicsModel, export_folder
from objectfolder.sim.hulls import MAX_HULLS
from objectfolder.sim.visual import GREY, ROUGHNESS, texture_image
from objectfolder.sound.gains_net import energy_weights

PHYSICS, AUDIO = "KHR_physics_rigid_bodies", "KHR_audio_rigid_bodies"
SAMPLES = 1000  #: most points at which mode shapes are stored
_LINEAR = 9729  # without mipmaps, which would mix the rectangles of faces
_CLAMPED, _REPEATING = 33071, 10497  # beyond the edge of a texture
_GROWTH = 1.15  # of the cells of the sample surface, until it has few enough points
_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_COMPONENTS = {"<f4": 5126, "<u4": 5125}
_TYPES = {1: "SCALAR", 3: "VEC3"}


def write_glb(file: ObjectFile, out: str | Path, max_hulls: int = MAX_HULLS, hulls: OwnHulls = None) -> Path:
    """Write ``OUT/<key>/<key>.glb``, y up: textured surface, mass, convex hulls and vibration modes.

    A file without modes gets no sound. Modes are in descending order of their mean energy, so that the first
    ones matter most; their shapes are stored at up to `SAMPLES` points of a triangulated surface.
    Otherwise as `objectfolder.sim.export.write_mjcf`.
    """
    with export_folder(file, out, max_hulls, hulls) as (new, model):
        fill_glb(new, model)
    return Path(out) / file.key / f"{file.key}.glb"


def fill_glb(folder: Path, model: PhysicsModel) -> None:
    """Write what `write_glb` does into a folder, which may hold other formats of the same object."""
    file, body = model.file, model.body
    document, buffer = unpack_glb(_meshes(model))
    if textures := document.get("textures"):  # of the surface alone
        uv = getattr(model.look.visual, "uv", np.zeros(1))  # a textured mesh has them
        wrap = _CLAMPED if uv.min() >= 0 and uv.max() <= 1 else _REPEATING
        sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": wrap, "wrapT": wrap}
        textures[0]["sampler"], document["samplers"] = 0, [sampler]
    node = _add_body(document, body)
    if model.facts:
        node["extras"] = dict(model.facts)
    if "audio" in file.header and file.has_modes and len(file.frequencies):
        node["extensions"][AUDIO] = {"modalModel": 0}
        document["extensionsUsed"].append(AUDIO)
        document["extensions"][AUDIO] = _modal_model(document, buffer, file, body)
    (folder / f"{file.key}.glb").write_bytes(pack_glb(document, buffer))


def _meshes(model: PhysicsModel) -> bytes:
    """Return a binary glTF with the visual mesh and the hulls."""
    look, body = model.look, model.body
    texture, grey = texture_image(look), float(decode(np.float64(GREY)))  # factors are linear
    color = [grey] * 3 + [1.0] if texture is None else None
    surface = trimesh.visual.material.PBRMaterial(
        baseColorFactor=color, baseColorTexture=texture, roughnessFactor=ROUGHNESS, metallicFactor=0.0
    )
    drawn = trimesh.Trimesh(
        y_up(look.vertices), look.faces, vertex_normals=y_up(np.asarray(look.vertex_normals)),
        visual=trimesh.visual.TextureVisuals(uv=getattr(look.visual, "uv", None), material=surface),
        process=False,
    )  # fmt: skip
    scene = trimesh.Scene()
    scene.add_geometry(drawn, geom_name="visual")
    for k, hull in enumerate(body.hulls):
        shape = trimesh.Trimesh(y_up(hull.vertices), hull.faces, process=False)
        scene.add_geometry(shape, geom_name=f"hull{k:02d}")
    return bytes(scene.export(file_type="glb", tree_postprocessor=complete_document))


def _add_body(document: dict[str, Any], body: RigidBody) -> dict[str, Any]:
    """Replace the nodes by a body with its colliders; return its node."""
    numbers = {mesh["name"]: i for i, mesh in enumerate(document["meshes"])}
    count = len(body.hulls)
    names = [f"hull{k:02d}" for k in range(count)]
    motion = {PHYSICS: {"motion": describe_motion(body)}}
    children = list(range(1, count + 1))
    node = {"name": body.key, "mesh": numbers["visual"], "children": children, "extensions": motion}
    document["nodes"] = [node]
    for k, name in enumerate(names):
        collider = {"geometry": {"node": count + 1 + k, "convexHull": True}, "physicsMaterial": 0}
        extensions = {PHYSICS: {"collider": collider}}
        document["nodes"].append({"name": f"{name}_collider", "extensions": extensions})
    # Shapes are nodes of no scene, so that nobody draws them.
    document["nodes"] += [{"name": name, "mesh": numbers[name]} for name in names]
    document["scenes"], document["scene"] = [{"nodes": [0]}], 0
    document["extensionsUsed"] = [PHYSICS]
    friction = {"staticFriction": body.friction, "dynamicFriction": body.friction}
    document["extensions"] = {PHYSICS: {"physicsMaterials": [friction]}}
    return node


def describe_motion(body: RigidBody) -> dict[str, Any]:
    """Return mass, centre of mass and inertia as both extensions describe them, y up."""
    moments, axes = body.principal(y_up(np.eye(3)).T)  # turned from z up to y up
    return {
        "mass": body.mass, "centerOfMass": y_up(body.centre[None])[0].tolist(),
        "inertiaDiagonal": moments.tolist(), "inertiaOrientation": axes.as_quat().tolist(),
    }  # fmt: skip


def _modal_model(
    document: dict[str, Any], buffer: bytearray, file: ObjectFile, body: RigidBody
) -> dict[str, Any]:
    """Store modes and their shapes, and return the document's extension."""
    tuning, (points, faces) = file.tuning(), sample_modes(file)
    damped, damping = tuning.damped_frequency.numpy(), tuning.damping.numpy()
    shapes = file.mode_shapes(points)
    energy = np.square(shapes).mean((0, 1)) * energy_weights(damped, damping)
    order = np.argsort(-energy, kind="stable")
    displaced = shapes[..., order].transpose(2, 0, 1).reshape(-1, 3)  # mode by mode
    arrays = {"frequencies": damped[order] / (2 * np.pi), "decayRates": damping[order]}
    arrays |= {"positions": y_up(points), "shapes": y_up(displaced)}
    whole: dict[str, Any] = {"name": file.key}
    for name, values in arrays.items():
        whole[name] = add_accessor(document, buffer, values.astype(np.float32))
    whole["indices"] = add_accessor(document, buffer, faces.reshape(-1).astype(np.uint32))
    whole["massProperties"] = describe_motion(body)
    found: dict[str, Any] = {"modalModels": [whole]}
    stored = file.header.get("material_properties")
    if stored:
        material = {"name": file.material, "density": stored["density"]}
        material |= {"youngsModulus": stored["youngs_modulus"], "poissonRatio": stored["poisson_ratio"]}
        if not stored.get("loss_factor"):  # the draft knows no other law
            material |= {"alpha": stored["alpha"], "beta": stored["beta"]}
        found["acousticMaterials"] = [material]
        whole["material"] = 0
    return found


def sample_modes(file: ObjectFile) -> tuple[np.ndarray, np.ndarray]:
    """Return points (P, 3) of the stored surface about evenly apart, metres, and triangles (F, 3) of them.

    Vertices in one cell of a grid that face the same octant become one of them, so that the two sides of a
    thin wall stay apart.
    """
    surface = file.surface
    octant = ((surface.normals > 0) @ [1, 2, 4])[:, None]
    cell = 1 / 64
    while True:
        key = np.hstack([np.floor(surface.vertices / cell).astype(np.int64), octant])
        _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        if len(first) <= SAMPLES:
            break
        cell *= _GROWTH
    group = group.reshape(-1)
    count = np.bincount(group)[:, None]
    centre = np.stack([np.bincount(group, axis) for axis in surface.vertices.T], 1) / count
    away = np.linalg.norm(surface.vertices - centre[group], axis=1)
    chosen = np.lexsort((away, group))[np.cumsum(count[:, 0]) - count[:, 0]]  # the nearest to the centre
    faces = group[surface.faces]
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return surface.vertices[chosen] * file.scale, faces[first]


def unpack_glb(content: bytes) -> tuple[dict[str, Any], bytearray]:
    """Return the document and the buffer of a binary glTF."""
    length = struct.unpack_from("<3I", content)[2]
    place, chunks = 12, {}
    while place < length:
        size, kind = struct.unpack_from("<2I", content, place)
        chunks[kind] = content[place + 8 : place + 8 + size]
        place += 8 + size
    return json.loads(chunks[_JSON]), bytearray(chunks[_BIN])


def pack_glb(document: dict[str, Any], buffer: bytearray) -> bytes:
    """Return a binary glTF of a document and its buffer."""
    document["buffers"] = [{"byteLength": len(buffer)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    out = b""
    for content, fill, kind in ((text, b" ", _JSON), (bytes(buffer), b"\0", _BIN)):
        padded = content + fill * (-len(content) % 4)
        out += struct.pack("<2I", len(padded), kind) + padded
    return struct.pack("<3I", _MAGIC, _VERSION, 12 + len(out)) + out


def add_accessor(document: dict[str, Any], buffer: bytearray, values: np.ndarray) -> int:
    """Add an array (N,) or (N, 3), float32 or uint32, to the buffer; return the index of its accessor."""
    values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    buffer.extend(b"\0" * (-len(buffer) % 4))
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(buffer), "byteLength": values.nbytes})
    buffer.extend(values.tobytes())
    rows, kind = values.reshape(len(values), -1), _COMPONENTS[values.dtype.str]
    view = len(document["bufferViews"]) - 1
    accessor: dict[str, Any] = {"bufferView": view, "componentType": kind, "count": len(values)}
    accessor |= {"type": _TYPES[rows.shape[1]], "min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
    document["accessors"].append(accessor)
    return len(document["accessors"]) - 1
