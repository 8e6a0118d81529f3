"""IMAGE2MESH on photographs (supplementary G): remove the background, frame, reconstruct."""

from pathlib import Path

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import atomic
from objectfolder.base.pictures import decoded
from objectfolder.benchmarks.models.framing import OBJECT, composite, frame_cutout, resize_picture
from objectfolder.benchmarks.models.shape_model import ShapeModel
from objectfolder.benchmarks.scoring.shapes import intersection_over_union
from objectfolder.mesh.srgb import decode, encode
from objectfolder.mesh.textured import y_up

FORMATS = (".obj", ".ply", ".glb")
DIFFERENCE = 30  #: smallest difference of the object from a plain background, levels of 255
OPAQUE = 250  #: alpha above which a pixel is fully covered


def read_picture(path: str | Path, mode: str = "RGBA") -> np.ndarray:
    """Read an image in its EXIF orientation; (H, W, 4) uint8, or (H, W) for mode "L".

    Raises ObjectFolderError if the file is missing or no picture.
    """
    path = Path(path)
    if not path.is_file():
        raise ObjectFolderError(f"{path} does not exist; expected an image, such as a .jpg or .png file")
    return np.asarray(decoded(path, str(path), mode, upright=True))


def cut_out(
    picture: np.ndarray,
    mask: np.ndarray | None = None,
    background: tuple[int, int, int] | None = None,
    tolerance: int = DIFFERENCE,
    name: str = "the picture",
) -> np.ndarray:
    """Remove the background of an image (H, W, 4) uint8: sRGB and straight alpha.

    Uses its alpha channel if it has one, else a mask (H, W) uint8, above 127 on the object, else the sRGB
    colour of the background: the object is then the largest connected region of which a channel differs by
    more levels than the tolerance. Returns (H, W, 4) float32, linear and premultiplied.

    Raises ObjectFolderError, with the picture's name, if nothing says what the background is, the mask is of
    another size, or no object is left.
    """
    alpha = picture[..., 3].astype(np.float32) / 255
    if (picture[..., 3] < OPAQUE).any():
        how = "its alpha"
    elif mask is not None:
        how = "the mask"
        if mask.shape != picture.shape[:2]:
            (height, width), (rows, columns) = picture.shape[:2], mask.shape
            raise ObjectFolderError(
                f"the mask has {columns} x {rows} pixels, expected {width} x {height}, those of {name}"
            )
        alpha = (mask > 127).astype(np.float32)
    elif background is not None:
        how = f"the background {','.join(map(str, background))} with tolerance {tolerance}"
        difference = np.abs(picture[..., :3].astype(np.int16) - np.array(background, np.int16)).max(-1)
        alpha = _largest(difference > tolerance).astype(np.float32)
    else:
        raise ObjectFolderError(
            f"{name}: the object is not marked; expected an image with transparency, "
            "a mask of the object (--mask), or the colour of a plain background (--background R,G,B)"
        )
    if not (alpha > OBJECT).any():
        raise ObjectFolderError(f"{name} has no foreground by {how}; check that it shows the object")
    linear = decode(picture[..., :3].astype(np.float32) / 255).astype(np.float32)
    return np.concatenate([linear * alpha[..., None], alpha[..., None]], -1)


