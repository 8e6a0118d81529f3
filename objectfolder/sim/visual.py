"""The stored surface as a light textured mesh, for engines that draw triangles."""

from typing import Any

import numpy as np
import torch
import trimesh
from PIL import Image

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.srgb import encode
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.solid import merge_meshes, simplify
from objectfolder.vision.appearance import appearance_at
from objectfolder.vision.query import BaseColors
from objectfolder.vision.scene import Scene

GREY = 0.7  #: grey of objects without base colours, sRGB
ROUGHNESS = 0.5  #: of what is drawn, in exports whose format has it
TEXELS = 1024  #: side of the texture
_TOLERANCES = 0.001 * 2.0 ** np.arange(5)  # tolerances of the simplification, fractions of the longest side
_TEXELS_PER_FACE = 26  # texels of the texture for each face, on average: 40,000 faces
MOST_FACES = 100_000  #: of a source that is drawn as it is
_FACE_MARGIN = 1  # texels around a face, so that bilinear filtering does not reach a neighbour


def visual_mesh(file: ObjectFile, base_colors: BaseColors | None = None) -> trimesh.Trimesh:
    """Return the surface with some thousands of triangles; object frame, metres.

    The given base colours, or those of a vision net of kind ``surface``, become the texture, without
    reflections. Other objects are grey. Very detailed surfaces are simplified more than others, so that all
    triangles have room in the texture. Raises ObjectFolderError if there is no geometry, no manifold3d, or
    no room.
    """
    mesh = _simplify(file.to_mesh(), file.scale)
    if base_colors is None and "vision" in file.header:
        base_colors = file.base_colors
    normals = file.surface.grid.normals(torch.from_numpy((mesh.vertices / file.scale).astype(np.float32)))
    if base_colors is None:
        return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals.numpy(), process=False)
    most = (TEXELS // (2 + 2 * _FACE_MARGIN)) ** 2
    if len(mesh.faces) > most:
        raise ObjectFolderError(
            f"{file.key}: the surface has {len(mesh.faces)} triangles after simplification, expected at most "
            f"{most}, which fit into a texture of {TEXELS} x {TEXELS} texels; rebuild the object with a "
            "smaller voxelize.sdf_resolution"
        )
    corners = np.asarray(mesh.triangles)
    longest = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2).argmax(1)
    order = np.take_along_axis(mesh.faces, (longest[:, None] + np.arange(3)) % 3, 1)
    corners = np.asarray(mesh.vertices)[order] / file.scale
    uv, image = _paint(base_colors, corners)
    return trimesh.Trimesh(
        corners.reshape(-1, 3) * file.scale,
        np.arange(corners.shape[0] * 3).reshape(-1, 3),
        vertex_normals=normals.numpy()[order].reshape(-1, 3),
        visual=_textured(uv.reshape(-1, 2), image),
        process=False,
    )


def source_look(mesh: TexturedMesh, file: ObjectFile) -> trimesh.Trimesh:
    """Return the source's own triangles with its texture; object frame, metres.

    ``mesh``: in the unit frame; ``file``: its stored surface. Where a physics engine could not show these,
    as with vertex colours or more than `MOST_FACES` triangles, the colours are painted on the stored surface,
    as by `visual_mesh`. A mesh without colours is grey.
    """
    textured = mesh.texture is not None and mesh.uv is not None
    coloured = textured or mesh.vertex_colors is not None
    if coloured and (len(mesh.faces) > MOST_FACES or not textured):
        scene = Scene(mesh)

        def base_colors(points: np.ndarray) -> np.ndarray:
            return np.rint(255 * encode(appearance_at(scene, points)[0].clip(0, 1))).astype(np.uint8)

        return visual_mesh(file, base_colors)
    smooth = mesh if mesh.normals is not None else mesh.with_smooth_normals()
    options: dict[str, Any] = {"vertex_normals": smooth.normals, "process": False}
    if smooth.texture is not None and smooth.uv is not None:
        options["visual"] = _textured(smooth.uv, smooth.texture)
    return trimesh.Trimesh(smooth.vertices * file.scale, smooth.faces, **options)


