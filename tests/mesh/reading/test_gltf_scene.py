"""Where glTF scenes show their meshes: skins at rest, morph targets, copies, hidden nodes."""

from pathlib import Path

import numpy as np
import pytest
from gltf_features import SIDES, put_box
from gltf_scene import Scene
from refusals import refused
from solids import box
from trimesh.transformations import quaternion_matrix, random_quaternion

from objectfolder.base.errors import ObjectFolderError
from objectfolder.mesh.reading.load import load_mesh

CASES = Path(__file__).parents[4] / "shared" / "cases"


def matrix_of(node):
    """A node's matrix, by another library than the reader's."""
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = quaternion_matrix([w, x, y, z])
    matrix[:3, :3] *= node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def random_place(rng, scale=1.0):
    w, x, y, z = random_quaternion(rng.random(3))
    return {"rotation": [x, y, z, w], "translation": rng.normal(size=3).tolist(), "scale": [scale] * 3}


def expected_points(points, matrices, joints, weights):
    """Points (V, 3) of a skin, vertex by vertex as the standard writes it."""
    found = []
    for point, row, shares in zip(points, joints, weights):
        total = np.zeros(4)
        for joint, share in zip(row, shares):
            total += share * (matrices[joint] @ [*point, 1])
        found.append(total[:3] / sum(shares))
    return np.array(found)


class Rig:
    """A box in a skin of three joints, a chain below an armature; every place is random."""

    def __init__(self, seed, influences=4, armature=0.01, inverse=True):
        self.rng = rng = np.random.default_rng(seed)
        self.scene = Scene()
        self.vertices, self.faces = box(SIDES / armature)
        self.joints = rng.integers(0, 3, (8, influences))
        self.weights = rng.dirichlet(np.ones(influences), 8)
        places = [random_place(rng, armature), *(random_place(rng, s) for s in (1, 2, 0.5))]
        self.armature = len(self.scene.document["nodes"])
        for i, place in enumerate(places):
            children = {"children": [i + 1]} if i < 3 else {}
            self.scene.node(root=i == 0, **place, **children)
        below = np.eye(4)
        self.matrices = []
        for place in places:
            below = below @ matrix_of(place)
            self.matrices.append(below)
        self.matrices = self.matrices[1:]
        self.skin = {"joints": [1, 2, 3], "skeleton": 1}
        if inverse:
            held = [matrix_of(random_place(rng, s)) for s in (1, 0.5, 2)]
            self.matrices = [m @ h for m, h in zip(self.matrices, held)]
            rows = np.array([h.T.ravel() for h in held])
            self.skin["inverseBindMatrices"] = self.scene.accessor(rows)
        self.scene.document["skins"] = [self.skin]

    def attributes(self, joints=None, weights=None):
        joints = self.joints if joints is None else joints
        weights = self.weights if weights is None else weights
        names = {}
        for n, column in enumerate(range(0, joints.shape[1], 4)):
            names[f"JOINTS_{n}"] = self.scene.accessor(joints[:, column : column + 4], "u1")
            names[f"WEIGHTS_{n}"] = self.scene.accessor(weights[:, column : column + 4])
        return names

    def load(self, folder, attributes, **node):
        mesh = self.scene.mesh(self.vertices, self.faces, **attributes)
        self.scene.node(mesh, skin=0, **random_place(self.rng, 3), **node)
        return load_mesh(self.scene.write(folder / "rig.gltf"), "z")

    def expected(self, points=None, joints=None, weights=None):
        return expected_points(
            self.vertices if points is None else points,
            self.matrices,
            self.joints if joints is None else joints,
            self.weights if weights is None else weights,
        )


def assert_there(mesh, expected):
    assert mesh.source["notes"] == []
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-4 * np.ptp(expected))


@pytest.mark.parametrize("influences", [4, 8])
@pytest.mark.parametrize("inverse", [True, False])
def test_a_skin_at_rest(tmp_path, influences, inverse):
    rig = Rig(influences, influences, inverse=inverse)
    assert_there(rig.load(tmp_path, rig.attributes()), rig.expected())


