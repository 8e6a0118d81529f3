"""Small glTF scenes for tests, and colour lookup in a mesh as by a renderer."""

import base64
import io
import json

import numpy as np
from PIL import Image

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.load import load_mesh

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Scene:
    """glTF document with embedded data; nodes and materials as in the standard."""

    def __init__(self):
        groups = (
            "nodes",
            "meshes",
            "accessors",
            "bufferViews",
            "materials",
            "textures",
            "images",
            "samplers",
        )
        self.document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.document |= {name: [] for name in groups}
        self.data = b""

    def append(self, group, item):
        self.document[group].append(item)
        return len(self.document[group]) - 1

    def view(self, data, **view):
        self.data += b"\0" * (-len(self.data) % 4)
        start, self.data = len(self.data), self.data + data
        return self.append("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **view})

    def accessor(self, values, dtype="f4", **accessor):
        values = np.asarray(values, "<" + dtype)
        columns = 1 if values.ndim == 1 else values.shape[1]
        described = {"componentType": COMPONENTS[dtype], "count": len(values), "type": TYPES[columns]}
        view = {"bufferView": self.view(values.tobytes())}
        return self.append("accessors", view | described | accessor)

    def texture(self, pixels, **sampler):
        stream = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "png")
        image = self.append("images", {"bufferView": self.view(stream.getvalue()), "mimeType": "image/png"})
        texture = {"source": image}
        if sampler:
            texture["sampler"] = self.append("samplers", sampler)
        return self.append("textures", texture)

    def material(self, texture=None, info=None, **pbr):
        if texture is not None:
            pbr["baseColorTexture"] = {"index": texture, **(info or {})}
        return self.append("materials", {"pbrMetallicRoughness": pbr})

    def mesh(self, vertices, faces, material=None, **attributes):
        """Attributes are arrays, or indices of accessors."""
        index = {
            name: value if isinstance(value, int) else self.accessor(value)
            for name, value in {"POSITION": vertices, **attributes}.items()
        }
        primitive = {"attributes": index, "indices": self.accessor(np.ravel(faces), "u4")}
        if material is not None:
            primitive["material"] = material
        return self.append("meshes", {"primitives": [primitive]})

    def node(self, mesh=None, root=True, **node):
        index = self.append("nodes", {**({} if mesh is None else {"mesh": mesh}), **node})
        if root:
            self.document["scenes"][0]["nodes"].append(index)
        return index

    def quads(self, x, material=None, uv=None, **attributes):
        """Put N unit quads, of two triangles, in a row along z at `x`; `uv` (N, 4, 2), colours (N, 4, C)."""
        count = next((len(a) for a in (uv, *attributes.values()) if a is not None), 1)
        corner = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
        vertices = (corner + np.arange(count)[:, None, None] * [0, 0, 2] + [x, 0, 0]).reshape(-1, 3)
        faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]
        arrays = {k: np.reshape(v, (4 * count, -1)) for k, v in attributes.items()}
        if uv is not None:
            arrays["TEXCOORD_0"] = np.reshape(uv, (-1, 2))
        return self.node(self.mesh(vertices, faces, material, **arrays))

    def finished(self, uri):
        """The whole document, whose data are at a place."""
        document = {name: value for name, value in self.document.items() if value != []}
        return document | {"buffers": [{"byteLength": len(self.data), "uri": uri}]}

    def write(self, path):
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        path.write_text(json.dumps(self.finished(uri)))
        return path


def square(u, v, size):
    """Texture coordinates (4, 2) of a quad in glTF's frame: a square around (u, v)."""
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return np.array([u, v]) + size * corner


def checker(colors, cell):
    """Pixels of flat squares of `cell` texels; colours (rows, columns, 3)."""
    return np.repeat(np.repeat(np.asarray(colors, np.uint8), cell, 0), cell, 1)


def colors_at(mesh, weights=(1 / 3, 1 / 3, 1 / 3)):
    """SRGB colours (F, 3), 0 to 255, at one place of every face: bilinear and repeating, in linear light."""
    if mesh.texture is None:
        corners = srgb.decode(mesh.vertex_colors[mesh.faces] / 255)
        return 255 * srgb.encode(np.einsum("k,fkc->fc", weights, corners))
    linear = srgb.decode(mesh.texture / 255)
    height, width = linear.shape[:2]
    uv = np.einsum("k,fkc->fc", weights, mesh.uv[mesh.faces])
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = np.zeros((len(uv), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
            total += weight[:, None] * linear[(top + dy) % height, (left + dx) % width]
    return 255 * srgb.encode(total)


def loaded_or_refused(path):
    """Load a mesh, which is sound, or is refused by name."""
    try:
        mesh = load_mesh(path)
    except ObjectFolderError as error:
        if str(path) not in str(error):
            raise
        return
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert np.isfinite(mesh.vertices).all()
