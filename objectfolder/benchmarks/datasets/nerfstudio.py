"""Export views of an object for Nerfstudio and others that read ``transforms.json``, Instant NGP's format."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from objectfolder.base.disk import new_folder
from objectfolder.base.io import write_json
from objectfolder.mesh.srgb import encode
from objectfolder.objectfile.file import ObjectFile
from objectfolder.objectfile.query_files import sample_views
from objectfolder.vision.cameras import Intrinsics, look_at

_BATCH = 16  # views in the memory at once

Report = Callable[[int, int], None]


def write_nerfstudio(
    file: ObjectFile,
    out: str | Path,
    views: int = 100,
    resolution: int = 256,
    seed: int = 0,
    fixed_light: bool = False,
    report: Report = lambda done, total: None,
) -> Path:
    """Write a folder ``OUT/<key>`` with ``images/*.png`` and ``transforms.json``.

    Cameras and lights are drawn as those of the training data. Images, of ``resolution`` pixels a side, are
    RGBA: sRGB, not multiplied by alpha. ``transform_matrix`` is camera-to-world (OpenGL axes) in the unit
    frame, in which the object's longest side is 1; ``scale_m`` is that side in metres. Each frame has its
    ``light_position``; with ``fixed_light``, all have the first one, as nets without light need. ``report``
    is called with the numbers of written and of all views. Returns the path of ``transforms.json``.

    Raises ObjectFolderError if the folder exists, the file answers no views, or a number is not valid.
    """
    drawn = sample_views(views, seed)
    cameras, lights = look_at(drawn[:, :3]), drawn[:, 3:]
    if fixed_light:
        lights = np.broadcast_to(lights[:1], lights.shape)
    intrinsics = Intrinsics.square(resolution)
    folder = Path(out) / file.key
    names = [f"images/frame_{i:05d}.png" for i in range(views)]
    with new_folder(f"{file.key}: export", folder, 4 * views * resolution**2 // 8, "") as new:
        (new / "images").mkdir()
        for start in range(0, views, _BATCH):
            rows = slice(start, start + _BATCH)
            answers = file.render(cameras[rows], lights[rows], intrinsics=intrinsics)
            for name, rgba in zip(names[rows], answers.rgba):
                Image.fromarray(unpremultiply(rgba)).save(new / name)
            report(min(start + _BATCH, views), views)
        frames = [
            {"file_path": name, "transform_matrix": camera.tolist(), "light_position": light.tolist()}
            for name, camera, light in zip(names, cameras, lights)
        ]
        described = {
            **{"camera_model": "OPENCV", "w": intrinsics.width, "h": intrinsics.height},
            **{"fl_x": intrinsics.fx, "fl_y": intrinsics.fy, "cx": intrinsics.cx, "cy": intrinsics.cy},
            **{"object": file.key, "material": file.material, "scale_m": file.scale, "frames": frames},
        }
        write_json(new / "transforms.json", described)
    return folder / "transforms.json"


def unpremultiply(rgba: np.ndarray) -> np.ndarray:
    """Turn linear float32 multiplied by alpha, (H, W, 4), into sRGB uint8 that is not, for PNG."""
    alpha = np.clip(rgba[..., 3:], 0, 1)
    linear = np.clip(rgba[..., :3] / np.maximum(alpha, 1e-6), 0, 1)
    return (np.concatenate([encode(linear), alpha], -1) * 255).round().astype(np.uint8)