@pytest.mark.parametrize(("dtype", "top"), [("u1", 255), ("u2", 65535)])
def test_weights_of_integers(tmp_path, dtype, top):
    rig = Rig(1)
    whole = np.rint(rig.weights * top)
    attributes = rig.attributes() | {"WEIGHTS_0": rig.scene.accessor(whole, dtype, normalized=True)}
    assert_there(rig.load(tmp_path, attributes), rig.expected(weights=whole))


def test_weights_of_another_sum_count_by_their_shares(tmp_path):
    rig = Rig(2)
    mesh = rig.load(tmp_path, rig.attributes(weights=rig.weights * np.arange(1, 9)[:, None] / 4))
    assert_there(mesh, rig.expected())


def test_a_vertex_without_weights_follows_its_first_joint(tmp_path):
    """As in Blender and three.js."""
    rig = Rig(3)
    weights = rig.weights * (np.arange(8) != 5)[:, None]
    first = np.where((np.arange(8) == 5)[:, None], [1.0, 0, 0, 0], rig.weights)
    assert_there(rig.load(tmp_path, rig.attributes(weights=weights)), rig.expected(weights=first))


def test_a_joint_without_weight_may_be_any(tmp_path):
    rig = Rig(4)
    rig.weights[:, 3] = 0
    joints = rig.joints.copy()
    joints[:, 3] = 250
    assert_there(rig.load(tmp_path, rig.attributes(joints)), rig.expected())


def test_sparse_weights(tmp_path):
    rig = Rig(5)
    rig.weights[:] = [1, 0, 0, 0]
    rig.weights[6] = [0.25, 0.25, 0.5, 0]
    attributes = rig.attributes(weights=np.tile([1.0, 0, 0, 0], (8, 1)))
    scene = rig.scene
    scene.document["accessors"][attributes["WEIGHTS_0"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": scene.view(b"\6"), "componentType": 5121},
        "values": {"bufferView": scene.view(np.float32(rig.weights[6]).tobytes())},
    }
    assert_there(rig.load(tmp_path, attributes), rig.expected())


def test_joints_outside_the_scene_count(tmp_path):
    rig = Rig(6)
    rig.scene.document["scenes"][0]["nodes"].remove(rig.armature)
    assert_there(rig.load(tmp_path, rig.attributes()), rig.expected())


def test_targets_come_before_the_skin_and_normals_follow_both(tmp_path):
    rig = Rig(7, armature=1.0)
    rig.joints[:], rig.weights[:] = 2, [1, 0, 0, 0]
    # A mirrored joint: faces and normals stay outward.
    mirror = np.diag([1.0, -1, 1, 1])
    rows = np.array([mirror.ravel()] * 3)
    rig.skin["inverseBindMatrices"] = rig.scene.accessor(rows)
    chain = [matrix_of(node) for node in rig.scene.document["nodes"]]
    rig.matrices[2] = chain[0] @ chain[1] @ chain[2] @ chain[3] @ mirror
    outward = np.sign(rig.vertices)
    attributes = rig.attributes() | {"NORMAL": rig.scene.accessor(0 * outward)}
    change = {"POSITION": rig.scene.accessor(rig.vertices * [1, 2, 3]), "NORMAL": rig.scene.accessor(outward)}
    mesh = rig.scene.mesh(rig.vertices, rig.faces, **attributes)
    rig.scene.document["meshes"][mesh] |= {"weights": [0.5]}
    rig.scene.document["meshes"][mesh]["primitives"][0]["targets"] = [change]
    rig.scene.node(mesh, skin=0)
    loaded = load_mesh(rig.scene.write(tmp_path / "rig.gltf"), "z")
    grown = rig.vertices * [1.5, 2, 2.5]
    assert_there(loaded, rig.expected(grown))
    linear = rig.matrices[2][:3, :3]
    expected = outward @ np.linalg.inv(linear)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(loaded.normals, expected, atol=1e-5)
    a, b, c = loaded.vertices[loaded.faces].transpose(1, 0, 2)
    volume = np.prod(SIDES * [1.5, 2, 2.5]) * abs(np.linalg.det(linear))
    assert np.einsum("fc,fc->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-5)


def test_joints_of_scale_zero_hide_their_mesh(tmp_path):
    rig = Rig(8)
    rig.scene.document["nodes"][0]["scale"] = [0, 0, 0]
    put_box(rig.scene)
    mesh = rig.load(tmp_path, rig.attributes())
    assert len(mesh.faces) == 12
    assert mesh.source["notes"] == ["mesh of scale 0 left out (1)"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.attributes(r.joints + 3), "IndexError"),
        (lambda r: r.skin.update(joints=[1, 2, 3, 0]) or r.attributes(), "3 inverse bind matrices for 4"),
        (lambda r: r.attributes(*[np.ones((8, 68))] * 2), "has 17 sets of joints, expected at most 16"),
        (lambda r: r.skin.update(joints=[99]) or r.attributes(), "KeyError"),
    ],
)
def test_a_broken_skin_is_refused_in_words(tmp_path, change, message):
    rig = Rig(9)
    refused(message, rig.load, tmp_path, change(rig))