def _textured(uv: np.ndarray, image: np.ndarray) -> trimesh.visual.TextureVisuals:
    """Return the appearance of an image (H, W, 3) at texture coordinates (V, 2) of vertices."""
    material = trimesh.visual.material.SimpleMaterial(
        image=Image.fromarray(image),
        diffuse=[255] * 4,
        ambient=[255] * 4,
        specular=[0, 0, 0, 255],  # reflections are not in the base colours
        name="visual",
    )
    return trimesh.visual.TextureVisuals(uv, material)


def texture_image(mesh: trimesh.Trimesh) -> Image.Image | None:
    """Return the image on a mesh of `visual_mesh`, if it has one."""
    return getattr(getattr(mesh.visual, "material", None), "image", None)


def _simplify(whole: trimesh.Trimesh, size: float) -> trimesh.Trimesh:
    """Return a mesh simplified by the first tolerance that leaves `_TEXELS_PER_FACE`, or by the last.

    A mesh that is not closed stays as it is.
    """
    mesh = whole
    for detail in _TOLERANCES:
        shells = simplify(mesh, detail * size)  # again and again: coarse at once leaves more triangles
        if not shells:
            break
        mesh = merge_meshes(shells)
        if len(mesh.faces) * _TEXELS_PER_FACE <= TEXELS**2:
            break
    return mesh


def _paint(base_colors: BaseColors, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return texture coordinates (F, 3, 2) of faces, and a square image (T, T, 3) with a rectangle per face.

    Corners (F, 3, 3) are in the unit frame; the longest edge of a face is its first.
    """
    start, along = corners[:, 0], corners[:, 1] - corners[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    up = corners[:, 2] - start
    foot = (up * along).sum(1)
    up = up - foot[:, None] * along
    height = np.linalg.norm(up, axis=1)
    up = up / np.maximum(height, np.finfo(float).tiny)[:, None]
    density, origins, sizes = _pack(np.stack([length, height], 1))
    texel = np.repeat(np.arange(len(sizes)), sizes.prod(1))
    number = np.arange(len(texel)) - np.repeat(sizes.prod(1).cumsum() - sizes.prod(1), sizes.prod(1))
    place = np.stack([number % sizes[texel, 0], number // sizes[texel, 0]], 1)
    away = (place - _FACE_MARGIN) / density
    points = start[texel] + away[:, :1] * along[texel] + away[:, 1:] * up[texel]
    image = np.full((TEXELS, TEXELS, 3), np.uint8(round(255 * GREY)))
    column, row = (origins[texel] + place).T
    image[row, column] = base_colors(points)
    zero = 0 * length
    local = np.stack([np.stack(at, 1) for at in ((zero, zero), (length, zero), (foot, height))], 1)
    uv = (origins[:, None] + _FACE_MARGIN + 0.5 + density * local) / TEXELS
    return uv * [1, -1] + [0, 1], image


def _pack(sides: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Pack rectangles into rows, sorted by height, as large as the image allows.

    Takes widths and heights (F, 2), unit frame. Returns texels per unit, and first texel and extent with
    margins of each rectangle: columns and rows, (F, 2) int.
    """
    density = TEXELS / np.sqrt(sides.prod(1).sum())
    while True:
        sizes = np.ceil(density * sides).astype(np.int64) + 1 + 2 * _FACE_MARGIN
        origins = np.zeros_like(sizes)
        column = row = tall = 0
        for k in np.lexsort((sizes[:, 0], -sizes[:, 1])).tolist():
            width, height = sizes[k].tolist()
            if column + width > TEXELS:
                column, row = 0, row + tall
            if not column:
                tall = height
            origins[k] = column, row
            column += width
        if row + tall <= TEXELS and sizes.max() <= TEXELS:
            return density, origins, sizes
        density *= 0.93
