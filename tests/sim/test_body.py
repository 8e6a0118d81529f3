import mujoco
import numpy as np
import pytest
import trimesh
from brick import without
from refusals import refused
from solids import box, join, sphere

from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.materials import material
from objectfolder.mesh.gridcodec import pack_grid
from objectfolder.mesh.sdf import distance_grid
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import RigidBody, add_body, body_density, density, rigid_body, rotation
from objectfolder.sim.hulls import convex_hulls
from objectfolder.stored.header import format_name

SCALE = 0.2


def object_of(solid, material="wood", resolution=96) -> ObjectFile:
    """An Object File of a shape and nothing else; the shape is in the unit frame."""
    values, band = distance_grid(*solid, resolution)
    packed, predictor = pack_grid(values)
    geometry = {"kind": "distance_grid", "resolution": resolution, "band": band, "predictor": predictor}
    header = {"format": format_name(), "key": "thing", "material": material, "scale": SCALE}
    return ObjectFile(header | {"geometry": geometry}, {"geometry.distances": packed})


def changed(file, **header) -> ObjectFile:
    """The same Object File with other fields in its header, without those of None."""
    told = (file.header | header).items()
    return ObjectFile({name: value for name, value in told if value is not None}, file.tensors)


def cuboid(sides, centre, mass):
    """Centre, mass and inertia about the centre of a cuboid."""
    x, y, z = np.square(sides)
    return np.array(centre), mass, mass / 12 * np.diag([y + z, x + z, x + y])


def together(*bodies):
    """Centre, mass and inertia of several bodies, by the parallel axis theorem."""
    mass = sum(m for _, m, _ in bodies)
    centre = sum(m * c for c, m, _ in bodies) / mass
    away = [c - centre for c, _, _ in bodies]
    about = (i + m * (d @ d * np.eye(3) - np.outer(d, d)) for d, (_, m, i) in zip(away, bodies))
    return centre, mass, sum(about)


def skew_body(name="thing") -> RigidBody:
    """A body none of whose products of inertia is zero, and two hulls that are off its centre."""
    left, right = (
        trimesh.Trimesh(*box((0.02, 0.03, 0.05), centre=c), process=False)
        for c in ([0.02, 0.01, 0.03], [0.05, 0, 0])
    )
    root = np.array([[3.0, 0.4, 0.2], [0, 2.5, -0.5], [0, 0, 2.0]])
    return RigidBody(
        name, (left, right), 0.3, np.array([0.03, 0.01, 0.02]), 1e-5 * root @ root.T, 0.45, np.ones((2, 3))
    )


@pytest.fixture(scope="module")
def bracket():
    """An L of two cuboids, which touch; longest side 1."""
    solid = join(box((0.6, 0.4, 0.2), centre=(0, 0, -0.4)), box((0.2, 0.4, 0.8), centre=(-0.2, 0, 0.1)))
    return object_of(solid)


def test_mass_of_a_bracket(bracket):
    rho = material("wood").density * SCALE**3
    foot = cuboid(np.array([0.6, 0.4, 0.2]) * SCALE, np.array([0, 0, -0.4]) * SCALE, 0.048 * rho)
    post = cuboid(np.array([0.2, 0.4, 0.8]) * SCALE, np.array([-0.2, 0, 0.1]) * SCALE, 0.064 * rho)
    centre, mass, inertia = together(foot, post)
    body = rigid_body(bracket, [bracket.to_mesh().convex_hull])
    assert body.mass == pytest.approx(mass, rel=0.01)
    np.testing.assert_allclose(body.centre, centre, atol=1e-3 * SCALE)
    np.testing.assert_allclose(body.inertia, inertia, atol=0.01 * inertia.max())
    assert abs(inertia[0, 2]) > 0.1 * inertia.max()
    assert body.friction == material("wood").friction
    np.testing.assert_array_equal(body.bounds, bracket.bounds)


def test_mass_of_a_ball():
    ball = object_of(sphere(0.5), "steel", 48)
    body = rigid_body(ball, [ball.to_mesh().convex_hull])
    mass = 7850 * np.pi / 6 * SCALE**3
    assert body.mass == pytest.approx(mass, rel=0.005)
    own = mass / 10 * SCALE**2
    np.testing.assert_allclose(body.inertia, own * np.eye(3), atol=1e-2 * own)
    np.testing.assert_allclose(body.centre, 0, atol=1e-3 * SCALE)


