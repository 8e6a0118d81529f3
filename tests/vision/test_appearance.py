import numpy as np
from solids import sphere

from objectfolder.mesh import srgb
from objectfolder.mesh.textured import PLAIN, TexturedMesh
from objectfolder.vision.appearance import appearance_at
from objectfolder.vision.scene import Scene

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) - [0.5, 0.5, 0]
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_texels_are_found_at_their_centres_and_between():
    texture = np.random.default_rng(0).integers(0, 256, (4, 8, 3), dtype=np.uint8)
    scene = Scene(TexturedMesh(SQUARE, FACES, uv=SQUARE[:, :2] + 0.5, texture=texture))
    linear = srgb.decode(texture / 255)
    row, column = (x.ravel() for x in np.mgrid[:4, :8])
    centres = np.stack([(column + 0.5) / 8, 1 - (row + 0.5) / 4, np.full(32, 0.7)], 1) - [0.5, 0.5, 0.5]
    color, normals = appearance_at(scene, centres)
    np.testing.assert_allclose(color, linear[row, column], atol=1e-6)
    np.testing.assert_allclose(normals, np.tile([0, 0, 1], (32, 1)), atol=1e-6)
    between = centres[:1] + np.array([1 / 16, 0, 0])
    np.testing.assert_allclose(appearance_at(scene, between)[0], linear[:1, :2].mean(1), atol=1e-6)
    corner = np.array([[-0.5, 0.5, 0.0]])  # the texture repeats
    wrapped = (linear[0, 0] + linear[0, 7] + linear[3, 0] + linear[3, 7]) / 4
    np.testing.assert_allclose(appearance_at(scene, corner)[0][0], wrapped, atol=1e-6)


def test_normals_are_the_meshs_or_its_faces():
    vertices, faces = sphere(0.4, 2)
    smooth = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    points = 0.41 * smooth[:50] + 1e-3
    exact = points / np.linalg.norm(points, axis=1, keepdims=True)
    angles = []
    for normals in (smooth, None):
        color, found = appearance_at(Scene(TexturedMesh(vertices, faces, normals=normals)), points)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(color, PLAIN, atol=1e-6)
        angles.append(np.degrees(np.arccos((found * exact).sum(1).clip(-1, 1))))
    assert angles[0].max() < 1
    assert angles[1].mean() > 3
