"""Draw docs/turntable.webp, three samples that turn under the studio's light: `python docs/turntable.py`."""

from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder import ObjectFile
from objectfolder.io import atomic
from objectfolder.objectfile.samples import available_samples
from objectfolder.vision.lighting import studio

FRAMES, SIZE, MILLISECONDS = 48, 224, 80
DISTANCE, HEIGHT = 2.2, 1.1  # of the camera, unit frame
SIDE, SWING = 45, 40  # of the main light from the camera, degrees


def main() -> None:
    turns = 2 * np.pi * np.arange(FRAMES) / FRAMES
    objects = [ObjectFile.sample(name) for name in reversed(available_samples())]
    frames = []
    for turn in turns:
        around = turn - 0.6
        camera = [DISTANCE * np.cos(around), DISTANCE * np.sin(around), HEIGHT]
        # The lights follow the camera and swing, so that no side that it sees is ever unlit.
        lights = studio(azimuth=np.degrees(around) + SIDE + SWING * np.sin(turn))
        images = [file.view(camera, resolution=SIZE, lights=lights)[0] for file in objects]
        frames.append(Image.fromarray((np.concatenate(images, 1) * 255).round().astype(np.uint8)))
    with atomic(Path(__file__).parent / "turntable.webp") as path:
        frames[0].save(
            path, "WEBP", save_all=True, append_images=frames[1:], duration=MILLISECONDS, loop=0, quality=70
        )


if __name__ == "__main__":
    main()
