"""Render views with Blender's Cycles, the paper's renderer, in one separate process for all views."""

import importlib.util
import json
import shutil
import subprocess
import sys
import weakref
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from objectfolder.base.errors import ObjectFolderError
from objectfolder.vision.cameras import Intrinsics
from objectfolder.vision.renderers import blender_scene
from objectfolder.vision.scene import BOUNCES, LIGHT_INTENSITY, SPECULAR, Scene

MIN_SIDE = 4  #: shortest side of an image that Blender renders, pixels
SHOWN_LINES = 8  # of Blender's output, in an error


class CyclesRenderer:
    """Path tracer on the CPU: one thread, box filter, no denoising.

    Blender runs in a separate process: it needs its own numpy, and its licence is the GPL. Raises ImportError
    if neither the module bpy nor a program blender on the PATH is found, ObjectFolderError if Blender does
    not start or is too old.
    """

    def __init__(self, scene: Scene):
        command = blender_command()
        resources = ExitStack()
        weakref.finalize(self, resources.close)
        self._folder = Path(resources.enter_context(TemporaryDirectory(prefix="objectfolder-cycles-")))
        write_scene(scene, self._folder)
        self._log = resources.enter_context((self._folder / "blender.log").open("w+"))
        command, pipe = [*command, str(self._folder)], subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._log, text=True)
        resources.callback(_end, self._process)
        self._printed: list[str] = []
        self.version = f"cycles {self._wait('start').removeprefix(blender_scene.DONE).strip()} cpu"

    def render(
        self, camera_to_world: np.ndarray, light: np.ndarray, intrinsics: Intrinsics, samples: int, seed: int
    ) -> np.ndarray:
        """Render one view; see `objectfolder.vision.renderers.registry.Renderer`."""
        # Pad small images to Blender's smallest size.
        rows, columns = (max(MIN_SIDE - n + 1, 0) // 2 for n in (intrinsics.height, intrinsics.width))
        width, aspect = intrinsics.width + 2 * columns, intrinsics.fx / intrinsics.fy  # aspect: of a pixel
        off_center = intrinsics.width / 2 - intrinsics.cx, aspect * (intrinsics.cy - intrinsics.height / 2)
        view = {
            "camera_to_world": np.asarray(camera_to_world).tolist(),
            "light": np.asarray(light).tolist(),
            "width": width,
            "height": intrinsics.height + 2 * rows,
            "focal": intrinsics.fx,
            "shift": [pixels / width for pixels in off_center],
            "pixel_aspect": [max(1, 1 / aspect), max(1, aspect)],  # Blender requires at least 1
            "samples": samples,
            "seed": seed % 2**31,
        }
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # of a Blender that has ended: _wait reports why
            self._process.stdin.write(json.dumps(view) + "\n")
            self._process.stdin.flush()
        self._wait("render")
        padded = np.load(self._folder / "image.npy", allow_pickle=False)
        image = padded[rows : rows + intrinsics.height, columns : columns + intrinsics.width]
        return np.ascontiguousarray(image)

    def _wait(self, what: str) -> str:
        """Read Blender's output up to the line that starts with `DONE`, and return that line."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(blender_scene.DONE):
                return line
            self._printed = [*self._printed, line.strip()][-SHOWN_LINES:]
        code = self._process.wait()
        self._log.seek(0)
        said = [line.strip() for line in [*self._printed, *self._log] if line.strip()]
        raise ObjectFolderError(
            f"Blender ended with {code} before it could {what}: {' | '.join(said[-SHOWN_LINES:])}"
        )


def blender_command() -> list[str]:
    """Return the command that runs ``blender_scene`` in Blender; append the folder as its last argument.

    Raises ImportError if Blender is not found.
    """
    script = blender_scene.__file__
    if importlib.util.find_spec("bpy"):
        return [sys.executable, "-P", script]  # -P: modules beside the script would shadow Blender's
    blender = shutil.which("blender")
    if blender is None:
        raise ImportError("neither the module bpy nor a program blender on the PATH")
    return [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python", script, "--"]


def write_scene(scene: Scene, folder: Path) -> None:
    """Write the input of ``blender_scene``: ``scene.json``, ``mesh.npz`` and, if any, ``texture.png``."""
    mesh = scene.mesh
    uv = np.zeros((0, 2)) if mesh.uv is None else mesh.uv
    normals = np.zeros((0, 3)) if mesh.normals is None else mesh.normals
    colors = np.pad(scene.vertex_colors, ((0, 0), (0, 1)), constant_values=1)
    np.savez(
        folder / "mesh.npz",
        vertices=mesh.vertices.astype(np.float32),
        faces=mesh.faces.astype(np.int32),
        uv=uv.astype(np.float32),
        normals=normals.astype(np.float32),
        colors=colors,
    )
    look = {"roughness": scene.roughness, "metallic": scene.metallic, "specular": SPECULAR}
    light = {"ambient": scene.ambient, "light_intensity": LIGHT_INTENSITY, "bounces": BOUNCES}
    settings = look | light | {"textured": scene.base_color == "texture"}
    (folder / "scene.json").write_text(json.dumps(settings))
    if scene.base_color == "texture":
        assert mesh.texture is not None
        Image.fromarray(mesh.texture).save(folder / "texture.png")


def _end(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(BrokenPipeError):
        process.stdin.close()  # ends the script's loop
    process.stdout.close()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
