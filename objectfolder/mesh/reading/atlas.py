"""An atlas: windows of images, plain colours and cells of faces, packed into one texture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image
from trimesh.path.packing import rectangles_single

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.parts import MeshPart
from objectfolder.mesh.reading.texels import (
    base_color,
    sample_texels,
    scale_image,
    srgb_bytes,
    texel_places,
    tint_pixels,
    wrap_texels,
)

MARGIN = 2  # texels around a window, to keep bilinear filtering inside
SHRINK = 0.97  # factor on all images, repeated until they fit the atlas
CELL = 8  # largest side of the cell of a face without an image, texels
CELL_SHARE = 0.25  # fraction of the atlas for these cells, and the least for those with an image
FILLED = 0.9  # fraction of the atlas that cells with an image may fill up


def bake_atlas(
    parts: Sequence[MeshPart], texture_size: int, name: str
) -> tuple[list[MeshPart], dict[str, Any], list[float]]:
    """Bake parts, which have texture coordinates where their material has an image, into one texture.

    Its longest side is at most ``texture_size`` pixels; raises `ObjectFolderError` if they do not fit.

    Returns the parts with coordinates in the atlas, of which those with vertex colours beside an image may
    be divided and share no corners; ``uv`` (V, 2) of all parts and ``texture`` (H, W, 3) uint8; and the
    scale of each image in the atlas.
    """
    parts = [piece for part in parts for piece in _split_by_size(_move_near_origin(part))]
    # Parts of one material share a window; faces with vertex colours have cells.
    groups: dict[Any, list[int]] = {}
    for i, part in enumerate(parts):
        groups.setdefault(part.material if part.colors is None else i, []).append(i)
    members = _choose_cells([_Group.of([parts[i] for i in group]) for group in groups.values()], texture_size)
    scale = 1.0
    while True:
        sizes = np.array([_size(group, scale, texture_size) for group in members])
        if sizes.prod(1).sum() <= texture_size**2:  # otherwise skip the slow packer
            # The packer sorts by size, unstably: make all sizes distinct.
            distinct = sizes + 1e-6 * np.arange(len(sizes))[:, None]
            corners, fitted = rectangles_single(distinct, size=(texture_size + 0.5,) * 2, rotate=False)
            if fitted.all():
                break
        if scale < 1e-3:
            raise ObjectFolderError(
                f"{name}: its {len(members)} materials do not fit one texture of {texture_size} texels "
                f"(one takes {sizes.max()}); raise texture_size, or bake the mesh to one texture"
            )
        scale *= SHRINK
    corners = np.rint(corners[:, 0]).astype(int)
    width, height = (corners + sizes).max(0)
    texture = np.zeros((height, width, 3), np.uint8)
    result = list(parts)
    for (left, top), (w, h), group, indices in zip(corners, sizes, members, groups.values()):
        window, painted = _paint(group, scale, texture_size)
        texture[top : top + h, left : left + w] = window
        for index, (part, texels) in zip(indices, painted):
            uv = (texels + np.array([left, top])) / [width, height] * [1, -1] + [0, 1]
            result[index] = replace(part, uv=uv)
    uv = np.concatenate([p.uv for p in result if p.uv is not None])
    scales = [group.scale(scale, texture_size) for group in members if group.image is not None]
    return result, {"uv": uv, "texture": texture}, scales


def _move_near_origin(part: MeshPart) -> MeshPart:
    """Move the texture coordinates of every face next to the origin by whole repeats.

    Along an axis that is clamped, faces beyond the image have the colours of its edge, and move there.
    """
    if part.material.image is None or part.uv is None:
        return part
    corner = part.uv[part.faces]
    if corner.min() >= 0 and corner.max() <= 1:
        return part
    clamped = np.array([wrap == "clamp" for wrap in part.material.wrap])
    period = np.array([{"repeat": 1.0, "mirror": 2.0, "clamp": np.inf}[wrap] for wrap in part.material.wrap])
    shift = np.where(clamped, 0, np.floor(corner.min(1) / period))
    beyond = clamped & ((corner <= 0).all(1) | (corner >= 1).all(1))
    # Duplicate vertices of faces that move differently.
    moves, move = np.unique(np.concatenate([shift, beyond], 1), axis=0, return_inverse=True)
    kept, faces = np.unique(part.faces * len(moves) + move.reshape(-1, 1), return_inverse=True)
    vertex, move = kept // len(moves), kept % len(moves)
    uv = part.uv[vertex] - moves[move, :2] * np.where(clamped, 0, period)
    return replace(
        part,
        vertices=part.vertices[vertex],
        faces=faces.reshape(-1, 3),
        uv=np.where(moves[move, 2:], uv.clip(0, 1), uv),
        colors=None if part.colors is None else part.colors[vertex],
        normals=None if part.normals is None else part.normals[vertex],
    )


def _split_by_size(part: MeshPart) -> list[MeshPart]:
    """Part faces with vertex colours beside an image by the texels they cover, two sizes per doubling."""
    if part.colors is None or part.material.image is None:
        return [part]
    level = np.ceil(2 * np.log2(np.maximum(_texel_sides(part), 1)))
    return [replace(part, faces=part.faces[level == one]) for one in np.unique(level)]


def _texel_sides(part: MeshPart) -> np.ndarray:
    """Return the longer of the first corner's two edges, in texels of the part's image; (F,)."""
    assert part.material.image is not None
    assert part.uv is not None
    corner = part.uv[part.faces]
    edges = (corner[:, 1:] - corner[:, :1]) * part.material.image.size
    return np.asarray(np.linalg.norm(edges, axis=2).max(1))


@dataclass(frozen=True)
class _Group:
    """Parts that share a window of the atlas, or one part whose faces have cells of the same size."""

    parts: Sequence[MeshPart]
    low: np.ndarray  #: (2,) lower corner of the used window, in image sides, y down
    high: np.ndarray  #: (2,) upper corner
    texels: int  #: side of what a face with a cell covers of its image, texels
    cell: int = 0  #: bound of the side of a face's cell, before images are scaled

    @staticmethod
    def of(parts: Sequence[MeshPart]) -> "_Group":
        corners = [p.uv[p.used] * [1, -1] + [0, 1] for p in parts if p.uv is not None]
        corner = np.concatenate(corners) if corners else np.zeros((1, 2))
        celled = parts[0].colors is not None and parts[0].material.image is not None
        texels = int(np.ceil(_texel_sides(parts[0]).max())) + 1 if celled else 0
        return _Group(parts, corner.min(0), corner.max(0), texels)

    @property
    def image(self) -> Image.Image | None:
        """Image of the parts' material."""
        return self.parts[0].material.image

    @property
    def celled(self) -> bool:
        """Whether faces have cells."""
        return self.parts[0].colors is not None

    def scale(self, scale: float, limit: int) -> float:
        """Return the scale of the image, less than ``scale`` if no more fits an atlas of that size."""
        if self.image is None:
            return 1.0
        if self.celled:
            return self.side(scale) / self.texels
        extent = self.image.size * np.maximum(self.high - self.low, 1)
        return float(scale * min(1, limit / extent.max()))

    def side(self, scale: float) -> int:
        """Return the side of a cell in the atlas, texels."""
        return self.cell if self.image is None else max(min(self.texels, round(self.cell * scale)), 1)


