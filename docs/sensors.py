"""Draw docs/sensors.png, every sensor profile untouched and pressed on objects: `python docs/sensors.py`."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

from objectfolder.base.io import atomic
from objectfolder.mesh.closing.surface import close_surface
from objectfolder.mesh.raycast import RayCaster
from objectfolder.shapes import generate
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, available_profiles, load_profile
from objectfolder.touch.simulate import touch_images

DOCS = Path(__file__).parent
HEIGHT, CAPTION = 240, 24  # pixels: an image, the caption above a row
BALL = 0.005  # m, radius
DIE = 0.03  # m, longest side
DEPTH = 0.001  # m


def main() -> None:
    rows = [captioned(row(profile), profile) for profile in map(load_profile, available_profiles())]
    width = max(picture.shape[1] for picture in rows)
    page = np.concatenate(
        [np.pad(p, ((0, 6), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in rows]
    )
    with atomic(DOCS / "sensors.png") as path:
        Image.fromarray(page).save(path, optimize=True)


def row(profile: SensorProfile) -> np.ndarray:
    """Render a sensor untouched, then pressed on a ball, on the pips and on a corner of a die."""
    optics = Optics(profile)
    ball = trimesh.creation.icosphere(6, radius=BALL)
    die = generate("die", texture_size=64)
    die = close_surface(die.vertices, die.faces)
    lower, upper = die.vertices.min(0), die.vertices.max(0)
    corners = (die.vertices - (lower + upper) / 2) / (upper - lower).max() * DIE
    corner = corners[np.argmax(corners.sum(axis=1))]
    images = [optics.background.numpy()]
    for vertices, faces, point, normal in (
        (ball.vertices, ball.faces, (0, 0, BALL), (0, 0, 1)),
        (corners, die.faces, (0, 0, DIE / 2), (0, 0, 1)),
        (corners, die.faces, corner, np.ones(3) / np.sqrt(3)),
    ):
        caster = RayCaster(np.asarray(vertices), np.asarray(faces))
        touched = touch_images(
            caster, np.array([point]), np.array([normal]), np.array([0.3]), np.array([DEPTH]), profile, optics
        )
        images.append(touched[0][0])
    size = (round(HEIGHT * profile.width / profile.height), HEIGHT)
    return np.concatenate([np.asarray(Image.fromarray(image).resize(size)) for image in images], axis=1)


def captioned(picture: np.ndarray, profile: SensorProfile) -> np.ndarray:
    """Add the sensor's name and size above a picture."""
    width, height = (1000 * profile.pixel_pitch * n for n in (profile.width, profile.height))
    text = f"{profile.name}: {width:.1f} x {height:.1f} mm, {profile.width} x {profile.height} pixels"
    page = Image.new("RGB", (picture.shape[1], CAPTION + picture.shape[0]), "white")
    ImageDraw.Draw(page).text((4, 4), text, "black", ImageFont.load_default(14))
    page.paste(Image.fromarray(picture), (0, CAPTION))
    return np.asarray(page)


if __name__ == "__main__":
    main()
