"""Compare how the meshes of a folder are read with independent readers: faces, bounds and colours.

`python perf/read_corpus.py FOLDER [--match '*.gl*'] [--notes]` loads every mesh below a folder. The other
readers are trimesh, and for glTF also plain loops of this script, which know skins, morph targets and hidden
nodes. Prints a line per difference and per refused file. Exits with 1 if the loops differ, or a reader raises
anything but an error in words.
"""

import argparse
import base64
import io
import json
import math
import struct
import sys
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
import trimesh
from harness import parsed
from PIL import Image
from scipy.spatial import cKDTree

from objectfolder.base.errors import ObjectFolderError
from objectfolder.cli.console import print_line
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.load import FORMATS, default_up, load_mesh
from objectfolder.mesh.textured import TexturedMesh, y_up

NEAR = 1e-4  # of the size: bounds, and middles of the same face
LEVELS, SHARE = 12, 0.05  # sRGB levels by which colours of this share of the faces may differ: baking
MAX_FACES = 40_000  # whose colours are compared; more are sampled


@dataclass
class Soup:
    """Triangles with a linear base colour in the middle of each, NaN where it has none."""

    triangles: np.ndarray  #: (F, 3, 3), in the file's frame
    colors: np.ndarray  #: (F, 3)


def main() -> None:
    """Compare all meshes of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--match", default="*", help="of the files' names")
    parser.add_argument("--notes", action="store_true", help="print the notes of each mesh too")
    options = parsed(parser)
    warnings.simplefilter("ignore")
    counts: Counter[str] = Counter()
    paths = [p for p in sorted(options.folder.rglob(options.match)) if p.suffix.lower() in FORMATS]
    for path in paths:
        name = path.relative_to(options.folder)
        try:
            mesh = load_mesh(path, default_up(path), texture_size=4096)
        except ObjectFolderError as error:
            counts["refused"] += 1
            print_line(f"{name}: refused: {str(error).replace(str(path), '')}")
            continue
        except Exception as error:
            counts["failed"] += 1
            print_line(f"{name}: failed: {error!r}")
            continue
        counts["read"] += 1
        if options.notes and mesh.source["notes"]:
            print_line(f"{name}: notes: {'; '.join(mesh.source['notes'])}")
        ours = soup(mesh if default_up(path) == "z" else mesh.rotate(y_up))
        for reader in READERS:
            if reader is by_loops and path.suffix.lower() not in (".gltf", ".glb"):
                continue
            try:
                found = differences(ours, reader(path))
            except Exception as error:
                found = [f"cannot read it ({type(error).__name__}: {str(error)[:80]})"]
            counts[f"differ from {reader.__name__[3:]}"] += bool(found)
            if found:
                print_line(f"{name}: {reader.__name__[3:]}: {'; '.join(found)}")
    print_line(", ".join(f"{what} {n}" for what, n in counts.items()))
    sys.exit(bool(counts["differ from loops"] or counts["failed"]))


def differences(ours: Soup, other: Soup) -> list[str]:
    """Say where two readings of a file differ."""
    if not len(other.triangles):
        return ["no faces"]
    found = []
    if len(ours.triangles) != len(other.triangles):
        found.append(f"{len(ours.triangles)} faces, not {len(other.triangles)}")
    bounds = [np.stack([s.triangles.min((0, 1)), s.triangles.max((0, 1))]) for s in (ours, other)]
    size = np.ptp(bounds[0], axis=0).max()
    if not np.allclose(*bounds, atol=NEAR * size, rtol=0):
        found.append(" not ".join(f"bounds {np.round(b, 4).ravel().tolist()}" for b in bounds))
    chosen = np.arange(len(other.triangles))
    if len(chosen) > MAX_FACES:
        chosen = np.random.default_rng(0).choice(chosen, MAX_FACES, replace=False)
    # Compare the colours of each face with those of all that lie where it does.
    middles = [s.triangles.mean(1) for s in (ours, other)]
    near = cKDTree(middles[0]).query_ball_point(middles[1][chosen], NEAR * size)
    alone = sum(not same for same in near)
    if alone:
        found.append(f"{alone} of {len(chosen)} faces lie elsewhere")
    levels = [255 * srgb.encode(np.clip(s.colors, 0, 1)) for s in (ours, other)]
    known = [(i, same) for i, same in zip(chosen, near) if same and np.isfinite(other.colors[i]).all()]
    off = np.array([np.abs(levels[0][same] - levels[1][i]).max(1).min() for i, same in known])
    if (off > LEVELS).mean() > SHARE if len(off) else False:
        worst, same = known[int(off.argmax())]
        pair = np.rint(levels[0][same][0]), np.rint(levels[1][worst])
        found.append(f"colours of {(off > LEVELS).mean():.0%} of the faces, such as {pair[0]} not {pair[1]}")
    return found


def soup(mesh: TexturedMesh) -> Soup:
    """Return the faces of a loaded mesh."""
    triangles = mesh.vertices[mesh.faces]
    if mesh.uv is not None and mesh.texture is not None:
        places = mesh.uv[mesh.faces].mean(1)
        return Soup(triangles, sampled(mesh.texture, places[:, 0], 1 - places[:, 1]))
    if mesh.vertex_colors is not None:
        return Soup(triangles, srgb.decode(mesh.vertex_colors / 255)[mesh.faces].mean(1))
    return Soup(triangles, np.full((len(triangles), 3), np.nan))


def sampled(pixels: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return linear colours (N, 3) of a repeating sRGB image, bilinear in linear light; v points down."""
    height, width = pixels.shape[:2]
    x, y = u * width - 0.5, v * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros((len(x), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            texels = pixels[(top + dy) % height, (left + dx) % width, :3]
            total += weight[:, None] * srgb.decode(texels / 255)
    return total


def by_trimesh(path: Path) -> Soup:
    """Read a file by trimesh: colours of textures, factors and vertices as far as it knows them."""
    parts = []
    for one in trimesh.load_scene(path, process=False).dump():
        if not isinstance(one, trimesh.Trimesh):
            continue
        faces, visual = one.faces, one.visual
        colors = np.full((len(faces), 3), np.nan)
        material = getattr(visual, "material", None)
        if visual.kind == "texture" and material is not None:
            image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
            factor = getattr(material, "baseColorFactor", None)
            factor = np.ones(3) if factor is None else trimesh.visual.color.to_float(factor)[:3]
            colors = np.tile(factor, (len(faces), 1))
            if image is not None and visual.uv is not None:
                places = visual.uv[faces].mean(1)
                pixels = np.asarray(image.convert("RGB"))
                colors = colors * sampled(pixels, places[:, 0], 1 - places[:, 1])
            tint = getattr(visual, "vertex_attributes", {}).get("color")
            if tint is not None:
                colors = colors * trimesh.visual.color.to_float(tint)[:, :3][faces].mean(1)
        elif visual.kind in ("vertex", "face"):
            values = visual.face_colors[:, :3] / 255 if visual.kind == "face" else None
            corners = (visual.vertex_colors[:, :3] / 255)[faces] if values is None else values[:, None]
            gltf = path.suffix.lower() in (".gltf", ".glb")  # whose colours are linear
            colors = (corners if gltf else srgb.decode(corners)).mean(1)
        parts.append((one.vertices[faces], colors))
    return Soup(*(np.concatenate(column) for column in zip(*parts)))


# What follows reads glTF by plain loops, straight from the standard's text.


def by_loops(path: Path) -> Soup:
    """Read the default scene of a glTF file: skins, morph targets, copies; what is hidden is left out."""
    document, buffers = opened(path)
    nodes = document.get("nodes", [])
    parents = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}
    coarse = {i for node in nodes for i in extension(node, "MSFT_lod").get("ids", [])}
    scenes = document.get("scenes")
    if scenes:
        roots = set(scenes[document.get("scene", 0)].get("nodes", []))
    else:
        roots = {i for i in range(len(nodes)) if i not in parents}
    triangles: list[Any] = []
    colors: list[Any] = []
    images: dict[int, np.ndarray] = {}
    for index, node in enumerate(nodes):
        line = [index]
        while line[-1] not in roots and line[-1] in parents:
            line.append(parents[line[-1]])
        hidden = line[-1] not in roots or coarse & set(line)
        hidden = hidden or any(
            extension(nodes[i], "KHR_node_visibility").get("visible") is False for i in line
        )
        if "mesh" not in node or hidden:
            continue
        mesh = document["meshes"][node["mesh"]]
        world = placed(nodes, parents, index)
        copies = [world @ local for local in instances(document, buffers, node)]
        if not any(matrix[:3, :3].any() for matrix in copies) and "skin" not in node:
            continue
        for primitive in mesh["primitives"]:
            attributes, mode = primitive["attributes"], primitive.get("mode", 4)
            if mode < 4 or "POSITION" not in attributes:
                continue
            points = values(document, buffers, attributes["POSITION"])
            for weight, target in zip(
                node.get("weights", mesh.get("weights", [])), primitive.get("targets", [])
            ):
                if weight and "POSITION" in target:
                    for point, moved in zip(points, values(document, buffers, target["POSITION"])):
                        for axis in range(3):
                            point[axis] += weight * moved[axis]
            corners = list(range(len(points)))
            if "indices" in primitive:
                corners = [int(row[0]) for row in values(document, buffers, primitive["indices"])]
            faces = assembled(corners, mode)
            shade = shades(document, buffers, primitive, faces, images, path)
            if "skin" in node and "JOINTS_0" in attributes:
                bent = skinned(document, buffers, nodes, parents, node["skin"], attributes, points)
                triangles += [[bent[i] for i in face] for face in faces]
                colors += shade
                continue
            for matrix in copies:
                there = [(matrix @ [*point, 1.0])[:3] for point in points]
                triangles += [[there[i] for i in face] for face in faces]
                colors += shade
    return Soup(np.reshape(triangles, (-1, 3, 3)), np.reshape(colors, (-1, 3)))


def opened(path: Path) -> tuple[dict[str, Any], list[bytes]]:
    """Return the document and the buffers of a file."""
    data, chunk = path.read_bytes(), b""
    if data[:4] == b"glTF":
        size = struct.unpack_from("<I", data, 12)[0]
        chunk = data[20 + size + 8 :]
        data = data[20 : 20 + size]
    document = json.loads(data)
    buffers = [fetched(b["uri"], path) if "uri" in b else chunk for b in document.get("buffers", [])]
    return document, buffers


def fetched(uri: str, path: Path) -> bytes:
    """Return what a URI stands for."""
    if not uri.startswith("data:"):
        return (path.parent / unquote(uri)).read_bytes()
    head, _, content = uri.partition(",")
    return base64.b64decode(content) if "base64" in head else unquote_to_bytes(content)


def extension(item: dict[str, Any], name: str) -> dict[str, Any]:
    """Return an extension of a part of the document, empty if there is none."""
    return item.get("extensions", {}).get(name, {})


def values(document: dict[str, Any], buffers: list[bytes], index: int) -> list[list[float]]:
    """Return the rows of an accessor."""
    accessor = document["accessors"][index]
    code = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]

    def rows(view_index: int, offset: int, code: str, width: int, count: int) -> list[list[float]]:
        view = document["bufferViews"][view_index]
        start, form = view.get("byteOffset", 0) + offset, struct.Struct(f"<{width}{code}")
        stride = view.get("byteStride", form.size)
        return [list(form.unpack_from(buffers[view["buffer"]], start + i * stride)) for i in range(count)]

    result: list[list[float]] = [[0] * width for _ in range(accessor["count"])]
    if "bufferView" in accessor:
        result = rows(accessor["bufferView"], accessor.get("byteOffset", 0), code, width, accessor["count"])
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        at, new, count = sparse["indices"], sparse["values"], sparse["count"]
        kind = {5121: "B", 5123: "H", 5125: "I"}[at["componentType"]]
        places = rows(at["bufferView"], at.get("byteOffset", 0), kind, 1, count)
        for (place,), row in zip(
            places, rows(new["bufferView"], new.get("byteOffset", 0), code, width, count)
        ):
            result[int(place)] = row
    if accessor.get("normalized"):
        largest = {"b": 127, "B": 255, "h": 32767, "H": 65535}[code]
        result = [[max(value / largest, -1.0) for value in row] for row in result]
    return result


