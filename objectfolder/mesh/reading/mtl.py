"""Read Wavefront material libraries (``.mtl``): diffuse colours and textures, roughness, metallic."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.mesh import srgb
from objectfolder.mesh.reading.files import (
    find_referenced,
    read_image,
    read_referenced,
    referenced_path,
)
from objectfolder.mesh.reading.parts import SurfaceMaterial
from objectfolder.mesh.reading.text import DECIMAL_COMMAS, decode_text, has_decimal_commas

MAP = re.compile(r"map_\w+|bump|disp|decal|norm|refl", re.I)
LINE_END = re.compile(r"[\r\n]+")
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?=\s)"
MAX_WORDS = 8  # of unknown options before a file name
#: One option before a file name, with as many arguments as the standard gives it, or fewer numbers.
OPTION = re.compile(
    rf"-(?:([ost])((?:\s++{NUMBER}){{0,3}})|(mm)((?:\s++{NUMBER}){{1,2}})"
    r"|(blend[uv]|boost|bm|cc|clamp|colorspace|imfchan|texres|type)\s++(\S+))\s++",
    re.I,
)
DROPPED_MAPS = {
    "map_d": "transparency",
    "bump": "bump map",
    "map_bump": "bump map",
    "norm": "normal map",
    "disp": "displacement map",
    "map_ke": "emissive map",
    "refl": "reflection map",
}
#: Statements with numbers that are dropped, unless they are 0.
DROPPED_VALUES = {
    "ke": "emission",
    "tf": "transmission filter Tf",
    "ps": "sheen",
    "pc": "clearcoat",
    "aniso": "anisotropy",
}
NUMERIC = {"kd", "d", "tr", "pr", "pm"}  # statements that are read
DROPPED_OPTIONS = ("t", "mm", "cc", "imfchan")  # of a texture: they change its colours or its place


@dataclass(frozen=True)
class MtlMaterial:
    """Material of a library."""

    surface: SurfaceMaterial = field(default_factory=SurfaceMaterial)
    scale: np.ndarray = field(default_factory=lambda: np.ones(2))  #: texture coordinates times this, plus
    offset: np.ndarray = field(default_factory=lambda: np.zeros(2))  #: this are those of the image
    dropped: frozenset[str] = frozenset()  #: what of its appearance is not supported, in words

    def image_coordinates(self, uv: np.ndarray) -> np.ndarray:
        """Convert texture coordinates (V, 2) of the mesh to those of the image."""
        if (self.scale == 1).all() and (self.offset == 0).all():
            return uv
        return uv * self.scale + self.offset


class MaterialLibraries:
    """Materials of the libraries that a mesh names, in order; textures are read when faces use them.

    Raises
    ------
    ObjectFolderError
        If a library is missing or unreadable.
    """

    def __init__(self, mesh: Path, libraries: list[str]):
        self.mesh = mesh
        self.statements: dict[str, dict[str, str]] = {}  # of each material, the last of each keyword
        self.folders: dict[str, PurePosixPath] = {}  # of its library, relative to the mesh's
        self.image = cache(self._image)
        for library in libraries:
            path = find_referenced(mesh, library)
            current: dict[str, str] = {}
            for keyword, rest in _statements(read_library(mesh, path)):
                if keyword.lower() == "newmtl":
                    name = " ".join(rest.split())
                    current = self.statements[name] = {}
                    self.folders[name] = path.parent
                else:
                    current[keyword.lower()] = rest

    def material(self, name: str) -> MtlMaterial:
        """Return a material with its texture; a plain one if there is none of this name.

        Raises
        ------
        ObjectFolderError
            If the texture is missing or unreadable.
        """
        lines = self.statements.get(name)
        if lines is None:
            return MtlMaterial()
        for key in NUMERIC & lines.keys():
            if has_decimal_commas(lines[key].encode()):
                said = shortened(f"{key.capitalize()} {lines[key]}")
                raise ObjectFolderError(f"{self.mesh}: {said!r} of material {name} has {DECIMAL_COMMAS}")
        options, file = _options(lines.get("map_kd", ""))
        dropped = _list_dropped(lines) | {
            f"option -{key} of map_Kd" for key in DROPPED_OPTIONS if key in options
        }
        if not options.get("colorspace", "sRGB").lower().startswith("srgb"):
            dropped |= {"option -colorspace of map_Kd"}
        roughness, metallic = _fraction(lines.get("pr", "")), _fraction(lines.get("pm", ""))
        if file:
            wrap = "clamp" if options.get("clamp", "").lower() == "on" else "repeat"
            image, transparent = self.image(texture_path(self.mesh, self.folders[name], file))
            dropped |= {"alpha of map_Kd"} if transparent else set()
            surface = SurfaceMaterial(image, None, roughness, metallic, (wrap, wrap))
        else:
            surface = SurfaceMaterial(None, _color(_floats(lines.get("kd", ""))), roughness, metallic)
        scale, offset = _numbers(options.get("s", ""), 1), _numbers(options.get("o", ""), 0)
        return MtlMaterial(surface, scale, offset, frozenset(dropped))

    def _image(self, path: PurePosixPath) -> tuple[Image.Image, bool]:
        """Return an image without its alpha, and whether that was less than 1 anywhere."""
        data, name = read_referenced(self.mesh, path), self.mesh.parent / path
        image = read_image(data, name, self.mesh, "RGBA")
        return image.convert("RGB"), bool((np.asarray(image.getchannel("A")) < 255).any())


def read_library(mesh: Path, path: PurePosixPath) -> str:
    """Read the text of a material library, given its path relative to the mesh's folder."""
    return decode_text(read_referenced(mesh, path, "put it there, or delete the line mtllib"))


