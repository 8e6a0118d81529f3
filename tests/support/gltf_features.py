"""A glTF file for each row of docs/formats.csv about glTF, and what checks the loaded mesh."""

import base64
import io
import json
import struct
import unicodedata
from urllib.parse import quote

import numpy as np
from gltf_scene import Scene, checker, colors_at, square
from PIL import Image
from solids import box

from objectfolder.mesh import srgb
from objectfolder.mesh.reading.load import references

ROWS = {}  #: functions of a folder, by format and feature
SIDES = np.array([1.0, 2.0, 3.0])
RED, GREEN, BLUE, SAND = [220, 30, 20], [10, 200, 60], [30, 40, 230], [200, 180, 120]
FOUR = [[RED, GREEN], [BLUE, SAND]]
DRACO, KTX = "KHR_draco_mesh_compression", "KHR_texture_basisu"


def row(feature):
    """Decorate a function that fills a scene, and returns a path it wrote or None, and a check or None."""

    def register(fill):
        def build(folder):
            scene = Scene()
            path, check = fill(scene, folder)
            return path or scene.write(folder / "scene.gltf"), check

        ROWS["glTF", feature] = build
        return build

    return register


def linear(color, alpha=()):
    return [*srgb.decode(np.asarray(color) / 255).tolist(), *alpha]


def put_box(scene, material=None, root=True, at=(0, 0, 0), sides=SIDES, attributes=None, **node):
    vertices, faces = box(sides, at)
    mesh = scene.mesh(vertices, faces, material, **(attributes or {}))
    return scene.node(mesh, root, **node)


def shows_box(at=(0, 0, 0), color=None, sides=SIDES, atol=1e-5):
    """Return a check: one box, its outside outward, of one colour."""

    def check(mesh):
        assert len(mesh.faces) == 12
        low, high = mesh.bounds[:, [0, 2, 1]] * [1, 1, -1]  # back to y up
        np.testing.assert_allclose(abs(high - low), sides, atol=atol)
        np.testing.assert_allclose((high + low) / 2, at, atol=atol)
        a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
        np.testing.assert_allclose(np.einsum("fc,fc->", a, np.cross(b, c)) / 6, np.prod(sides), rtol=atol)
        if color is not None:
            np.testing.assert_allclose(colors_at(mesh), np.tile(color, (12, 1)), atol=2)

    return check


def shows(*colors):
    """Return a check: quads of these colours, in this order."""

    def check(mesh):
        np.testing.assert_allclose(colors_at(mesh), np.repeat(np.array(colors, float), 2, 0), atol=2)

    return check


def put_quads(scene, info=None, uv=None, texture=None, **attributes):
    """Put four quads, in the middle of the four fields of a texture by default."""
    texture = scene.texture(checker(FOUR, 8)) if texture is None else texture
    places = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
    uv = [square(u, v, 0.2) for u, v in places] if uv is None else uv
    material = scene.material(texture, info)
    scene.quads(0, material, uv, **attributes)
    return scene.document["materials"][material]


def picture(format):
    """Return a plain picture in a format of Pillow, as bytes."""
    stream = io.BytesIO()
    Image.fromarray(np.full((4, 4, 3), SAND, np.uint8)).save(stream, format, quality=100)
    return stream.getvalue()


@row("triangles, strips and fans, with indices or without")
def _(scene, folder):
    corner = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1]], float)
    for mode, order in ((5, [0, 1, 2, 3]), (6, [0, 1, 3, 2]), (4, [0, 1, 2, 2, 1, 3])):
        for indexed in (False, True):
            points = corner if indexed else corner[order]
            primitive = {"attributes": {"POSITION": scene.accessor(points)}, "mode": mode}
            if indexed:
                primitive["indices"] = scene.accessor(order, "u1")
            scene.node(scene.append("meshes", {"primitives": [primitive]}))

    def check(mesh):
        a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
        np.testing.assert_allclose(np.cross(b - a, c - a), np.tile([-1, 0, 0], (12, 1)))

    return None, check


