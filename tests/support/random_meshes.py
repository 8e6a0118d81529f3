"""Random valid files of a format, by a small grammar, and what they hold: the generator's own reading.

A function per format takes a random generator and a folder, and returns the file's path and its triangles.
"""

import struct
import unicodedata
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from PIL import Image

PLAIN = 203  # sRGB of what has no colour
ENDS = ["\n", "\r\n", "\r"]
ENCODINGS = ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "utf-16-be", "be-mark"]
INTEGERS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"}
INTEGERS |= {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"}
REALS = {"float": "f", "double": "d", "float32": "f", "float64": "d"}


@dataclass
class Truth:
    """Triangles with the sRGB colours of their corners, exact where nothing is baked."""

    triangles: list = field(default_factory=list)  # of three points
    colors: list = field(default_factory=list)  # of three colours
    baked: bool = False

    def add(self, points, colors):
        """Add a convex polygon, as a fan."""
        for i in range(1, len(points) - 1):
            self.triangles.append([points[0], points[i], points[i + 1]])
            self.colors.append([colors[0], colors[i], colors[i + 1]])


def prisms(rng):
    """Prisms side by side: points on a grid that text and single precision hold exactly, and polygons."""
    for x in range(rng.integers(1, 4)):
        n = int(rng.integers(3, 8))
        angle = 2 * np.pi * np.arange(n) / n + rng.random()
        ring = np.rint(256 * np.stack([np.cos(angle), np.sin(angle)], 1)) / 64 + [16 * x, 0]
        low, high = np.sort(rng.choice(400, 2, replace=False)) / 64
        points = [[*p, low] for p in ring] + [[*p, high] for p in ring]
        sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
        yield points, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def palette(rng, count):
    return rng.integers(2, 256, (count, 3)).tolist()


def one(rng, items):
    return items[int(rng.integers(len(items)))]


def number(rng, x):
    forms = [repr(float(x)), f"{x:+.6f}", f"{x:.9e}", f"{x:.7E}" if abs(x) < 8 else f"{x:f}"]
    forms += [f"{x:.6f}".lstrip("0")] if 0 < x < 1 else []
    return one(rng, [*forms, str(int(x))] if x == int(x) else forms)


def numbers(rng, values):
    return " ".join(number(rng, x) for x in values)


def write_text(
    rng, path, lines, comment="#", inline=(), encodings=ENCODINGS, tails=("", "\n", "\0\0", "\x1a")
):
    """Write lines with other ends, encodings, blanks, comments and what follows the last one."""
    end, encoding, tidy = one(rng, ENDS), one(rng, encodings), rng.random() < 0.4
    result = []
    for line in lines:
        if not tidy:
            if comment and rng.random() < 0.1:
                result.append(one(rng, ["", f"{comment} é v 1 2", f"{comment}", "  "]))
            keyword = line.split(" ")[0]
            if keyword in inline:
                line = line.replace(" ", one(rng, [" ", "  ", "\t", " "]))
                if "\\" in inline and rng.random() < 0.1:
                    line = line.replace(" ", f" \\{end}", 1)
                line += f" {comment} x 1/2" if comment and rng.random() < 0.1 else ""
            line = one(rng, ["", "", " ", "\t"]) + line + one(rng, ["", "", " "])
        result.append(line)
    text = end.join(result) + one(rng, tails)
    mark = "﻿" if encoding == "be-mark" else ""
    path.write_bytes((mark + text).encode("utf-16-be" if mark else encoding))
    return path


def write_texture(rng, path):
    """Write an image of four columns; return their colours."""
    colors = palette(rng, 4)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.repeat(np.uint8([colors]), 16, 1).repeat(16, 0)).save(path, "PNG")
    return colors


