"""Read a mesh with its appearance from the formats that people have."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from objectfolder.errors import ObjectFolderError
from objectfolder.mesh import srgb
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


def _appearance(mesh: trimesh.Trimesh, texture_size: int) -> dict[str, Any]:
    visual: Any = mesh.visual
    if visual.kind != "texture":
        return {"vertex_colors": np.asarray(visual.vertex_colors)[:, :3] if visual.kind else None}
    material = visual.material
    pbr = isinstance(material, trimesh.visual.material.PBRMaterial)
    surface = _roughness_metallic(material) if pbr else {}
    image = material.baseColorTexture if pbr else material.image
    if image is None or visual.uv is None:
        color: Any = material.main_color[:3]
        if pbr and material.baseColorFactor is not None:  # linear, by the standard
            color = np.rint(255 * srgb.encode(material.baseColorFactor[:3] / 255))
        # A texture of one pixel: the form in which roughness and metallic survive in visual.glb.
        texel = np.asarray(color, np.uint8).reshape(1, 1, 3)
        return {"uv": np.zeros((len(mesh.vertices), 2)), "texture": texel, **surface}
    texture = image.convert("RGB")
    if max(texture.size) > texture_size:
        texture.thumbnail((texture_size, texture_size), Image.Resampling.LANCZOS)
    pixels = np.asarray(texture)
    if pbr and material.baseColorFactor is not None and (material.baseColorFactor[:3] < 255).any():
        tinted = srgb.decode(pixels / 255) * (material.baseColorFactor[:3] / 255)
        pixels = np.rint(255 * srgb.encode(tinted)).astype(np.uint8)
    return {"uv": np.asarray(visual.uv, np.float64), "texture": pixels, **surface}


def _roughness_metallic(material: Any) -> dict[str, float]:
    """Roughness and metallic of a glTF material, 1 where absent; a map is reduced to its mean."""
    factors = (material.roughnessFactor, material.metallicFactor)
    roughness, metallic = (1.0 if factor is None else float(factor) for factor in factors)
    if material.metallicRoughnessTexture is not None:
        mean = np.asarray(material.metallicRoughnessTexture.convert("RGB"), np.float64).mean((0, 1)) / 255
        roughness, metallic = roughness * float(mean[1]), metallic * float(mean[2])
    return {"roughness": roughness, "metallic": metallic}