@row("buffers and images in the binary chunk of a `.glb`, in files, in `data:` URIs")
def _(scene, folder):
    """Positions from the chunk, indices from a file, coordinates from an address, the picture from a file."""
    (folder / "a.bin").write_bytes(data := put_sand(scene, folder / "sand.png", "sand.png"))
    coded = base64.b64encode(data).decode().replace("A", "%41")
    document = scene.document
    document["buffers"] = [
        {"byteLength": len(data)},
        {"byteLength": len(data), "uri": "a.bin"},
        {"byteLength": len(data), "uri": f"DATA:application/octet-stream;base64,{coded}"},
    ]
    for name, number in (("POSITION", 0), ("indices", 1), ("TEXCOORD_0", 2)):
        primitive = document["meshes"][0]["primitives"][0]
        accessor = document["accessors"][(primitive | primitive["attributes"])[name]]
        document["bufferViews"][accessor["bufferView"]]["buffer"] = number
    text = json.dumps({name: value for name, value in document.items() if value != []}).encode()
    text, data = text + b" " * (-len(text) % 4), data + b"\0" * (-len(data) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(data), len(text), b"JSON")
    path = folder / "scene.glb"
    path.write_bytes(head + text + struct.pack("<I4s", len(data), b"BIN\0") + data)
    return path, shows_box(color=SAND)


def put_sand(scene, picture_path, uri):
    """Put a box with a picture of a file; return the data of the rest."""
    picture_path.parent.mkdir(exist_ok=True)
    picture_path.write_bytes(picture("png"))
    material = scene.material(scene.append("textures", {"source": scene.append("images", {"uri": uri})}))
    put_box(scene, material, attributes={"TEXCOORD_0": np.zeros((8, 2))})
    return scene.data


@row("file names that are percent-encoded, with backslashes, of either form of Unicode or case; addresses")
def _(scene, folder):
    composed, apart = (unicodedata.normalize(form, "größe") for form in ("NFC", "NFD"))
    names = {f"{quote(composed)}%201.png": f"{apart} 1.png", f"t\\{apart}.png": f"t/{composed}.png"}
    names |= {
        "100%25.png": "100%.png",
        "as%20written.png": "as%20written.png",
        "Skin.PNG": "skin.png",
        "https://a.org/t/web%201.png": "web 1.png",
    }
    for uri, name in names.items():
        put_sand(scene, folder / name, uri)

    def check(mesh):
        assert len(mesh.faces) == 72
        np.testing.assert_allclose(colors_at(mesh), np.tile(SAND, (72, 1)))
        assert {str(path) for path in references(folder / "scene.gltf")} == {*names.values()}

    return None, check


@row("interleaved, sparse and normalized accessors; `KHR_mesh_quantization`")
def _(scene, folder):
    vertices, faces = box(SIDES)
    rows = np.zeros((8, 8), "<i2")  # of 16 bytes: positions, and more
    rows[:7, :3] = np.rint(vertices[:7] / 3 * 32767)
    packed = {"bufferView": scene.view(rows.tobytes(), byteStride=16), "type": "VEC3", "count": 8}
    last = np.rint(vertices[7:] / 3 * 32767).astype("<i2")
    sparse = {
        "count": 1,
        "indices": {"bufferView": scene.view(b"\7"), "componentType": 5121},
        "values": {"bufferView": scene.view(last.tobytes())},
    }
    accessor = {**packed, "componentType": 5122, "normalized": True, "sparse": sparse}
    scene.node(scene.mesh(scene.append("accessors", accessor), faces), scale=[3, 3, 3])
    scene.document["extensionsUsed"] = scene.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    return None, shows_box(atol=1e-3)


@row("nodes with a matrix, or translation, rotation and scale")
def _(scene, folder):
    turned = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter turn about z
    inner = put_box(scene, root=False, translation=[1, 0, 0], rotation=turned, scale=[2, -2, 2])
    matrix = np.diag([0.5, 0.5, 0.5, 1])
    matrix[:3, 3] = [0, 5, 0]
    scene.node(matrix=matrix.T.ravel().tolist(), children=[inner])
    return None, shows_box((0.5, 5, 0), sides=SIDES[[1, 0, 2]])


