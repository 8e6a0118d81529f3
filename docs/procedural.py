"""Draw docs/procedural.png and docs/thin.png, every object of both catalogues: `docs/procedural.py`."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from objectfolder.base.figures import tile
from objectfolder.base.io import atomic
from objectfolder.mesh.textured import TexturedMesh
from objectfolder.shapes import generate
from objectfolder.vision.cameras import Intrinsics, look_at, project
from objectfolder.vision.color import on_white
from objectfolder.vision.renderers.mitsuba import MitsubaRenderer
from objectfolder.vision.scene import Scene
from objectfolder.workspace import params

DOCS = Path(__file__).parent
CATALOGUES = ("procedural", "thin")
COLUMNS, SIZE, CAPTION = 10, 128, 28  # thumbnails per row; their side and the height of the caption, pixels
SAMPLES, TEXTURE_SIZE = 64, 512
FILL = 0.94  # part of a thumbnail that the object spans
CAMERA = np.array([[1.3, -2.2, 1.35]])
#: Positions and powers: key light beside the camera, fill light behind it, light from above.
LIGHTS = [((3.0, -3.0, 4.0), 0.75), ((0.8, -4.5, 1.2), 0.35), ((-3.5, 0.5, 3.0), 0.3)]


def main() -> None:
    for name in CATALOGUES:
        catalogue = DOCS.parent / f"catalogs/{name}.yaml"
        pictures = [
            add_caption(render_thumbnail(key, catalogue), key, entry["material"], entry["scale"])
            for key, entry in params.read(catalogue)["objects"].items()
        ]
        page = Image.fromarray(tile(np.stack(pictures), COLUMNS))
        with atomic(DOCS / f"{name}.png") as path:
            page.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)


def render_thumbnail(key: str, catalogue: Path) -> np.ndarray:
    """Render an object of a catalogue so that it fills the thumbnail; (SIZE, SIZE, 3) uint8."""
    generator, parameters = params.procedural_entry(key, catalogue)
    mesh = in_unit_frame(generate(generator, **parameters | {"texture_size": TEXTURE_SIZE}))
    pose = look_at(CAMERA)[0]
    at, _ = project(mesh.vertices, pose, Intrinsics(2, 2, 1.0))
    intrinsics = Intrinsics(SIZE, SIZE, FILL * SIZE / 2 / np.abs(at - 1).max())
    renderer = MitsubaRenderer(Scene(mesh))
    image = np.zeros((SIZE, SIZE, 4), np.float32)
    for seed, (light, power) in enumerate(LIGHTS):
        view = renderer.render(pose, np.array(light), intrinsics, SAMPLES, seed)
        image[..., :3] += power * np.dot(light, light) * view[..., :3]
        image[..., 3] = view[..., 3]
    return (on_white(torch.from_numpy(image)).numpy() * 255).round().astype(np.uint8)


def in_unit_frame(mesh: TexturedMesh) -> TexturedMesh:
    """Centre a mesh and scale its longest side to 1."""
    lower, upper = mesh.bounds
    return mesh.with_vertices((mesh.vertices - (lower + upper) / 2) / (upper - lower).max())


def add_caption(picture: np.ndarray, key: str, material: str, scale: float) -> np.ndarray:
    """Add the object's key, material and size below a picture; (SIZE + CAPTION, SIZE, 3) uint8."""
    image = Image.new("RGB", (SIZE, SIZE + CAPTION), "white")
    image.paste(Image.fromarray(picture))
    draw = ImageDraw.Draw(image)
    lines = ((key, 12, "#202020"), (f"{material}, {scale * 100:.3g} cm", 10, "#707070"))
    for line, (text, size, color) in enumerate(lines):
        middle = (SIZE / 2, SIZE + 13 * line)
        draw.text(middle, text, fill=color, font=ImageFont.load_default(size), anchor="mt")
    return np.asarray(image)


if __name__ == "__main__":
    main()
