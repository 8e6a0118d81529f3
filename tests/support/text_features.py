"""A file for each row of docs/formats.csv about OBJ, MTL, STL, PLY and OFF."""

import struct
import unicodedata

import numpy as np
import pytest
from gltf_scene import colors_at
from PIL import Image

ROWS = {}  #: functions of a folder, by format and feature
RED, GREEN, BLUE, GREY = (255, 0, 0), (0, 255, 0), (0, 0, 255), (203, 203, 203)
SKIN = (10, 200, 30)  # of every texture
V = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"  # a square
F, HALVES = "f 1 2 3 4\n", "f 1 2 3\nusemtl b\nf 1 3 4\n"
VT = "vt 0.5 0.5\n"
MAPPED = "mtllib m.mtl\nusemtl a\n" + V + VT + "f 1/1 2/1 3/1 4/1\n"
PLAIN = "mtllib m.mtl\nusemtl a\n" + V + F


def row(format, feature, content, colors=None, mtl="newmtl a\nmap_Kd t.png\n", texture="t.png"):
    """Register a file in text or bytes of a square with these colours, None: it has none."""

    def build(folder):
        suffix = "obj" if format == "MTL" else format.lower()
        path = folder / f"m.{suffix}"
        for file, data in ((path, content), (folder / "m.mtl", mtl)):
            file.write_bytes(data if isinstance(data, bytes) else data.encode())
        Image.new(
            "RGBA" if texture == "a.png" else "RGB", (4, 4), (*SKIN, 9)[: 4 if texture == "a.png" else 3]
        ).save(folder / texture)
        return path, check

    def check(mesh):
        a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(1)
        if colors is None:
            assert mesh.texture is mesh.vertex_colors is None
        else:
            found = np.unique(np.rint(colors_at(mesh)), axis=0)
            np.testing.assert_allclose(found, sorted(colors), atol=2)

    ROWS[format, feature] = build


def colored(*colors, after=""):
    places = V.splitlines()
    return "".join(f"{place} {color}{after}\n" for place, color in zip(places, colors))


def mtl(feature, lines, colors=(RED,), mapped=False, texture="t.png"):
    text = lines if isinstance(lines, bytes) else f"newmtl a\n{lines}\n"
    row("MTL", feature, MAPPED if mapped else PLAIN, colors, text, texture)


row(
    "OBJ",
    "polygons, also concave ones; indices from the start or back; lines and points",
    V + "l 1 2\np 1\nf -4 -3 -2 -1\n",
)
row(
    "OBJ",
    "text in UTF-8, UTF-16 or Latin-1, any line ends, lines that go on",
    (V + F).replace("f ", "f \\\n").replace("\n", "\r").encode("utf-16"),
)
row("OBJ", "`vt` of one, two or three numbers", MAPPED.replace(VT, "vt 0.5\n"), [SKIN])
row(
    "OBJ",
    "normals that are not numbers, such as `1.#IND`",
    V + "vn 1.#IND -1.#IND nan\nf 1//1 2//1 3//1 4//1\n",
)
row(
    "OBJ",
    "vertex colours on all or some vertices, 0 to 1 or 0 to 255",
    colored("0 0 255", "0 0 255", "0 0 255", "0 0 255") + "v 9 9 9\n" + F,
    [BLUE],
)
row("OBJ", "`#MRGB` of ZBrush", V + "#MRGB " + "ff0000ff" * 4 + "\n" + F, [BLUE])
row("OBJ", "alpha of vertex colours", colored(*["0 0 1"] * 4, after=" 0.5") + F, [BLUE])
row("OBJ", "weights (`v x y z w`)", colored(*["0.5"] * 4) + F)
row(
    "OBJ",
    "a texture and vertex colours on the same faces",
    "mtllib m.mtl\nusemtl a\n" + colored(*["0 0 1"] * 4) + VT + "f 1/1 2/1 3/1 4/1\n",
    [SKIN],
)
row(
    "OBJ",
    "a texture and vertex colours on different faces",
    "mtllib m.mtl\nusemtl a\n"
    + V
    + VT
    + "f 1/1 2/1 3/1\n"
    + colored("0 0 1", "0 0 1", "0 0 1", "0 0 1")
    + "f 5 7 8\n",
    [BLUE, SKIN],
)
row(
    "OBJ",
    "white vertex colours beside `Kd`",
    "mtllib m.mtl\nusemtl a\n" + colored(*["1 1 1"] * 4) + F,
    [RED],
    "newmtl a\nKd 1 0 0\n",
)
row("OBJ", "a texture on faces without coordinates", PLAIN, [SKIN])
row("OBJ", "materials that no library has", V + "usemtl a\n" + F)
row("OBJ", "curved surfaces", V + F + "cstype bezier\nsurf 0 1 0 1 1 2 3 4\nend\n")
row("OBJ", "decimal commas", (V + F).replace("1", "1,5", 1))
mtl("`Kd`, also one number; `Pr` and `Pm`", "Kd 1 0 0 # red\nPr 0.5\nPm 0")
mtl(
    "`map_Kd` in place of `Kd`; options `-s`, `-o`, `-clamp`",
    "Kd 1 0 0\nmap_Kd -s 2 2 2 -o 1 -clamp on t.png",
    [SKIN],
    True,
)
mtl(
    "options without effect: `-blendu`, `-blendv`, `-boost`, `-texres`, `-bm`, `-type`, `-colorspace sRGB`",
    "map_Kd -blendu on -blendv on -boost 2 -texres 8 -bm 1 -type sphere -colorspace sRGB t.png",
    [SKIN],
    True,
)
mtl("options `-mm`, `-t`, `-cc`, `-imfchan`", "map_Kd -mm 0 1 -t 1 -cc on -imfchan r t.png", [SKIN], True)
mtl("another `-colorspace`", "map_Kd -colorspace linear t.png", [SKIN], True)
mtl(
    "names with spaces, quotes, backslashes, in other case or another form of Unicode; UTF-16",
    'newmtl a\nmap_Kd ".\\\\T ö.PNG"\n'.encode("utf-16-le"),
    [SKIN],
    True,
    unicodedata.normalize("NFD", "t ö.png"),
)
mtl("alpha of `map_Kd`", "map_Kd a.png", [SKIN], True, "a.png")
mtl("`d`, `Tr`, `map_d`", "Kd 1 0 0\nd 0.5\nmap_d t.png")
mtl("`bump`, `norm`, `disp`", "Kd 1 0 0\nbump t.png\nnorm t.png\ndisp t.png")
mtl("`Ke`, `map_Ke`", "Kd 1 0 0\nKe 1 1 1\nmap_Ke t.png")
mtl("`Tf`, `Ps`, `Pc`, `aniso`, `refl`", "Kd 1 0 0\nTf 1 1 1\nPs 1\nPc 1\naniso 1\nrefl t.png")
mtl("other maps, such as `map_Ks` and `map_Pr`", "Kd 1 0 0\nmap_Ks t.png\nmap_Pr t.png")
mtl("`Ka`, `Ks`, `Ns`, `Ni`, `illum`", "Kd 1 0 0\nKa 1 1 1\nKs 1 1 1\nNs 9\nNi 1\nillum 2")
mtl("`Kd` as `spectral` or `xyz`", "Kd spectral a.rfl", None)
mtl("decimal commas", "Kd 0,5 0,5 0,5")