def _choose_cells(groups: Sequence[_Group], limit: int) -> list[_Group]:
    """Choose the sides of cells: what faces cover of their images, up to a bound that fits the free area."""
    plain = [group for group in groups if group.celled and group.image is None]
    count = sum(len(group.parts[0].faces) for group in plain)
    side = int(np.clip(limit * np.sqrt(CELL_SHARE / max(count, 1)), 1, CELL))
    groups = [replace(group, cell=side) for group in groups]
    imaged = [group for group in groups if group.texels]
    if not imaged:
        return groups
    others = sum(np.prod(_size(group, 1, limit)) for group in groups if not group.texels)
    free = limit**2 * FILLED - others
    bound = _bound(
        np.array([group.texels for group in imaged]),
        np.array([len(group.parts[0].faces) for group in imaged]),
        max(free, CELL_SHARE * limit**2),
    )
    return [replace(group, cell=min(int(bound), limit)) if group.texels else group for group in groups]


def _bound(sides: np.ndarray, counts: np.ndarray, area: float) -> float:
    """Return the largest bound of squares' sides at which they take no more than an area."""
    order = np.argsort(sides)
    sides, counts = sides[order], counts[order]
    taken = np.concatenate([[0], np.cumsum(counts * sides**2)[:-1]])  # by the smaller ones
    left = counts[::-1].cumsum()[::-1]
    bounds = np.sqrt(np.maximum(area - taken, 0) / left)
    binds = np.flatnonzero(bounds <= sides)
    return float(bounds[binds[0]] if len(binds) else sides[-1])