def map_line(rng, folder, name, encoding_holds_marks):
    """Write a texture; return its ``map_Kd``, colours, and the scale and offset of texture coordinates."""
    scale, offset, options = 1.0, 0.0, []
    on_disk = unicodedata.normalize("NFD", name) if rng.random() < 0.3 else name
    colors = write_texture(rng, folder / on_disk)
    if rng.random() < 0.4:
        scale = float(one(rng, [1, 2, 0.5, 4]))
        options.append(f"-s {numbers(rng, [scale, 1, 1][: rng.integers(1, 4)])}")
    if rng.random() < 0.4:
        offset = float(one(rng, [0, 0.25, -1, 3]))
        options.append(f"-o {numbers(rng, [offset, 0, 0][: rng.integers(1, 4)])}")
    others = [
        "-blendu on",
        "-blendv off",
        "-boost 2.5",
        "-mm 0 1",
        "-mm 0.1",
        "-t 0 0 0",
        "-t",
        "-texres 512",
    ]
    others += ["-clamp off", "-bm 1.5", "-imfchan m", "-type sphere", "-cc off", "-colorspace sRGB"]
    options += rng.choice(others, rng.integers(0, 4), replace=False).tolist()
    options = [options[i] for i in rng.permutation(len(options))]
    options += ["-unknown x"] if rng.random() < 0.1 else []
    written = name if rng.random() < 0.8 else name.swapcase()
    written = written.replace("/", "\\") if rng.random() < 0.3 else written
    if encoding_holds_marks and rng.random() < 0.3:
        written = unicodedata.normalize("NFD", written)
    written = f'"{written}"' if rng.random() < 0.1 else written
    keyword = one(rng, ["map_Kd", "map_kd", "MAP_KD"])
    return " ".join([keyword, *options, written]), colors, scale, offset


def write_obj(rng, folder):
    """Write an ``.obj`` with its library: indices, colours and texture coordinates in all forms."""
    truth, solids = Truth(), list(prisms(rng))
    encodings = [*(["utf-8", "utf-16"] if rng.random() < 0.5 else ["latin-1"])]
    looks = [one(rng, ["none", "vertex", "kd", "texture", "unmapped"]) for _ in solids]
    form, truth.baked = one(rng, ["rgb", "255", "rgba", "wrgb", "mrgb"]), "texture" in looks
    library, blocks = ["newmtl none", "Ns 10"], []
    counts = {"v": 0, "vt": 0, "vn": 0}
    for i, ((points, polygons), look) in enumerate(zip(solids, looks)):
        lines, colors, uv, name = [f"o part {i}"], [[PLAIN] * 3] * len(points), None, "none"
        if look in ("kd", "texture", "unmapped"):
            name = f"{one(rng, ['mat', 'Größe ', 'Material #', 'a b'])}{i}"
            library += [
                f"newmtl {name}",
                *rng.choice(["Ka 1 1 1", "illum 2", "d 1.0", "Ks 0 0 0"], 2).tolist(),
            ]
            (kd,) = palette(rng, 1)
            library += [f"Kd {' '.join(f'{c / 255:.6f}' for c in kd)}"] if look == "kd" else []
            colors = [kd] * len(points) if look == "kd" else colors
        if look in ("texture", "unmapped"):
            texture = one(rng, ["t", "my skin", "größe é", "sub dir/ski n", "Tex #"]) + f"{i}.png"
            line, columns, scale, offset = map_line(rng, folder, texture, encodings[0] != "latin-1")
            library.append(line)
            if look == "texture":
                column = int(rng.integers(4))
                uv = ((column + 0.5) / 4 + int(rng.integers(-2, 3)) * (scale <= 1) - offset) / scale
                colors = [columns[column]] * len(points)
        if look in ("vertex", "unmapped"):
            colors = palette(rng, len(points)) if not truth.baked else palette(rng, 1) * len(points)
        else:
            name = name if look != "none" or i else ""
        block = [] if look in ("vertex", "unmapped") else None
        for point, color in zip(points, colors):
            unit = [f"{c / 255:.6f}" for c in color]
            row = numbers(rng, point)
            if block is not None:
                block.append("ff" + bytes(color).hex())
                row += {"rgb": f" {' '.join(unit)}", "255": f" {' '.join(map(str, color))}", "mrgb": ""}.get(
                    form, f" {' '.join(unit)} 1.0" if form == "rgba" else f" 1.0 {' '.join(unit)}"
                )
            lines.append(f"v {row}")
        if block and form == "mrgb":
            step = int(rng.integers(1, 9))
            lines += ["#MRGB " + "".join(block[k : k + step]) for k in range(0, len(block), step)]
        given = ["v"]
        if uv is not None:
            size = int(rng.integers(1, 4))
            lines += [f"vt {numbers(rng, [uv, rng.integers(-3, 3), 0][:size])}" for _ in points]
            given.append("vt")
        if rng.random() < 0.3:
            lines += [f"vn {numbers(rng, n)}" for n in rng.integers(-3, 3, (len(points), 3)).tolist()]
            given.append("vn")
        before = dict(counts)
        for kind in given:
            counts[kind] += len(points)
        own = [f"usemtl {name}"] if name else []
        own += [f"g {i}", "s off", "unknown 1 2"][: rng.integers(0, 4)]
        back = rng.random() < 0.4
        for polygon in polygons:
            truth.add([points[c] for c in polygon], [colors[c] for c in polygon])
            words = []
            for c in polygon:
                at = {kind: (before[kind] + c + 1, c - len(points)) for kind in given}
                held = [str(at[kind][0]) if kind in at else "" for kind in ("v", "vt", "vn")]
                relative = [str(at[kind][1]) if kind in at else "" for kind in ("v", "vt", "vn")]
                words.append("/".join(relative if back else held).rstrip("/"))
            own.append(f"f {' '.join(words)}")
        blocks.append((lines, own, back))
    together = all(not back for _, _, back in blocks) and rng.random() < 0.5
    lines = [line for part in blocks for line in part[0]] if together else []
    for part, own, _ in blocks:
        lines += own if together else part + own
    lines += rng.choice(["l 1 2", "p 1", "f 1 2", "# end"], rng.integers(0, 3)).tolist()
    file = one(rng, ["m.mtl", "my lib.mtl"])
    write_text(rng, folder / file, library, inline=("Kd", "Ka"), encodings=encodings, tails=("", "\n"))
    inline = ("v", "vt", "vn", "f", "\\")
    return write_text(rng, folder / "m.obj", [f"mtllib {file}", *lines], inline=inline), truth