@row("copies by `EXT_mesh_gpu_instancing`")
def _(scene, folder):
    vertices, faces = box((1, 1, 1))
    half = np.sqrt(0.5)
    copies = {
        "TRANSLATION": scene.accessor([[0, 0, 0], [4, 0, 0]]),
        "ROTATION": scene.accessor([[0, 0, 0, 1], [0, 0, half, half]]),
        "SCALE": scene.accessor([[1, 1, 1], [2, 1, 1]]),
        "_ID": scene.accessor([1, 2]),
    }
    extensions = {"EXT_mesh_gpu_instancing": {"attributes": copies}}
    scene.node(scene.mesh(vertices, faces), extensions=extensions, translation=[0, 0, 7])

    def check(mesh):
        assert len(mesh.faces) == 24
        np.testing.assert_allclose(mesh.bounds, [[-0.5, -7.5, -1], [4.5, -6.5, 1]], atol=1e-6)

    return None, check


def put_skinned_box(scene, **attributes):
    """Put a box, drawn in hundredths, under an armature of scale 0.01; its own transform does not count."""
    joint = scene.node(root=False, translation=[0, 500, 0])
    body = put_box(
        scene,
        None,
        False,
        (0, 50, 0),
        100 * SIDES,
        attributes,
        skin=0,
        translation=[9, 9, 9],
        scale=[3, 1, 1],
    )
    scene.node(children=[joint, body], scale=[0.01] * 3)
    inverse = np.eye(4)
    inverse[:3, 3] = [0, -50, 0]
    skin = {"joints": [joint], "inverseBindMatrices": scene.accessor(inverse.T.reshape(1, 16))}
    scene.document["skins"] = [skin]
    return scene.document["nodes"][body]


def influences(scene):
    joints = scene.accessor(np.zeros((8, 4)), "u1")
    return {"JOINTS_0": joints, "WEIGHTS_0": np.tile([1.0, 0, 0, 0], (8, 1))}


@row("skins")
def _(scene, folder):
    put_skinned_box(scene, **influences(scene))
    return None, shows_box((0, 5, 0))


@row("a skin, but a mesh without joints and weights")
def _(scene, folder):
    put_box(scene, skin=0, translation=[1, 0, 0])
    scene.document["skins"] = [{"joints": [scene.node(translation=[0, 7, 0])]}]
    return None, shows_box((1, 0, 0))


@row("copies of a skinned mesh")
def _(scene, folder):
    node = put_skinned_box(scene, **influences(scene))
    copies = {"attributes": {"TRANSLATION": scene.accessor(np.eye(3))}}
    node["extensions"] = {"EXT_mesh_gpu_instancing": copies}
    return None, shows_box((0, 5, 0))


@row("morph targets")
def _(scene, folder):
    put_box(scene, attributes={"COLOR_0": np.full((8, 3), 0.5)}, weights=[0.5, 0])
    vertices, _ = box(SIDES)
    (primitive,) = scene.document["meshes"][0]["primitives"]
    grown = {"POSITION": scene.accessor(2 * vertices), "COLOR_0": scene.accessor(np.full((8, 3), 0.5))}
    # Zeros without data, as exporters write them, and a target of no weight.
    zeros = scene.append("accessors", {"componentType": 5126, "count": 8, "type": "VEC3"})
    primitive["targets"] = [grown, {"POSITION": zeros, "COLOR_0": zeros}]
    scene.document["meshes"][0]["weights"] = [0.25, 1]  # the node's count
    return None, shows_box(color=255 * srgb.encode(np.full(3, 0.75)), sides=2 * SIDES)


def noted(feature):
    """Decorate a function that fills a scene of one box with what is noted, and leaves the box as it is."""

    def register(fill):
        @row(feature)
        def build(scene, folder):
            put_box(scene)
            fill(scene)
            return None, shows_box()

        return build

    return register