def local(node: dict[str, Any]) -> np.ndarray:
    """Return the matrix of a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4, order="F")
    matrix = trimesh.transformations.quaternion_matrix(np.roll(node.get("rotation", [0, 0, 0, 1]), 1))
    matrix[:3, :3] = matrix[:3, :3] @ np.diag(node.get("scale", [1, 1, 1]))
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def placed(nodes: list[dict[str, Any]], parents: dict[int, int], index: int) -> np.ndarray:
    """Return the matrix of a node to the scene."""
    matrix = local(nodes[index])
    while index in parents:
        index = parents[index]
        matrix = local(nodes[index]) @ matrix
    return matrix


def instances(document: dict[str, Any], buffers: list[bytes], node: dict[str, Any]) -> list[np.ndarray]:
    """Return the matrices of a node's copies, the identity if it has none."""
    attributes = extension(node, "EXT_mesh_gpu_instancing").get("attributes", {})
    columns = {
        name.lower(): values(document, buffers, attributes[name])
        for name in ("TRANSLATION", "ROTATION", "SCALE")
        if name in attributes
    }
    rows = zip(*columns.values()) if columns else [()]
    return [local(dict(zip(columns, row))) for row in rows]


def skinned(
    document: dict[str, Any],
    buffers: list[bytes],
    nodes: list[dict[str, Any]],
    parents: dict[int, int],
    index: int,
    attributes: dict[str, int],
    points: list[list[float]],
) -> list[np.ndarray]:
    """Return points where the joints of a skin put them."""
    skin = document["skins"][index]
    matrices = [placed(nodes, parents, joint) for joint in skin["joints"]]
    if "inverseBindMatrices" in skin:
        inverse = values(document, buffers, skin["inverseBindMatrices"])
        matrices = [m @ np.reshape(row, (4, 4), order="F") for m, row in zip(matrices, inverse)]
    bent = [np.zeros(3) for _ in points]
    sums = [0.0 for _ in points]
    for n in range(4):
        if f"JOINTS_{n}" not in attributes:
            continue
        joints = values(document, buffers, attributes[f"JOINTS_{n}"])
        weights = values(document, buffers, attributes[f"WEIGHTS_{n}"])
        for i, point in enumerate(points):
            for joint, weight in zip(joints[i], weights[i]):
                if weight:
                    bent[i] = bent[i] + weight * (matrices[int(joint)] @ [*point, 1.0])[:3]
                    sums[i] += weight
    first = values(document, buffers, attributes["JOINTS_0"])
    return [
        total / weight if weight else (matrices[int(joint[0])] @ [*point, 1.0])[:3]
        for total, weight, joint, point in zip(bent, sums, first, points)
    ]