def test_two_nodes_pose_one_mesh_by_weights_of_their_own(tmp_path):
    scene = Scene()
    put_box(scene, weights=[1])
    scene.node(0, translation=[50, 0, 0])
    primitive = scene.document["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": scene.accessor(np.tile([10.0, 0, 0], (8, 1)))}]
    scene.document["meshes"][0]["weights"] = [3]
    mesh = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    np.testing.assert_allclose(mesh.vertices.reshape(2, 8, 3).mean(1), [[10, 0, 0], [80, 0, 0]], atol=1e-5)


def test_what_hides_a_node_hides_those_below(tmp_path):
    scene = Scene()
    put_box(scene)
    leaf = put_box(scene, root=False, extensions={"KHR_node_visibility": {"visible": True}})
    middle = scene.node(root=False, children=[leaf])
    scene.node(children=[middle], extras={"hidden": True})
    mesh = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    assert len(mesh.faces) == 12
    assert mesh.source["notes"] == ["invisible mesh left out (1)"]


def test_a_copy_of_scale_zero_is_hidden_and_so_is_a_broken_skin_of_a_hidden_mesh(tmp_path):
    scene = Scene()
    scale = scene.accessor([[1, 1, 1], [0, 0, 0], [2, 2, 2]])
    put_box(scene, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": scale}}})
    put_box(scene, skin=5, extras={"hidden": True})
    mesh = load_mesh(scene.write(tmp_path / "m.gltf"), "z")
    assert len(mesh.faces) == 24
    assert mesh.source["notes"] == ["invisible mesh left out (1)", "mesh of scale 0 left out (1)"]


def test_a_scene_that_shows_nothing_says_what_is_hidden(tmp_path):
    scene = Scene()
    put_box(scene, extras={"visible": False})
    with pytest.raises(ObjectFolderError, match=r"holds no faces; .* \(invisible mesh left out \(1\)\)"):
        load_mesh(scene.write(tmp_path / "m.gltf"), "z")


@pytest.mark.skipif(not CASES.is_dir(), reason="needs the shared cases")
@pytest.mark.parametrize(
    "name",
    [
        "01_skinned_node_transform/rigged.glb",
        "23_gltf_morph_and_scenes/invisible_node.glb",
        "23_gltf_morph_and_scenes/invisible_node_near.glb",
    ],
)
def test_files_from_the_field(name):
    mesh = load_mesh(CASES / name, "y")
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0), [0.1, 0.06, 0.04], atol=1e-6)
    hidden = "invisible" in name
    assert mesh.source["notes"] == (["invisible mesh left out (1)"] if hidden else [])