def write_off(rng, folder):
    """Write an ``.off``: colours of vertices or faces, normals, texture coordinates."""
    truth, points, polygons, colors = Truth(), [], [], []
    kind = one(rng, ["", "C", "N", "CN", "ST", "STCN", "faces"])
    unit = one(rng, [1, 255])
    for own, faces in prisms(rng):
        polygons += [[len(points) + c for c in face] for face in faces]
        points += own
    by_vertex, by_face = palette(rng, len(points)), palette(rng, len(polygons))
    rows = []
    for point, color in zip(points, by_vertex):
        row = numbers(rng, point)
        row += " 0 0 0" if "N" in kind else ""
        row += " " + colored(color, unit, rng) if "C" in kind else ""
        rows.append(row + (" 0.5 0.5" if "ST" in kind else ""))
    for polygon, color in zip(polygons, by_face):
        row = " ".join(map(str, [len(polygon), *polygon]))
        rows.append(row + (" " + colored(color, unit, rng) if kind == "faces" else ""))
        whole = color if kind == "faces" else [PLAIN] * 3
        colors = [by_vertex[c] if "C" in kind else whole for c in polygon]
        truth.add([points[c] for c in polygon], colors)
    head = ("" if kind == "faces" else kind) + "OFF"
    counts = f"{len(points)} {len(polygons)}{one(rng, ['', ' 0', ' 12'])}"
    lines = [f"{head} {counts}", *rows] if rng.random() < 0.3 else [head, counts, *rows]
    return write_text(rng, folder / "m.off", lines, tails=("", "\n", "\0", "\n# end", "\n1 2 3")), truth


def colored(color, unit, rng):
    values = color if unit == 255 else [f"{c / 255:.6f}" for c in color]
    return " ".join(map(str, [*values, *[unit] * int(rng.integers(2))]))


def write_stl(rng, folder):
    """Write an ``.stl``, in text or binary."""
    truth = Truth()
    for points, polygons in prisms(rng):
        for polygon in polygons:
            truth.add([points[c] for c in polygon], [[PLAIN] * 3] * len(polygon))
    return (write_binary_stl if rng.random() < 0.5 else write_text_stl)(rng, folder / "m.stl", truth), truth