def test_mass_is_that_of_the_source_if_the_file_stores_it(brick):
    """The analytic brick, exactly: the grid that its surface is stored in rounds its edges off."""
    sides = np.array([1.0, 0.6, 0.3]) * brick.scale
    _, mass, inertia = cuboid(sides, np.zeros(3), density(brick) * sides.prod())
    body = rigid_body(brick, [brick.to_mesh().convex_hull])
    assert body.mass == pytest.approx(mass, rel=1e-12)
    np.testing.assert_allclose(body.inertia, inertia, atol=1e-12 * inertia.max())
    np.testing.assert_allclose(body.centre, 0, atol=1e-15)


def test_a_real_object_has_the_mass_that_it_was_given(brick):
    hulls = [brick.to_mesh().convex_hull]
    solid, real = (rigid_body(file, hulls) for file in (brick, changed(brick, mass=0.05)))
    assert real.mass == 0.05
    np.testing.assert_allclose(real.inertia, solid.inertia * 0.05 / solid.mass, rtol=1e-12)
    np.testing.assert_array_equal(real.centre, solid.centre)
    assert body_density(changed(brick, mass=0.05)) == pytest.approx(0.05 / (0.1 * 0.06 * 0.03))
    assert density(changed(brick, mass=0.05)) == body_density(brick) == density(brick) == 1070


def test_products_of_inertia_keep_their_places(brick):
    told = {"volume": 0.2, "centre": [0.1, 0, -0.1], "inertia": [3e-2, 2.5e-2, 2e-2, 1e-3, 2e-3, 3e-3]}
    body = rigid_body(changed(brick, solid=told), [brick.to_mesh().convex_hull])
    expected = [[3e-2, 1e-3, 2e-3], [1e-3, 2.5e-2, 3e-3], [2e-3, 3e-3, 2e-2]]
    np.testing.assert_allclose(body.inertia, 1070 * brick.scale**5 * np.array(expected))
    np.testing.assert_allclose(body.centre, brick.scale * np.array([0.1, 0, -0.1]))


@pytest.mark.parametrize("inertia", [[1, 1, 3, 0, 0, 0], [1, 1, -1, 0, 0, 0], [1, 1, 1, 2, 0, 0]])
def test_impossible_inertia_is_refused(brick, inertia):
    told = {**brick.header["solid"], "inertia": [1e-3 * value for value in inertia]}
    with pytest.raises(ObjectFolderError, match="brick: no body has the principal moments of inertia"):
        rigid_body(changed(brick, solid=told), [brick.to_mesh().convex_hull])


def test_density_is_the_files_own(brick):
    assert density(brick) == 1070
    light = brick.header["material_properties"] | {"density": 500.0}
    assert density(changed(brick, material_properties=light)) == 500
    assert density(changed(brick, material_properties=None, material="glass")) == 2600


def test_unknown_density_is_refused(bracket):
    with pytest.raises(
        ObjectFolderError, match=r"thing: its density is not known: .* 'unknown' is none of ceramic"
    ):
        density(changed(bracket, material="unknown"))


def test_hulls_of_another_frame_are_refused(brick):
    hull = brick.to_mesh().convex_hull
    for wrong in (hull.copy().apply_scale(10), hull.copy().apply_translation([0.02, 0, 0])):
        refused(r"brick: its hulls reach from .* another object or frame", rigid_body, brick, [wrong])
    refused("brick: no hulls", rigid_body, brick, [])
    refused("brick: hulls is 'hulls', expected a list of meshes", rigid_body, brick, "hulls")


def test_object_without_geometry_has_no_mass(brick):
    with pytest.raises(ObjectFolderError, match="brick: the file holds no geometry"):
        rigid_body(without(brick, "geometry"), [brick.to_mesh().convex_hull])


def test_body_in_mujoco_is_the_same():
    body, spec = skew_body(), mujoco.MjSpec()
    add_body(spec, body, "a")
    add_body(spec, body, "b")
    model = spec.compile()
    assert model.njnt == 2
    for name in "ab":
        found = model.body(name)
        turn = rotation(found.iquat)
        assert found.mass[0] == pytest.approx(0.3)
        np.testing.assert_allclose(found.ipos, body.centre)
        np.testing.assert_allclose(turn @ np.diag(found.inertia) @ turn.T, body.inertia, atol=1e-12)
        assert model.joint(name).type == mujoco.mjtJoint.mjJNT_FREE
        for k in range(2):
            geom = model.geom(f"{name}_hull{k}")
            assert geom.condim == 4
            np.testing.assert_allclose(geom.friction, [0.45, 0.005, 0.0001])