def texture_path(mesh: Path, beside: PurePosixPath, name: str) -> PurePosixPath:
    """Return the path of a texture relative to the mesh's folder: beside its library, or else the mesh.

    The name counts as it is written, or else as `strip_comment`, without options that are not of the
    standard, or in other case, if only that file exists. It is looked up as `find_referenced` does. Raises
    `ObjectFolderError` if it lies elsewhere, or its name is too long.
    """
    spellings = [name]
    if name.startswith("-"):
        spellings += [rest for n in range(1, MAX_WORDS) for rest in name.split(maxsplit=n)[n:]]
    spellings += map(strip_comment, tuple(spellings))
    for any_case in (False, True):
        for folder in dict.fromkeys((beside, PurePosixPath())):
            for written in dict.fromkeys(spellings):
                with suppress(ObjectFolderError, OSError):  # outside, or too long
                    path = find_referenced(mesh, written, folder, ".mtl", any_case)
                    if (mesh.parent / path).is_file():
                        return path
    return referenced_path(mesh, name, beside, ".mtl")


def textures(mtl: str) -> list[tuple[str, str]]:
    """Return the maps in the text of an ``.mtl``: statement, such as ``map_Kd``, and file name."""
    maps = [(keyword, _options(rest)[1]) for keyword, rest in _statements(mtl) if MAP.fullmatch(keyword)]
    return [(keyword, name) for keyword, name in maps if name]


def _statements(mtl: str) -> Iterator[tuple[str, str]]:
    """Yield the first word and the rest of every line that has more than one word."""
    for line in LINE_END.split(mtl):  # of no other characters: in Latin-1, some names have them
        words = line.strip().split(maxsplit=1)
        if len(words) == 2:
            yield words[0], words[1]


def _options(rest: str) -> tuple[dict[str, str], str]:
    """Split what follows the keyword of a map into options, lower case, and the file's name."""
    options, start = {}, 0
    while match := OPTION.match(rest, start):
        (key, value) = (part for part in match.groups() if part is not None)
        options[key.lower()] = value
        start = match.end()
    return options, rest[start:]


def strip_comment(name: str) -> str:
    """Return a name without quotes and a comment after it, ``# such as this``; ``Material #25`` has none."""
    return re.split(r"\s#(?!\S)", name, maxsplit=1)[0].strip().strip('"')


def _numbers(text: str, default: float) -> np.ndarray:
    """Return the first two of one to three numbers, (2,)."""
    return np.array([*map(float, text.split()), default, default])[:2]


def _floats(text: str) -> np.ndarray:
    """Return the numbers of a statement, none if it has other words."""
    try:
        values = np.array(text.partition("#")[0].split(), np.float64)
    except ValueError:
        return np.zeros(0)
    return values if np.isfinite(values).all() else np.zeros(0)


def _fraction(text: str) -> float | None:
    """Return the number of a statement, clipped to [0, 1]; None unless it has one."""
    values = _floats(text)
    return float(np.clip(values[0], 0, 1)) if values.size == 1 else None


def _color(values: np.ndarray) -> np.ndarray | None:
    """Decode an sRGB colour in steps of 1/255, as textures are; one number is a grey."""
    if values.size not in (1, 3):
        return None
    linear: np.ndarray = srgb.decode(np.rint(255 * np.clip(np.broadcast_to(values, 3), 0, 1)) / 255)
    return linear


def _list_dropped(lines: dict[str, str]) -> set[str]:
    """Name what a material's statements say that is not supported."""
    dropped = {DROPPED_MAPS.get(key, key) for key in lines if MAP.fullmatch(key) and key != "map_kd"}
    dropped |= {what for key, what in DROPPED_VALUES.items() if _floats(lines.get(key, "")).any()}
    opacity = _floats(lines["d"]) if "d" in lines else 1 - _floats(lines.get("tr", "0"))
    if not (opacity == 1).all():
        dropped.add("transparency")
    if "kd" in lines and _color(_floats(lines["kd"])) is None:
        dropped.add("Kd other than three numbers")
    return dropped
