"""Join parts with several materials into one mesh with one texture or vertex colours."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from PIL import Image

from objectfolder.mesh import srgb
from objectfolder.mesh.normals import area_vectors
from objectfolder.mesh.reading.atlas import bake_atlas
from objectfolder.mesh.reading.parts import MeshPart, SurfaceMaterial
from objectfolder.mesh.reading.texels import base_color, srgb_bytes, tint_pixels
from objectfolder.mesh.textured import DEFAULT_ROUGHNESS, TexturedMesh


def join(parts: Sequence[MeshPart], texture_size: int, name: str) -> tuple[TexturedMesh, list[str]]:
    """Join parts, with at least one face in total, into one mesh; and say what that changes of its look.

    Without textures, the result has one plain colour or vertex colours. A single texture is kept with its
    coordinates, times vertex colours that are all equal. Otherwise an atlas is baked, ``texture_size``
    pixels at most: for each image the window used by its faces in whole texels, with repeats written out
    after every face was moved next to the origin by whole repeats; for a plain colour one texel; for vertex
    colours a cell of texels per face, as large as what the face covers of an image. Images are scaled down
    together until all fit, or `ObjectFolderError` is raised. Roughness and metallic become area-weighted
    means. Normals are kept, NaN in parts without.
    """
    parts = [part for part in parts if len(part.faces)]
    surface, notes = _roughness_metallic(parts)
    no_uv = [p for p in parts if p.material.image is not None and p.uv is None]
    if no_uv:
        notes.append(f"texture without coordinates replaced by its mean colour ({len(no_uv)})")
    parts = [_replace_by_mean(p) if p.material.image is not None and p.uv is None else p for p in parts]
    parts = _tint(parts)
    materials = list(dict.fromkeys(p.material for p in parts))
    if all(m.image is None for m in materials):
        appearance = _untextured(parts)
    elif len(materials) == 1 and all(p.colors is None for p in parts) and _plain_wrap(parts):
        appearance = {
            "uv": np.concatenate([p.uv for p in parts if p.uv is not None]),
            "texture": tint_pixels(materials[0], _limit_size(materials[0].image, texture_size)),
        }
    else:
        parts, appearance, scales = bake_atlas(parts, texture_size, name)
        side = " x ".join(map(str, appearance["texture"].shape[1::-1]))
        several = f"{len(materials)} materials" if len(materials) > 1 else "1 material"
        shares = dict.fromkeys(f"{100 * scale:.3g}%" for scale in (min(scales), max(scales)))
        notes.append(f"{several} baked into {side} texels, images at {' to '.join(shares)}")
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    mesh = TexturedMesh(
        vertices=np.concatenate([p.vertices for p in parts]),
        faces=np.concatenate([p.faces + offset for p, offset in zip(parts, offsets)]),
        normals=_normals(parts),
        **appearance,
        **surface,
    )
    return mesh, notes


def _normals(parts: Sequence[MeshPart]) -> np.ndarray | None:
    """Concatenate the normals (V, 3), NaN in parts without; None if no part has any."""
    if all(p.normals is None for p in parts):
        return None
    return np.concatenate(
        [np.full(p.vertices.shape, np.nan) if p.normals is None else p.normals for p in parts]
    )


def _roughness_metallic(parts: Sequence[MeshPart]) -> tuple[dict[str, Any], list[str]]:
    """Average both over the parts, weighted by area; those that specify none have the default."""
    result: dict[str, Any] = {}
    notes = []
    for quantity, default in (("roughness", DEFAULT_ROUGHNESS), ("metallic", 0.0)):
        said = [getattr(p.material, quantity) for p in parts]
        if all(value is None for value in said):
            continue
        known = np.array([default if value is None else value for value in said], np.float64)
        result[quantity] = float(known[0])
        if np.ptp(known) != 0:
            areas = np.array([np.linalg.norm(area_vectors(p.vertices, p.faces), axis=1).sum() for p in parts])
            weights = areas if areas.sum() > 0 else np.ones(len(parts))
            result[quantity] = mean = float(np.average(known, weights=weights))
            notes.append(f"{quantity} {known.min():.3g} to {known.max():.3g} replaced by its mean {mean:.3g}")
    return result, notes


def _replace_by_mean(part: MeshPart) -> MeshPart:
    assert part.material.image is not None
    counts = np.reshape(part.material.image.histogram(), (3, 256))
    mean = counts @ srgb.decode(np.arange(256) / 255) / counts.sum(1)
    color = mean if part.material.color is None else mean * part.material.color
    return replace(part, material=replace(part.material, image=None, color=color))


def _tint(parts: Sequence[MeshPart]) -> list[MeshPart]:
    """Move vertex colours beside an image into the material where they are all equal."""
    tinted: dict[tuple[SurfaceMaterial, bytes], SurfaceMaterial] = {}
    result = []
    for part in parts:
        if part.material.image is not None and part.colors is not None:
            used = part.colors[part.used]
            if (used == used[0]).all():
                color = used[0] if part.material.color is None else used[0] * part.material.color
                material = tinted.setdefault(
                    (part.material, used[0].tobytes()), replace(part.material, color=color)
                )
                part = replace(part, material=material, colors=None)
        result.append(part)
    return result


def _untextured(parts: Sequence[MeshPart]) -> dict[str, Any]:
    if all(p.colors is None for p in parts):
        if all(p.material.color is None for p in parts):
            return {}
        if len(np.unique([base_color(p) for p in parts], axis=0)) == 1:
            # A texture of one pixel, as renderers expect textures.
            count = sum(len(p.vertices) for p in parts)
            return {"uv": np.zeros((count, 2)), "texture": srgb_bytes(base_color(parts[0])).reshape(1, 1, 3)}
    colors = [
        base_color(p) * (np.ones((len(p.vertices), 1)) if p.colors is None else p.colors) for p in parts
    ]
    return {"vertex_colors": srgb_bytes(np.concatenate(colors))}


def _plain_wrap(parts: Sequence[MeshPart]) -> bool:
    """Whether repeating the texture, as renderers do, is correct for these parts."""
    if set(parts[0].material.wrap) == {"repeat"}:
        return True
    return all(p.uv is not None and p.uv[p.faces].min() >= 0 and p.uv[p.faces].max() <= 1 for p in parts)


def _limit_size(image: Image.Image | None, size: int) -> Image.Image:
    assert image is not None
    image = image.copy()
    if max(image.size) > size:
        image.thumbnail((size, size), Image.Resampling.LANCZOS)
    return image