@noted("animations")
def _(scene):
    scene.document["animations"] = [{"channels": [], "samplers": []}]


@noted("cameras")
def _(scene):
    scene.document["cameras"] = [{"type": "perspective"}]
    scene.node(camera=0)


@noted("lights")
def _(scene):
    scene.document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    scene.node(extensions={"KHR_lights_punctual": {"light": 0}})


@noted("scenes beside the default one, nodes of no scene")
def _(scene):
    scene.append("scenes", {"nodes": [put_box(scene, root=False, scale=[7, 7, 7])]})
    put_box(scene, root=False, scale=[8, 8, 8])


@noted("several scenes and no default")
def _(scene):
    del scene.document["scene"]
    scene.append("scenes", {"nodes": [0]})


@noted("meshes of no node")
def _(scene):
    vertices, faces = box((9, 9, 9))
    scene.mesh(vertices, faces)


@noted("nodes that `KHR_node_visibility` hides, and those below")
def _(scene):
    child = put_box(scene, root=False, at=(9, 0, 0))
    scene.node(children=[child], extensions={"KHR_node_visibility": {"visible": False}})
    scene.document["nodes"][0]["extensions"] = {"KHR_node_visibility": {"visible": True}}
    scene.document["extensionsRequired"] = ["KHR_node_visibility"]


@noted("`extras` that hide: visible false, hidden or hide_render true")
def _(scene):
    for extras in ({"visible": False}, {"isVisible": 0}, {"hidden": True}, {"hide_render": 1.0}):
        put_box(scene, at=(9, 0, 0), extras=extras)
    put_box(scene, at=(9, 0, 0))
    scene.document["meshes"][-1]["extras"] = {"hide_viewport": True}
    scene.document["nodes"][0]["extras"] = {"visible": True, "hide_select": True, "hidden": "no"}


@noted("nodes and copies of scale 0, with which animations hide")
def _(scene):
    put_box(scene, at=(9, 0, 0), scale=[0, 0, 0], translation=[99, 0, 0])


@noted("`MSFT_lod`: lower levels of detail")
def _(scene):
    inside, beside = put_box(scene, at=(9, 0, 0)), put_box(scene, root=False, at=(9, 0, 0))
    scene.document["nodes"][0]["extensions"] = {"MSFT_lod": {"ids": [inside, beside]}}


@noted("points and lines")
def _(scene):
    points = {"POSITION": scene.accessor(np.full((2, 3), 99.0))}
    scene.document["meshes"][0]["primitives"] += [{"attributes": points, "mode": mode} for mode in range(4)]


@noted("faces without positions")
def _(scene):
    scene.document["meshes"][0]["primitives"].append({"attributes": {"NORMAL": scene.accessor(np.eye(3))}})


@noted("corners after the last whole triangle")
def _(scene):
    primitive = scene.document["meshes"][0]["primitives"][0]
    scene.document["accessors"][primitive["indices"]]["count"] = 35
    primitive = {"attributes": primitive["attributes"], "indices": scene.accessor(box(SIDES)[1][-1], "u4")}
    scene.document["meshes"][0]["primitives"].append(primitive)


def put_material(scene, extension=None, content=None, **material):
    if extension is not None:
        material["extensions"] = {extension: content or {}}
    scene.document["materials"].append(
        {"pbrMetallicRoughness": {"baseColorFactor": linear(SAND, [1])}, **material}
    )
    scene.document["meshes"][0]["primitives"][0]["material"] = 0


def put_map(scene, kind):
    put_material(scene, **{f"{kind}Texture": {"index": 99}})  # nothing reads it


@row("base colour, as a factor and a texture")
def _(scene, folder):
    half = np.array([0.5, 0.25, 1.0])
    put_quads(scene)["pbrMetallicRoughness"]["baseColorFactor"] = [*half, 1]
    products = [255 * srgb.encode(half * linear(color)) for color in (RED, GREEN, BLUE, SAND)]
    return None, shows(*products)