def photograph_to_mesh(model: ShapeModel, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reconstruct the object in a framed view, by a model of IMAGE2MESH.

    The view is (S, S, 3) uint8, sRGB on white, S pixels as in the model's training views; see `frame_cutout`.
    Returns vertices (V, 3) float64, unit frame, and faces (F, 3) int64. Raises ObjectFolderError if the model
    needs more than an image, or sees no shape.
    """
    if model.setup.modalities != ("vision",):
        raise ObjectFolderError(
            f"the model was trained on {' and '.join(model.setup.modalities)}, expected one for "
            "images alone (variant V)"
        )
    vertices, faces = model.mesh(model.embed({"vision": image[None]})[0])
    if not len(faces):
        raise ObjectFolderError(
            "the model finds no shape in the image: it was trained on objects like "
            f"{', '.join(model.setup.keys[:5])}; check the mask of the object"
        )
    return vertices, faces


def check_mesh_name(path: str | Path) -> None:
    """Raise ObjectFolderError unless a mesh can be written under that name."""
    if Path(path).suffix.lower() not in FORMATS:
        raise ObjectFolderError(f"cannot write a mesh to {path}: expected a name in {', '.join(FORMATS)}")


def write_mesh(path: str | Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a mesh in the unit frame as OBJ, PLY or GLB, by the name's ending.

    A GLB is y up, as its standard demands; the others are z up, as the unit frame.
    """
    import trimesh

    check_mesh_name(path)
    kind = Path(path).suffix[1:].lower()
    upright = y_up(vertices) if kind == "glb" else vertices
    with atomic(path) as temporary:
        trimesh.Trimesh(upright, faces, process=False).export(temporary, file_type=kind)


def cluttered(height: int, width: int, rng: np.random.Generator, rectangles: int = 40) -> np.ndarray:
    """Draw a cluttered background: random rectangles with colours and stripes, and noise; linear."""
    page = np.ones((height, width, 3)) * rng.random(3)
    rows, columns = np.arange(height)[:, None], np.arange(width)
    for _ in range(rectangles):
        top, left = rng.integers(-height // 4, height), rng.integers(-width // 4, width)
        tall, wide = rng.integers(height // 16, height // 2), rng.integers(width // 16, width // 2)
        down, across = rng.normal(size=2) * 40 / height
        stripes = (np.sin(rows * down + columns * across) > 0)[..., None]
        colours = np.where(stripes, rng.random(3), rng.random(3))
        part = np.s_[max(top, 0) : max(top + tall, 0), max(left, 0) : max(left + wide, 0)]
        page[part] = colours[part]
    noisy = page + rng.normal(scale=0.05, size=(height, width, 1))
    return decode(noisy.clip(0, 1)).astype(np.float32)


def photograph_conditions(rgba: np.ndarray, side: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Composite a rendered object on white and on clutter, each both as is and cut out and framed.

    Cut-outs are made from the composite and its alpha, as with photographs: some background remains at edges.
    Takes (H, H, 4), linear and premultiplied; returns views (side, side, 3) uint8 by condition.
    """
    rgba = np.asarray(rgba, np.float32)
    alpha = rgba[..., 3:].clip(0, 1)
    backgrounds = {"white": np.ones(3, np.float32), "clutter": cluttered(rgba.shape[0], rgba.shape[1], rng)}
    images = {}
    for name, background in backgrounds.items():
        over = (rgba[..., :3] + (1 - alpha) * background).clip(0, 1)
        whole = np.concatenate([over, np.ones_like(alpha)], -1)
        picture = np.round(np.concatenate([encode(over), alpha], -1) * 255).astype(np.uint8)
        images[name] = composite(resize_picture(whole, side))
        images[f"{name}, removed"] = frame_cutout(cut_out(picture), side)
    return images


def photograph_scores(
    model: ShapeModel, rgba: np.ndarray, points: np.ndarray, inside: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Compute the IoU (N,) of reconstructions from another renderer's images, by `photograph_conditions`.

    Images (N, H, H, 4) are linear and premultiplied, none empty; points (P, 3) uniform, in the unit frame;
    ``inside``, (N, P) or (P,) bool, tells whether they are inside the object of each picture.
    """
    pictures = [photograph_conditions(one, model.setup.view, rng) for one in rgba]
    return {
        name: view_scores(model, np.stack([conditions[name] for conditions in pictures]), points, inside)
        for name in pictures[0]
    }


def view_scores(model: ShapeModel, images: np.ndarray, points: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Compute the IoU of reconstructions from views (N, S, S, 3) uint8; (N,)."""
    return intersection_over_union(model.is_inside(model.embed({"vision": images}), points), inside)


def _largest(marked: np.ndarray) -> np.ndarray:
    """Return the largest connected component of marked pixels (H, W)."""
    from scipy.ndimage import label

    parts, count = label(marked, np.ones((3, 3)))
    if not count:
        return marked
    sizes = np.bincount(parts.ravel())
    return parts == 1 + int(sizes[1:].argmax())
