"""Read a mesh with its appearance from the formats that people have."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh.textured import TexturedMesh

FORMATS = (".obj", ".glb", ".gltf", ".ply")
Image.MAX_IMAGE_PIXELS = 16384**2


def default_up(path: str | Path) -> str:
    """Which axis points up where nobody says: ``y`` in glTF (by its standard), ``z`` elsewhere."""
    return "y" if Path(path).suffix.lower() in (".glb", ".gltf") else "z"


def load_mesh(path: str | Path, up: str = "z", texture_size: int = 1024) -> TexturedMesh:
    """Load a mesh, turn it z up, and scale its texture down.

    Parameters
    ----------
    path : path
        ``.obj`` (with ``.mtl`` and textures beside it), ``.glb``, ``.gltf`` or ``.ply``.
    up : {"y", "z"}
        The source's up axis.
    texture_size : int
        Longest side of the texture that is kept, pixels.

    Raises
    ------
    ObjectFolderError
        If the file is missing, of another format, unreadable, without faces, or has vertices that are
        not finite or all in one point.
    """
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"mesh file {path} does not exist; give the path of an existing mesh")
    if path.suffix.lower() not in FORMATS:
        raise ObjectFolderError(f"{path}: format {path.suffix!r} is not one of {', '.join(FORMATS)}")
    if up not in ("y", "z"):
        raise ObjectFolderError(f"{path}: up axis {up!r} is neither 'y' nor 'z'")
    try:
        scene = trimesh.load_scene(path, process=False)
        # A scan's colour is one texture; several materials are packed into one atlas.
        mesh: Any = scene.to_mesh() if scene.geometry else None
    except Exception as error:  # the readers raise whatever their format's parser raises
        raise ObjectFolderError(f"{path} cannot be read as a mesh: {error}") from error
    faces = None if mesh is None else getattr(mesh, "faces", None)
    if faces is None or len(faces) == 0:
        raise ObjectFolderError(f"{path} holds no faces; expected a triangle mesh")
    vertices = np.asarray(mesh.vertices, np.float64)
    bad = ~np.isfinite(vertices[np.unique(faces)]).all(1)
    if bad.any():
        raise ObjectFolderError(f"{path}: {bad.sum()} of its vertices are NaN or infinite; repair the mesh")
    if np.ptp(vertices[np.unique(faces)], axis=0).max() <= 0:
        raise ObjectFolderError(f"{path}: all of its vertices are in one point; expected a solid object")
    vertices = np.where(np.isfinite(vertices).all(1, keepdims=True), vertices, 0)  # of no face
    if up == "y":
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], 1)
    appearance = _appearance(mesh, texture_size)
    return TexturedMesh(vertices=vertices, faces=np.asarray(faces, np.int64), **appearance)


def _appearance(mesh: trimesh.Trimesh, texture_size: int) -> dict:
    visual: Any = mesh.visual
    if visual.kind != "texture" or visual.uv is None:
        colors = np.asarray(visual.vertex_colors)[:, :3] if visual.kind is not None else None
        return {"vertex_colors": colors}
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None:
        factor = [255, 255, 255, 255] if image is not None else material.main_color
    tint = np.asarray(factor, np.float64)[:3]
    tint = tint / 255 if np.asarray(factor).dtype.kind in "ui" else tint
    surface = _roughness_metallic(material)
    if image is None:
        color = np.clip(np.rint(tint * 255), 0, 255).astype(np.uint8)
        return {"vertex_colors": np.tile(color, (len(mesh.vertices), 1)), **surface}
    texture = image.convert("RGB")
    if max(texture.size) > texture_size:
        texture.thumbnail((texture_size, texture_size), Image.Resampling.LANCZOS)
    pixels = np.asarray(texture)
    if not np.allclose(tint, 1):
        pixels = np.clip(np.rint(pixels * tint), 0, 255).astype(np.uint8)
    return {"uv": np.asarray(visual.uv, np.float64), "texture": pixels, **surface}


def _roughness_metallic(material: object) -> dict:
    """Roughness and metallic of a PBR material; a map is reduced to its mean."""
    roughness = getattr(material, "roughnessFactor", None)
    metallic = getattr(material, "metallicFactor", None)
    maps = getattr(material, "metallicRoughnessTexture", None)
    if maps is not None:
        mean = np.asarray(maps.convert("RGB"), np.float64).mean((0, 1)) / 255
        roughness = mean[1] * (1.0 if roughness is None else roughness)
        metallic = mean[2] * (1.0 if metallic is None else metallic)
    return {
        "roughness": None if roughness is None else float(roughness),
        "metallic": None if metallic is None else float(metallic),
    }