@row("texture coordinates of a set other than 0; `KHR_texture_transform`")
def _(scene, folder):
    info = {"texCoord": 2, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}}
    put_quads(scene, info, TEXCOORD_2=[square(0.25, v, 0.2) for v in (0.25, 0.25, 0.75, 0.75)])
    scene.document["extensionsRequired"] = ["KHR_texture_transform"]
    return None, shows(GREEN, GREEN, SAND, SAND)


@row("textures that repeat, mirror or end at their edge")
def _(scene, folder):
    for wrap in (10497, 33648, 33071):
        texture = scene.texture(checker(FOUR, 8), wrapS=wrap)
        put_quads(scene, uv=[square(1.25, 0.25, 0.1)], texture=texture)
    return None, shows(RED, GREEN, GREEN)


@row("textures without interpolation")
def _(scene, folder):
    put_quads(scene, texture=scene.texture(checker(FOUR, 8), magFilter=9728))
    return None, shows(RED, GREEN, BLUE, SAND)


@row("vertex colours, also beside a texture")
def _(scene, folder):
    shade = np.array([0.25, 0.5, 1.0, 0.75])
    put_quads(scene, COLOR_0=np.repeat(shade, 12).reshape(4, 4, 3))
    colors = zip(shade, (RED, GREEN, BLUE, SAND))
    return None, shows(*(255 * srgb.encode(s * np.array(linear(color))) for s, color in colors))


@noted("a second set of vertex colours, attributes of an application")
def _(scene):
    attributes = scene.document["meshes"][0]["primitives"][0]["attributes"]
    attributes |= {"COLOR_1": scene.accessor(np.ones((8, 3))), "_WEAR": scene.accessor(np.ones(8))}


@row("roughness and metallic factors")
def _(scene, folder):
    put_box(scene, scene.material(roughnessFactor=0.25, metallicFactor=0.75))
    return None, has_surface(0.25, 0.75)


def has_surface(roughness, metallic):
    def check(mesh):
        np.testing.assert_allclose([mesh.roughness, mesh.metallic], [roughness, metallic])

    return check


@noted("several of these in one file")
def _(scene):
    """Two parts of equal area."""
    put_material(scene, pbrMetallicRoughness={"roughnessFactor": 0.2})
    (primitive,) = scene.document["meshes"][0]["primitives"]
    halves = [scene.accessor(half.ravel(), "u4") for half in np.split(box(SIDES)[1], 2)]
    other = {"pbrMetallicRoughness": {"roughnessFactor": 0.8}}
    primitives = [{**primitive, "indices": half, "material": n} for n, half in enumerate(halves)]
    scene.document["materials"].append(other)
    scene.document["meshes"][0]["primitives"] = primitives


@row("vertex normals")
def _(scene, folder):
    outward = np.sign(box(SIDES)[0])
    put_box(scene, attributes={"NORMAL": scene.accessor(outward * 2)})

    def check(mesh):
        back = mesh.normals[:, [0, 2, 1]] * [1, 1, -1]  # y up
        np.testing.assert_allclose(back, outward / np.sqrt(3), atol=1e-6)

    return None, check


@noted("a texture, but a mesh without its coordinates")
def _(scene):
    put_material(scene, pbrMetallicRoughness={"baseColorTexture": {"index": scene.texture([[SAND]])}})


@row("a map of roughness and metallic")
def _(scene, folder):
    maps = {"index": scene.texture(checker([[[0, 51, 0], [0, 153, 102]]], 2))}
    put_box(scene, scene.material(metallicRoughnessTexture=maps, roughnessFactor=0.5))
    return None, has_surface(0.2, 0.2)


@noted("a normal map, with tangents")
def _(scene):
    put_map(scene, "normal")
    attributes = scene.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["TANGENT"] = scene.accessor(np.ones((8, 4)))