def write_binary_stl(rng, path, truth):
    header = one(
        rng, [b"", b"solid of a CAD program", b"solid", b"exported\0\xff\xfe", b"facet normal 1 2 3"]
    )
    kind = one(rng, ["none", "viscam", "magics", "meshlab"])
    levels = rng.integers(0, 32, (len(truth.triangles), 3))
    (all_of_it,) = palette(rng, 1)
    if kind in ("magics", "meshlab"):
        header = header[:9].replace(b"\0", b"") + b" COLOR=" + bytes([*all_of_it, 255])
    body = b""
    for i, (triangle, (r, g, b)) in enumerate(zip(truth.triangles, levels.tolist())):
        own = rng.random() < 0.7 or not i
        word = {
            "none": 0,
            "viscam": 0x8000 | r << 10 | g << 5 | b,
            "meshlab": 0x8000 | b << 10 | g << 5 | r,
        }.get(kind, b << 10 | g << 5 | r)
        color = [PLAIN] * 3 if kind == "none" else [round(c * 255 / 31) for c in (r, g, b)]
        if not own and kind in ("viscam", "magics"):
            word, color = (0, [PLAIN] * 3) if kind == "viscam" else (0xFFFF, all_of_it)
        truth.colors[i] = [color] * 3
        normal = one(rng, [[0, 0, 0], [float("nan")] * 3, [1, 0, 0]])
        body += struct.pack("<12fH", *normal, *np.ravel(triangle), word)
    count = one(rng, [len(truth.triangles)] * 3 + [0, 0xFFFFFFFF])
    known = count == len(truth.triangles)
    tail = one(rng, [b"", b"", b"\n", bytes(7), bytes(120) if known else b"", b"end of file"])
    path.write_bytes(header.ljust(80, one(rng, [b"\0", b" "])) + struct.pack("<I", count) + body + tail)
    return path


def write_text_stl(rng, path, truth):
    case = one(rng, [str, str, str.upper, str.title])
    lines, opened = [], False
    for i, triangle in enumerate(truth.triangles):
        if not opened:
            name = one(rng, ["", " a", " my solid 1 2 3", " vertex 1 2 3", " größe facet", " x endloop"])
            lines.append(case("solid") + name)
            opened = True
        normal = one(rng, ["0 0 1", "-1.#IND -1.#IND -1.#IND", "nan nan nan", "-nan(ind) 0 0", "1e-3 0 0"])
        lines += [case(f"facet normal {normal}"), case("outer loop")]
        lines += [f"{case('vertex')} {numbers(rng, point)}" for point in triangle]
        lines += [case("endloop"), case("endfacet")]
        if rng.random() < 0.1 or i == len(truth.triangles) - 1:
            opened = False
            last = i == len(truth.triangles) - 1 and rng.random() < 0.3
            lines += [] if last else [case("endsolid") + one(rng, ["", name, " of others"])]
    return write_text(rng, path, lines, comment="", inline=("vertex", "VERTEX", "Vertex"))


