"""Where a glTF scene shows its meshes: nodes, copies, skins in their rest pose, and what is hidden."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.gltffile import INSTANCING, LOD, VISIBILITY, GltfFile
from objectfolder.mesh.reading.parts import MeshPart

ROUNDING = 1e-4  # of a quaternion's length in single precision, or few digits
OUTSIDE, COARSE = "mesh outside the default scene left out", "mesh of a lower level of detail left out"
INVISIBLE, FLAT = "invisible mesh left out", "mesh of scale 0 left out"
# Values of an application's own properties that hide a node or mesh; names without case, "_" and "is".
HIDING: dict[str, tuple[Any, ...]] = {
    "visible": (False, "false"),
    "visibility": (False, "false", "hidden"),
    **dict.fromkeys(("hidden", "hide", "invisible", "hiderender", "hideviewport"), (True, "true")),
}


@dataclass(frozen=True)
class Placed:
    """A mesh that a node shows."""

    mesh: int
    weights: tuple[float, ...]  #: of the mesh's morph targets
    transforms: list[np.ndarray]  #: (4, 4) from the mesh's frame to the scene's, one per copy
    joints: np.ndarray | None = None  #: (J, 4, 4) the same of each joint, if the node has a skin


@dataclass(frozen=True)
class Influences:
    """Joints that move vertices."""

    joints: np.ndarray  #: (V, K) int64
    weights: np.ndarray  #: (V, K) float64, of any sum


def place_meshes(file: GltfFile) -> tuple[list[Placed], list[str]]:
    """Return the meshes that the default scene shows, in document order, and notes.

    As the standard says, a skin's joints place its mesh, and the mesh's node does not.
    """
    document = file.document
    roots, notes = _choose_scene(document)
    worlds, hidden = _descend(file, roots)
    placed = []
    skins: dict[int, np.ndarray] = {}
    for index, world in worlds.items():
        node = document["nodes"][index]
        if "mesh" not in node:
            continue
        mesh = document["meshes"][node["mesh"]]
        reason = hidden[index] or (INVISIBLE if _hides(mesh) else "")
        if reason:
            file.left_out[reason] += 1
            continue
        if "skin" in node and node["skin"] not in skins:
            skins[node["skin"]] = _joints(file, node["skin"], worlds)
        joints = skins.get(node.get("skin"))
        copies = _copies(file, node, world)
        if joints is None:
            transforms = [copy for copy in copies if copy[:3, :3].any()]
        else:
            file.left_out["copies of a skinned mesh left out"] += len(copies) - 1
            copies = [world]
            transforms = copies if joints[:, :3, :3].any() else []
        file.left_out[FLAT] += len(copies) - len(transforms)
        weights = tuple(node.get("weights", mesh.get("weights", ())))
        if transforms:
            placed.append(Placed(node["mesh"], weights, transforms, joints))
    _note_rest(file)
    return placed, notes


def _note_rest(file: GltfFile) -> None:
    """Note what the document holds beside meshes."""
    document, nodes = file.document, file.document.get("nodes", [])
    unused = len(document.get("meshes", [])) - len({node["mesh"] for node in nodes if "mesh" in node})
    file.left_out["mesh of no node left out"] += unused
    file.left_out["animation left out"] += len(document.get("animations", []))
    file.left_out["camera left out"] += sum("camera" in node for node in nodes)
    parts = (document.get(name, []) for name in ("scenes", "nodes", "meshes"))
    for item in (document.get("asset", {}), *chain(*parts)):
        file.note_extensions(item)


def _choose_scene(document: dict[str, Any]) -> tuple[list[int], list[str]]:
    """Return the roots of the default scene, or all if the file has no scenes, and notes."""
    scenes = document.get("scenes")
    if not scenes:
        return _parentless(document), []
    unsaid = len(scenes) > 1 and "scene" not in document
    notes = [f"the file has {len(scenes)} scenes and no default: the first is read"] if unsaid else []
    return scenes[document.get("scene", 0)].get("nodes", []), notes


def _parentless(document: dict[str, Any]) -> list[int]:
    nodes = document.get("nodes", [])
    children = {child for node in nodes for child in node.get("children", [])}
    return [i for i in range(len(nodes)) if i not in children]


def _descend(file: GltfFile, roots: list[int]) -> tuple[dict[int, np.ndarray], dict[int, str]]:
    """Return transforms to the scene (4, 4) of all nodes, those of the scene first, and why they are hidden.

    The reason is empty for nodes that are not. Joints may lie outside the scene.
    """
    nodes = file.document.get("nodes", [])
    coarse = {i for node in nodes for i in node.get("extensions", {}).get(LOD, {}).get("ids", [])}
    others = [root for root in _parentless(file.document) if root not in set(roots)]
    worlds: dict[int, np.ndarray] = {}
    hidden: dict[int, str] = {}
    queue = [(root, np.eye(4), OUTSIDE) for root in reversed(others)]
    queue += [(root, np.eye(4), "") for root in reversed(roots)]
    while queue:
        index, parent, reason = queue.pop()
        if index in worlds:
            if reason == OUTSIDE:
                continue
            raise ObjectFolderError(
                f"{file.path}: node {index} has two parents, expected one; export it again"
            )
        node = nodes[index]
        worlds[index] = parent @ _transform(node)
        visible = node.get("extensions", {}).get(VISIBILITY, {}).get("visible", True) and not _hides(node)
        hidden[index] = COARSE if index in coarse else reason or ("" if visible else INVISIBLE)
        queue += [(child, worlds[index], hidden[index]) for child in reversed(node.get("children", []))]
    return worlds, hidden


def _hides(item: dict[str, Any]) -> bool:
    """Whether an application's own properties hide a node or mesh."""
    extras = item.get("extras")
    said = extras.items() if isinstance(extras, dict) else ()
    return any(
        (value.lower() if isinstance(value, str) else value)
        in HIDING.get(name.lower().replace("_", "").removeprefix("is"), ())
        for name, value in said
    )