for kind in ("occlusion", "emissive"):
    noted(f"an {kind} map")(lambda scene, kind=kind: put_map(scene, kind))


@noted("emission without a map")
def _(scene):
    put_material(scene, emissiveFactor=[0, 0.5, 0])


@noted("alpha modes MASK and BLEND")
def _(scene):
    put_material(scene, alphaMode="MASK")


@noted("materials that are double-sided")
def _(scene):
    put_material(scene, doubleSided=True)


GLOSS = "KHR_materials_pbrSpecularGlossiness"


@row("`KHR_materials_pbrSpecularGlossiness`")
def _(scene, folder):
    put_box(scene)
    put_material(scene, GLOSS, {"diffuseFactor": linear(GREEN, [1]), "glossinessFactor": 0.75})

    def check(mesh):
        shows_box(color=GREEN)(mesh)
        has_surface(0.25, 0)(mesh)

    return None, check


@noted("its specular factor")
def _(scene):
    put_material(scene, GLOSS, {"specularFactor": [1, 0.8, 0.2]})


@noted("its map of specular colour and glossiness")
def _(scene):
    put_material(scene, GLOSS, {"specularGlossinessTexture": {"index": scene.texture([[[0, 0, 0, 255]]])}})


@noted("`KHR_materials_transmission`")
def _(scene):
    put_material(scene, "KHR_materials_transmission", {"transmissionFactor": 1})


@noted("other extensions of materials, such as clearcoat, sheen, unlit")
def _(scene):
    put_material(scene, extensions={"KHR_materials_clearcoat": {}, "KHR_materials_unlit": {}})
    scene.document["extensionsRequired"] = ["KHR_materials_clearcoat"]


@noted("variants of materials")
def _(scene):
    scene.document["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}}
    variants = {"KHR_materials_variants": {"mappings": [{"material": 7, "variants": [0]}]}}
    scene.document["meshes"][0]["primitives"][0]["extensions"] = variants


@noted("any other extension that is not required")
def _(scene):
    scene.document["extensions"] = {"VRM": {}}
    scene.document["meshes"][0]["primitives"][0]["extensions"] = {"EXT_mesh_features": {}}


@row("PNG, JPEG and WebP textures; beside them KTX2, DDS or AVIF")
def _(scene, folder):
    for format in ("png", "jpeg", "webp"):
        image = scene.append("images", {"bufferView": scene.view(picture(format))})
        texture = {"source": image, "extensions": {KTX: {"source": 99}}}
        if format == "webp":
            texture = {"extensions": {"EXT_texture_webp": {"source": image}}}
        put_quads(scene, texture=scene.append("textures", texture))
    scene.document["extensionsRequired"] = ["EXT_texture_webp"]
    return None, shows(*[SAND] * 12)


@row("a base colour in KTX2, DDS or AVIF alone")
def _(scene, folder):
    put_quads(scene, texture=scene.append("textures", {"extensions": {KTX: {"source": 0}}}))
    scene.document["extensionsRequired"] = [KTX]
    return None, None


@noted("KTX2 textures of what is left out")
def _(scene):
    put_map(scene, "normal")
    scene.document["textures"] = [{"extensions": {KTX: {"source": 0}}}]
    scene.document["extensionsRequired"] = [KTX]


def refused(feature, **document):
    """Add a row of a box with statements that refuse it."""

    @row(feature)
    def _(scene, folder):
        put_box(scene)
        scene.document |= document
        return None, None


refused("meshopt compression", extensionsRequired=["EXT_meshopt_compression"])
refused("any other extension that is required", extensionsRequired=["KHR_mesh_of_tomorrow"])
refused("glTF 1.0, or a later version that is required", asset={"version": "2.1", "minVersion": "2.1"})


@row("Draco compression")
def _(scene, folder):
    """Not said to be required, but without other data."""
    put_box(scene)
    (primitive,) = scene.document["meshes"][0]["primitives"]
    primitive["extensions"] = {DRACO: {"bufferView": 0}}
    del scene.document["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]
    return None, None