def _window(group: _Group, scale: float, limit: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the size (2,) of a scaled image and the first and last + 1 used texel (2,)."""
    size = _scaled(group, scale, limit)
    first, last = np.floor(group.low * size) - MARGIN, np.ceil(group.high * size) + MARGIN
    return size, first.astype(int), last.astype(int)


def _scaled(group: _Group, scale: float, limit: int) -> np.ndarray:
    """Return the size (2,) of a group's scaled image."""
    assert group.image is not None
    return np.maximum(np.rint(np.array(group.image.size) * group.scale(scale, limit)), 1).astype(int)


def _size(group: _Group, scale: float, limit: int) -> tuple[int, int]:
    """Return the width and height of a group in the atlas, texels."""
    if group.celled:
        columns = int(np.ceil(np.sqrt(len(group.parts[0].faces))))
        rows = int(np.ceil(len(group.parts[0].faces) / columns))
        side = group.side(scale)
        return columns * side, rows * side
    if group.image is None:
        return 2 * MARGIN + 1, 2 * MARGIN + 1
    _, first, last = _window(group, scale, limit)
    return int(last[0] - first[0]), int(last[1] - first[1])


def _paint(group: _Group, scale: float, limit: int) -> tuple[np.ndarray, list[tuple[MeshPart, np.ndarray]]]:
    """Return the texels (h, w, 3) of a group, and its parts with texel coordinates (V, 2), y down."""
    material = group.parts[0].material
    if group.celled:
        return _paint_faces(group, scale, limit)
    if material.image is None:
        middle = MARGIN + 0.5
        side = 2 * MARGIN + 1
        places = [(p, np.full((len(p.vertices), 2), middle)) for p in group.parts]
        return np.broadcast_to(srgb_bytes(base_color(group.parts[0])), (side, side, 3)), places
    size, first, last = _window(group, scale, limit)
    texels = tint_pixels(material, scale_image(material.image, size))
    columns = wrap_texels(np.arange(first[0], last[0]), size[0], material.wrap[0])
    rows = wrap_texels(np.arange(first[1], last[1]), size[1], material.wrap[1])
    places = [(p, texel_places(p.uv, size) - first) for p in group.parts if p.uv is not None]
    return texels[rows][:, columns], places


def _paint_faces(
    group: _Group, scale: float, limit: int
) -> tuple[np.ndarray, list[tuple[MeshPart, np.ndarray]]]:
    """Paint vertex colours, times the image if there is one, into a cell per face."""
    part = group.parts[0]
    assert part.colors is not None
    width, height = _size(group, scale, limit)
    cell = group.side(scale)
    columns, count = width // cell, len(part.faces)
    # A face's corners are the centres of three corner texels of its cell; colours extend beyond its edge.
    step = np.arange(cell) / max(cell - 1, 1)
    b, c = np.meshgrid(step, step) if cell > 1 else (np.full((1, 1), 1 / 3),) * 2
    weights = np.stack([1 - b - c, b, c], -1)
    linear = np.clip(np.einsum("ijk,fkc->fijc", weights, part.colors[part.faces]), 0, 1)
    if part.material.image is None:
        linear *= base_color(part)
    elif part.uv is not None:
        uv = np.einsum("ijk,fkc->fijc", weights, part.uv[part.faces])
        size = _scaled(group, scale, limit)
        texels = tint_pixels(part.material, scale_image(part.material.image, size))
        linear *= sample_texels(texels, texel_places(uv.reshape(-1, 2), size), part.material.wrap).reshape(
            linear.shape
        )
    cells = np.zeros((height // cell * columns, cell, cell, 3), np.uint8)
    cells[:count] = srgb_bytes(linear)
    pixels = cells.reshape(-1, columns, cell, cell, 3).swapaxes(1, 2).reshape(height, width, 3)
    index = np.arange(count)
    origin = np.stack([index % columns, index // columns], 1) * cell + 0.5
    places = origin[:, None] + (cell - 1) * np.array([[0, 0], [1, 0], [0, 1]])
    own = MeshPart(
        part.vertices[part.faces].reshape(-1, 3),
        np.arange(3 * count).reshape(-1, 3),
        part.material,
        normals=None if part.normals is None else part.normals[part.faces].reshape(-1, 3),
    )
    return pixels, [(own, places.reshape(-1, 2))]