def _joints(file: GltfFile, index: int, worlds: dict[int, np.ndarray]) -> np.ndarray:
    """Return the transforms (J, 4, 4) of a skin's joints from the frame of its mesh to the scene's."""
    skin = file.document["skins"][index]
    joints = np.stack([worlds[joint] for joint in skin["joints"]])
    if "inverseBindMatrices" not in skin:
        return joints
    inverse = file.accessor(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).transpose(0, 2, 1)
    if len(inverse) < len(joints):
        raise ObjectFolderError(
            f"{file.path}: skin {index} has {len(inverse)} inverse bind matrices for {len(joints)} joints; "
            "export it again"
        )
    return joints @ inverse[: len(joints)]


def _copies(file: GltfFile, node: dict[str, Any], world: np.ndarray) -> list[np.ndarray]:
    """Return the transforms (4, 4) of a node's mesh to the scene: its own, or those of its copies."""
    attributes = node.get("extensions", {}).get(INSTANCING, {}).get("attributes", {})
    widths = {name: 4 if name == "ROTATION" else 3 for name in ("TRANSLATION", "ROTATION", "SCALE")}
    names = [name for name in widths if name in attributes]
    columns = [file.accessor(attributes[name], widths[name]) for name in names]
    keys = [name.lower() for name in names]
    copies = (_transform(dict(zip(keys, row))) for row in zip(*columns, strict=True))
    return [world @ copy for copy in copies] if names else [world]


def move(part: MeshPart, transform: np.ndarray) -> MeshPart:
    """Place a part by a matrix (4, 4); one that mirrors reverses the orientation of faces."""
    linear = transform[:3, :3]
    return replace(
        part,
        vertices=part.vertices @ linear.T + transform[:3, 3],
        faces=part.faces[:, ::-1] if np.linalg.det(linear) < 0 else part.faces,
        normals=None if part.normals is None else part.normals @ _of_normals(linear).T,
    )


def bend(part: MeshPart, influences: Influences, joints: np.ndarray) -> MeshPart:
    """Place a part by joints (J, 4, 4): each vertex by the weighted mean of their matrices.

    As in other readers, a vertex without weights follows its first joint.
    """
    weights = influences.weights.copy()
    without = ~(weights.sum(1) > 0)
    weights[without] = np.eye(weights.shape[1])[0]
    weights /= weights.sum(1, keepdims=True)
    matrix = np.zeros((len(weights), 3, 4))
    for index, weight in zip(influences.joints.T, weights.T):
        used = weight != 0  # the index of others may be anything
        matrix[used] += weight[used, None, None] * joints[index[used], :3]
    linear = matrix[:, :, :3]
    mirrored = (np.linalg.det(linear) < 0)[part.faces].sum(1) > 1
    normals = None
    if part.normals is not None:
        normals = np.einsum("vij,vj->vi", _of_normals(linear), part.normals)
    return replace(
        part,
        vertices=np.einsum("vij,vj->vi", linear, part.vertices) + matrix[:, :, 3],
        faces=np.where(mirrored[:, None], part.faces[:, ::-1], part.faces),
        normals=normals,
    )


def _transform(node: dict[str, Any]) -> np.ndarray:
    """Return a node's matrix (4, 4), or its translation x rotation (quaternion x, y, z, w) x scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = _unit(node.get("rotation", (0, 0, 0, 1)))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _unit(rotation: Sequence[float]) -> Sequence[float]:
    """Return a quaternion of length 1; one that has it but for rounding stays as it is."""
    length = math.hypot(*rotation)
    return rotation if abs(length - 1) < ROUNDING or not length else [part / length for part in rotation]


def _of_normals(linear: np.ndarray) -> np.ndarray:
    """Return the matrices (..., 3, 3) that transform normals, up to length, as ``linear`` does vertices.

    Each is the inverse transpose times the absolute determinant, from cofactors that also exist if singular.
    """
    x, y, z = np.moveaxis(linear, -2, 0)
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], -2)
    return np.where(np.linalg.det(linear)[..., None, None] >= 0, cofactors, -cofactors)