def assembled(corners: list[int], mode: int) -> list[list[int]]:
    """Return the triangles of corners: of triangles, strips or fans."""
    if mode == 4:
        return [corners[i : i + 3] for i in range(0, len(corners) - 2, 3)]
    if mode == 5:
        return [[corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]] for i in range(len(corners) - 2)]
    return [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]


def shades(
    document: dict[str, Any],
    buffers: list[bytes],
    primitive: dict[str, Any],
    faces: list[list[int]],
    images: dict[int, np.ndarray],
    path: Path,
) -> list[np.ndarray]:
    """Return the linear base colour in the middle of each triangle."""
    plain = "material" not in primitive and "COLOR_0" not in primitive["attributes"]
    material = document["materials"][primitive["material"]] if "material" in primitive else {}
    surface = material.get("pbrMetallicRoughness", {})
    factor, info = surface.get("baseColorFactor", [1, 1, 1]), surface.get("baseColorTexture")
    gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if gloss is not None:
        factor, info = gloss.get("diffuseFactor", [1, 1, 1]), gloss.get("diffuseTexture")
    result = [np.array(factor[:3], float) * (math.nan if plain else 1) for _ in faces]
    if "COLOR_0" in primitive["attributes"]:
        tints = values(document, buffers, primitive["attributes"]["COLOR_0"])
        for i, face in enumerate(faces):
            corners = [np.clip(tints[corner][:3], 0, 1) for corner in face]
            result[i] = result[i] * (corners[0] + corners[1] + corners[2]) / 3
    if info is None:
        return result
    change = extension(info, "KHR_texture_transform")
    name = f"TEXCOORD_{change.get('texCoord', info.get('texCoord', 0))}"
    if name not in primitive["attributes"]:
        return [np.full(3, math.nan) for _ in faces]
    texture = document["textures"][info["index"]]
    source = extension(texture, "EXT_texture_webp").get("source", texture.get("source"))
    if source not in images:
        image = document["images"][source]
        if "uri" in image:
            data = fetched(image["uri"], path)
        else:
            view = document["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = buffers[view["buffer"]][start : start + view["byteLength"]]
        images[source] = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
    sampler = document["samplers"][texture["sampler"]] if "sampler" in texture else {}
    coordinates = values(document, buffers, primitive["attributes"][name])
    cos, sin = math.cos(change.get("rotation", 0)), math.sin(change.get("rotation", 0))
    (sx, sy), (ox, oy) = change.get("scale", (1, 1)), change.get("offset", (0, 0))
    places = []
    for face in faces:
        u, v = (sum(coordinates[corner][axis] for corner in face) / 3 for axis in (0, 1))
        u, v = u * sx, v * sy
        u, v = cos * u + sin * v + ox, cos * v - sin * u + oy
        wraps = sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)
        sides = images[source].shape[1::-1]
        places.append([wrapped(w, wrap, side) for w, wrap, side in zip((u, v), wraps, sides)])
    u, v = np.reshape(places, (-1, 2)).T
    return [a * b for a, b in zip(result, sampled(images[source], u, v))]


def wrapped(place: float, wrap: int, side: int) -> float:
    """Move a coordinate into an image as its sampler says."""
    if wrap == 33071:
        return min(max(place, 0.5 / side), 1 - 0.5 / side)
    if wrap == 33648:
        place = place % 2
        return min(max(place if place <= 1 else 2 - place, 0.5 / side), 1 - 0.5 / side)
    return place % 1


READERS = (by_trimesh, by_loops)


if __name__ == "__main__":
    main()