LOOP = "outer loop\nvertex {} 0 0\nvertex 1 {} 0\nvertex 0 1 0\nendloop\nendfacet\n"
FACETS = [f"facet normal 0 0 1\n{LOOP.format(*pair)}" for pair in ((0, 0), (1, 1))]
SOLID = "solid my vertex 1\n{}endsolid\nsolid\n{}"
row(
    "STL",
    "text: any case, names and number of solids, without `endsolid`; UTF-16",
    SOLID.format(*FACETS).upper().encode("utf-16"),
)
row("STL", "text: normals, also `-1.#IND`", SOLID.format(*FACETS).replace("0 0 1\n", "-1.#IND 0 0\n"))
row("STL", "text: colours", SOLID.format(*FACETS).replace("outer", "color 1 0 0\nouter"))
row("STL", "text that breaks off", SOLID.format(*FACETS)[:-40])
row("STL", "text with decimal commas", SOLID.format(*FACETS).replace(" 1 ", " 1,0 "))
CORNERS = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]]


def facets(header=b"solid", words=(0, 0), count=2, after=b""):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(c), word) for c, word in zip(CORNERS, words))
    return header.ljust(80) + struct.pack("<I", count) + body + after


row("STL", "binary: any header, also `solid`; fewer than 50 bytes after the facets", facets(after=bytes(49)))
row("STL", "binary: more bytes after the facets", facets(after=bytes(60)))
row("STL", "binary: 0 or 0xFFFFFFFF facets, but data", facets(count=0))
row(
    "STL",
    "binary: colours of Magics (`COLOR=` in the header)",
    facets(b"COLOR=\xff\0\0\xff", (0xFFFF, 31 << 10)),
    [RED, BLUE],
)
row(
    "STL",
    "binary: colours of VisCAM (highest bit set)",
    facets(words=(0x801F, 0x8000 | 31 << 10)),
    [RED, BLUE],
)
row("STL", "binary: other attributes", facets(words=(1, 2)))
row("STL", "binary that breaks off", facets(count=3))

POINTS = ("0 0 0", "1 0 0", "1 1 0", "0 1 0")
WORDS = ("red", "green", "blue")


def ply(vertex=(), face=(), points="", polygons=("4 0 1 2 3",), head="", more=("", ""), element="face"):
    def properties(names):
        return "".join(f"property {name}\n" for name in names)

    rows = [*(f"{point} {points}" for point in POINTS), *polygons]
    face = ["list uchar int vertex_index", *face]
    return (
        f"ply\nformat ascii 1.0\n{head}element vertex 4\n{properties(f'float {axis}' for axis in 'xyz')}"
        f"{properties(vertex)}element {element} {len(polygons)}\n{properties(face)}"
        f"{more[0]}end_header\n" + "\n".join(rows) + "\n" + more[1]
    )