def write_ply(rng, folder):
    """Write a ``.ply``, in text or either binary: any types, names and orders, strips, wedges."""
    truth, order = Truth(), one(rng, ["ascii", "binary_little_endian", "binary_big_endian"])
    code = ">" if "big" in order else "<"
    look = one(rng, ["none", "vertex", "face", "texture", "wedges", "some wedges"])
    strips = rng.random() < 0.2 and look in ("none", "vertex")
    truth.baked = look in ("texture", "wedges", "some wedges")
    names = one(
        rng, [("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b")]
    )
    kind, unit = one(
        rng, [("uchar", 1), ("uint8", 1), ("ushort", 257), ("float", 1 / 255), ("double", 1), ("int", 1)]
    )
    shade = [(kind, name) for name in names]
    columns = write_texture(rng, folder / "größe 1.png") if truth.baked else []
    vertices, faces, chains = [], [], []
    real, whole = one(rng, list(REALS)), one(rng, ["int", "uint", "short", "ushort", "int32", "uint16"])
    for points, polygons in prisms(rng):
        first = len(vertices)
        column = int(rng.integers(4))
        shown = [columns[column]] * len(points) if columns else [[PLAIN] * 3] * len(points)
        bare = look == "some wedges" and rng.random() < 0.5
        colors = palette(rng, 1) * len(points) if bare or columns else palette(rng, len(points))
        if look == "vertex" or bare:
            shown = colors
        for point, color in zip(points, colors):
            vertices.append(
                [*point, *([unit * c for c in color] if look in ("vertex", "some wedges") else [])]
            )
            vertices[-1] += [(column + 0.5) / 4, float(rng.random())] if look == "texture" else []
        for polygon in polygons:
            row = [[first + c for c in polygon]]
            (flat,) = palette(rng, 1)
            if look == "face":
                row += [unit * c for c in flat]
            if "wedges" in look:
                pair = [[(column + 0.5) / 4, float(rng.random())] for _ in polygon]
                row.append([] if bare else [x for p in pair for x in p])
            faces.append(row)
            corner = [flat if look == "face" else shown[c] for c in polygon]
            if not strips:
                truth.add([points[c] for c in polygon], corner)
                continue
            zigzag = [
                0,
                *(k // 2 + 1 if k % 2 == 0 else len(polygon) - 1 - k // 2 for k in range(len(polygon) - 1)),
            ]
            chains += [*([-1] if chains else []), *(first + polygon[z] for z in zigzag)]
            for k in range(len(zigzag) - 2):
                turn = [k, k + 1, k + 2] if k % 2 == 0 else [k + 1, k, k + 2]
                truth.triangles.append([points[polygon[zigzag[t]]] for t in turn])
                truth.colors.append([corner[zigzag[t]] for t in turn])
    properties = [(real, axis) for axis in "xyz"] + (shade if look in ("vertex", "some wedges") else [])
    properties += (
        [("float", n) for n in one(rng, ["st", "uv", ("texture_u", "texture_v")])]
        if look == "texture"
        else []
    )
    if rng.random() < 0.3:
        properties, vertices = [*properties, ("uchar", "quality")], [[*row, 7] for row in vertices]
    if rng.random() < 0.2:
        properties = [*properties, ("uchar short", "neighbours")]
        vertices = [[*row, list(range(rng.integers(0, 4)))] for row in vertices]
    counting = one(rng, list(INTEGERS))
    index = (f"{counting} {whole}", one(rng, ["vertex_index", "vertex_indices"]))
    elements = [("vertex", properties, vertices)]
    if strips:
        own = [[chains]] if len(chains) < 120 and rng.random() < 0.5 else [[c] for c in split_at(chains)]
        elements.append(("tristrips", [("int int", index[1])], own))
    else:
        held = [index, *(shade if look == "face" else [])]
        held += [(f"{counting} float", "texcoord")] if "wedges" in look else []
        moved = rng.permutation(len(held))
        elements.append(("face", [held[m] for m in moved], [[row[m] for m in moved] for row in faces]))
    if rng.random() < 0.4:
        elements.append(("edge", [("int", "vertex1"), ("int", "vertex2")], [[0, 1], [1, 2]]))
    if rng.random() < 0.4:
        elements.append(
            ("strange", [("uchar int", "some"), ("double", "x")], [[[1] * k, 0.5] for k in range(4)])
        )
    elements = [elements[i] for i in rng.permutation(len(elements))]
    head = ["ply", f"format {order} 1.0", "comment é of Blender", "obj_info num_cols 512"]
    head += ["comment TextureFile größe 1.png"] if truth.baked else []
    for name, held, rows in elements:
        head.append(f"element {name} {len(rows)}")
        head += [f"property {'list ' if ' ' in types else ''}{types} {name}" for types, name in held]
    head.append("end_header")
    path = folder / "m.ply"
    if order == "ascii":
        lines = [
            " ".join(written(rng, types, value) for (types, _), value in zip(held, row))
            for _, held, rows in elements
            for row in rows
        ]
        if rng.random() < 0.1 and truth.triangles:
            lines = " ".join(lines).split()  # a word a line
        return write_text(rng, path, [*head, *lines], "", tails=("", "\n", "\0", "\n\n", "\nend")), truth
    body = b"".join(
        packed(code, types, value)
        for _, held, rows in elements
        for row in rows
        for (types, _), value in zip(held, row)
    )
    end = one(rng, ENDS)
    tail = one(rng, [b"", b"\n", bytes(9), b"more words\n"])
    path.write_bytes(end.join([*head, ""]).encode(one(rng, ["utf-8", "latin-1"])) + body + tail)
    return path, truth


def split_at(chains):
    """Return the strips between the marks of their ends."""
    marks = [-1, *(i for i, c in enumerate(chains) if c == -1), len(chains)]
    return [chains[a + 1 : b] for a, b in pairwise(marks)]


def written(rng, types, value):
    if isinstance(value, list):
        return " ".join([str(len(value)), *(written(rng, types.split()[1], v) for v in value)])
    return number(rng, value) if types in REALS else str(int(value))


def packed(code, types, value):
    *count, item = types.split()
    if isinstance(value, list):
        return struct.pack(code + INTEGERS[count[0]], len(value)) + b"".join(
            packed(code, item, v) for v in value
        )
    return struct.pack(code + (REALS | INTEGERS)[item], value if item in REALS else int(value))


WRITERS = {"obj": write_obj, "ply": write_ply, "stl": write_stl, "off": write_off}