def test_hulls_in_mujoco_are_in_place():
    body, spec = skew_body(), mujoco.MjSpec()
    add_body(spec, body)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for k, hull in enumerate(body.hulls):
        geom = model.geom(f"object_hull{k}")
        start, count = model.mesh_vertadr[geom.dataid[0]], model.mesh_vertnum[geom.dataid[0]]
        turn = data.geom(geom.id).xmat.reshape(3, 3)
        vertices = model.mesh_vert[start : start + count] @ turn.T + data.geom(geom.id).xpos
        assert len(vertices) == 8
        found = sorted(vertices.round(6).tolist())
        np.testing.assert_allclose(found, sorted(hull.vertices.tolist()), atol=2e-6)


def test_torque_turns_a_body_by_its_inertia():
    body, spec = skew_body(), mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    add_body(spec, body)
    model = spec.compile()
    data = mujoco.MjData(model)
    torque = np.array([0.01, -0.02, 0.03])
    data.xfrc_applied[1] = [0, 0, 0, *torque]
    mujoco.mj_forward(model, data)
    spin = np.linalg.solve(body.inertia, torque)  # at rest the frames agree
    np.testing.assert_allclose(data.qacc[3:], spin, rtol=1e-6)
    left = data.qacc[:3] + np.cross(spin, body.centre)
    np.testing.assert_allclose(left, 0, atol=1e-6 * np.abs(data.qacc).max())


def test_object_comes_to_rest_on_a_table(bracket):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    add_body(spec, rigid_body(bracket, convex_hulls(bracket.to_mesh()))).pos = [0, 0, 0.55 * SCALE]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert np.abs(data.qvel).max() < 1e-3
    assert data.qpos[2] == pytest.approx(0.5 * SCALE, abs=0.01 * SCALE)
    assert abs(data.qpos[3]) > 0.9999  # it has not tipped over


#: Default classes that robots' scenes have, and that would shrink, hide, move or harden what is added.
SCENE = """<mujoco><compiler {}/><default>
  <mesh scale="0.001 0.001 0.001"/><joint damping="5" armature="1" frictionloss="2"/>
  <geom type="box" contype="0" conaffinity="0" pos="0 0 1" euler="0 90 0" margin="0.1" gap="0.1" mass="3"
        solref="0.004 2" solimp="0.99 0.999 0.1" solmix="3" priority="2" group="4" rgba="1 0 0 0"/>
</default></mujoco>"""


def test_the_defaults_of_a_scene_do_not_change_a_body():
    models = []
    for spec in (mujoco.MjSpec(), mujoco.MjSpec.from_string(SCENE.format('alignfree="true"'))):
        add_body(spec, skew_body(), "thing")
        models.append(spec.compile())
    own, other = models
    arrays = [name for name in dir(own) if name.startswith(("geom_", "body_", "mesh_", "jnt_", "dof_"))]
    assert len(arrays) > 100
    for name in arrays:
        np.testing.assert_array_equal(getattr(other, name), getattr(own, name), err_msg=name)


@pytest.mark.parametrize(
    ("setting", "told"),
    [("inertiafromgeom", "true"), ("settotalmass", "2"), ("boundmass", "0.31"), ("boundinertia", "1e-3")],
)
def test_settings_that_change_a_body_are_refused(setting, told):
    spec = mujoco.MjSpec.from_string(SCENE.format(f'{setting}="{told}"'))
    with pytest.raises(ObjectFolderError, match=rf"thing: the scene's compiler .* 0\.3 kg, .*: {setting} is"):
        add_body(spec, skew_body(), "thing")


def test_settings_that_leave_a_body_as_it_is_are_not():
    spec = mujoco.MjSpec.from_string(SCENE.format('boundmass="0.29" boundinertia="1e-6"'))
    add_body(spec, skew_body(), "thing")
    assert spec.compile().body("thing").mass[0] == 0.3


def test_only_a_child_of_the_world_is_free():
    spec = mujoco.MjSpec()
    tray = spec.worldbody.add_body(name="tray", pos=[0, 0, 1])
    tray.add_freejoint()
    tray.add_geom(size=[0.01, 0, 0])
    add_body(spec, skew_body(), "on_tray", tray).pos = [0, 0, 0.1]
    add_body(spec, skew_body(), "on_world", spec.worldbody)
    add_body(spec, skew_body(), "fixed", free=False)
    with pytest.raises(ObjectFolderError, match=r"more: only children of the world .* parent is 'tray'"):
        add_body(spec, skew_body(), "more", tray, free=True)
    model = spec.compile()
    joints = {name: int(model.body(name).jntnum[0]) for name in ("on_tray", "on_world", "fixed")}
    assert joints == {"on_tray": 0, "on_world": 1, "fixed": 0}
    data = mujoco.MjData(model)
    data.qpos[:7] = [1, 2, 3, np.sqrt(0.5), np.sqrt(0.5), 0, 0]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("on_tray").xpos, [1, 2 - 0.1, 3], atol=1e-12)