def binary(big):
    order = ">" if big else "<"
    head = ply(polygons=("", ""), more=("element extra 0\nproperty float a\n", "")).partition("end_header\n")
    head = head[0].replace("ascii", "binary_big_endian" if big else "binary_little_endian") + head[1]
    body = struct.pack(order + "12f", *np.ravel([p.split() for p in POINTS]).astype(float))
    return (
        head.encode()
        + body
        + struct.pack(order + "B3i", 3, 0, 1, 2)
        + struct.pack(order + "B3i", 3, 0, 2, 3)
        + b"\n\0 more"
    )


row("PLY", "text, also UTF-16; words and lines after the data", ply(more=("", "end")).encode("utf-16"))
row("PLY", "binary in either order of bytes; elements in any order; bytes after the data", binary(True))
row(
    "PLY",
    "polygons of different sizes; lists of any type, as `vertex_index` or `vertex_indices`",
    ply(polygons=("3 0 1 2", "4 0 2 3 3")),
)
row("PLY", "`tristrips`", ply(polygons=("4 0 1 3 2",), element="tristrips"))
row(
    "PLY",
    "vertex colours (`red`, `diffuse_red`, `r`), in bytes, words or fractions",
    ply([f"float diffuse_{w}" for w in WORDS], points="0 0 1"),
    [BLUE],
)
row(
    "PLY",
    "colours of faces",
    ply(face=[f"uchar {w}" for w in WORDS], polygons=("3 0 1 2 255 0 0", "3 0 2 3 0 0 255")),
    [BLUE, RED],
)
row(
    "PLY",
    "colours of vertices and faces",
    ply([f"uchar {w}" for w in WORDS], [f"uchar {w}" for w in WORDS], "0 0 255", ("4 0 1 2 3 255 0 0",)),
    [BLUE],
)
row("PLY", "alpha of colours", ply([f"uchar {w}" for w in (*WORDS, "alpha")], points="0 0 255 9"), [BLUE])
row(
    "PLY",
    "colours of other elements",
    ply(more=("element material 1\n" + "".join(f"property uchar {w}\n" for w in WORDS), "1 2 3\n")),
)
TEXTURED = {"head": "comment TextureFile t.png\n"}
row(
    "PLY",
    "a texture, with coordinates of vertices or of faces' corners (`texcoord`)",
    ply(face=["list uchar float texcoord"], polygons=("4 0 1 2 3 8 .5 .5 .5 .5 .5 .5 .5 .5",), **TEXTURED),
    [SKIN],
)
row(
    "PLY",
    "a texture, and faces without coordinates",
    ply(
        face=["list uchar float texcoord"], polygons=("3 0 1 2 6 .5 .5 .5 .5 .5 .5", "3 0 2 3 0"), **TEXTURED
    ),
    [SKIN],
)
row("PLY", "a texture, but no coordinates", ply(**TEXTURED))
row(
    "PLY",
    "a texture and colours",
    ply(["float s", "float t", *(f"uchar {w}" for w in WORDS)], points="0 0 1 2 3", **TEXTURED),
    [SKIN],
)
row("PLY", "several textures", ply(head="comment TextureFile t.png\ncomment TextureFile u.png\n"))
row("PLY", "points alone, such as Gaussian splats", ply(polygons=()))
row("PLY", "data that break off", ply().rpartition("4 0")[0])
row("PLY", "decimal commas", ply().replace("1 0 0", "1,0 0 0"))

SQUARE = "4 1 0\n" + "\n".join(POINTS) + "\n4 0 1 2 3"
row(
    "OFF",
    "`OFF`, `NOFF`, `STOFF`; polygons of any sizes; comments; UTF-16",
    ("OFF # a plate\n" + SQUARE).encode("utf-16"),
)
row(
    "OFF",
    "colours of vertices (`COFF`), 0 to 1 or 0 to 255",
    "COFF\n4 1 0\n" + "".join(f"{p} 0 0 255\n" for p in POINTS) + "4 0 1 2 3",
    [BLUE],
)
row("OFF", "colours of faces", "OFF\n" + SQUARE + " 0 0 1", [BLUE])
row(
    "OFF",
    "colours of vertices and faces",
    "COFF\n4 1 0\n" + "".join(f"{p} 0 0 255\n" for p in POINTS) + "4 0 1 2 3 255 0 0",
    [BLUE],
)
row("OFF", "alpha of colours", "OFF\n" + SQUARE + " 0 0 255 9", [BLUE])
row("OFF", "numbers of a colour map", "OFF\n" + SQUARE + " 7")
row("OFF", "`OFF BINARY`, `4OFF`, `nOFF`", "4OFF\n" + SQUARE)
row("OFF", "decimal commas", "OFF\n" + SQUARE.replace("1 0 0", "1,0 0 0"))
