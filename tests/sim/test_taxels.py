"""Taxels that MuJoCo's own tactile sensor reads."""

import mujoco
import numpy as np
import pytest
import trimesh
from refusals import refused

from objectfolder.sim.body import add_body
from objectfolder.sim.taxels import add_taxels, read_taxels, taxel_mesh
from objectfolder.touch.camera import gel_sag
from objectfolder.touch.profiles import load_profile

DIGIT = load_profile("digit")


def pad(spec, **options):
    """A finger whose gel faces +x, with its apex at the origin."""
    finger = spec.worldbody.add_body(name="finger")
    finger.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.004, 0.01, 0.012], pos=[-0.004, 0, 0])
    add_taxels(spec, "finger", DIGIT, **options)


def forward(spec, velocity=(0, 0, 0), contact=True):
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:3] = velocity[: model.nv]
    mujoco.mj_forward(model, data)
    assert bool(data.ncon) == contact
    return model, data


def test_taxels_are_on_the_gel_in_the_order_of_the_image():
    mesh = taxel_mesh(DIGIT, 12, 9)
    points = np.asarray(mesh.vertices).reshape(12, 9, 3)
    np.testing.assert_allclose(
        points[..., 0], -gel_sag(DIGIT, np.hypot(points[..., 1], points[..., 2])), atol=1e-9
    )
    assert (np.diff(points[..., 1], axis=1) < 0).all()  # column 0 is left, +y
    assert (np.diff(points[..., 2], axis=0) < 0).all()  # row 0 is the top, +z
    assert (mesh.face_normals[:, 0] > 0.9).all()


def test_a_flat_face_is_as_deep_in_each_taxel_as_it_reaches_past_it():
    """The face of a box, 1 mm into the gel's apex, reaches past a taxel by 1 mm less the gel's sag."""
    spec = mujoco.MjSpec()
    pad(spec, rows=12, columns=9)
    body = spec.worldbody.add_body(name="box", pos=[0.015 - 0.001, 0, 0])
    body.add_freejoint()
    box = trimesh.creation.box((0.03, 0.03, 0.03))
    spec.add_mesh(name="box", uservert=box.vertices.ravel(), userface=box.faces.ravel(), needsdf=1)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="box")
    depth, *speeds = read_taxels(*forward(spec, (0, 0.2, 0.1)))
    truth = 0.001 + taxel_mesh(DIGIT, 12, 9).vertices[:, 0].reshape(12, 9)
    np.testing.assert_allclose(depth, truth.clip(0), atol=1e-6)
    assert (depth > 0).any()
    assert (depth == 0).any()
    # Along y, which is image right, and z, up: less by the cosine of the gel's tilt.
    for speed, truth in zip(speeds, (0.2, 0.1)):
        np.testing.assert_allclose(speed[depth > 0], truth, rtol=0.08)
    assert (np.stack(speeds)[:, depth == 0] == 0).all()


def test_an_object_is_felt_where_it_touches(body):
    spec = mujoco.MjSpec()
    add_body(spec, body, "brick").pos = [-body.bounds[0, 0] - 0.0008, 0.008, 0]
    pad(spec, name="skin")
    depth = read_taxels(*forward(spec), name="skin")[0]
    truth = 0.0008 + taxel_mesh(DIGIT).vertices[:, 0].reshape(depth.shape)
    assert depth.shape == (16, 12)
    inside = truth > 3e-4
    np.testing.assert_allclose(depth[inside], truth[inside], atol=2e-4)
    assert (depth[truth < -2e-4] == 0).all()


def test_no_contact_reads_zero():
    spec = mujoco.MjSpec()
    pad(spec)
    assert (read_taxels(*forward(spec, contact=False)) == 0).all()


def test_errors_name_what_is_wrong():
    spec = mujoco.MjSpec()
    pad(spec)
    for given, message in (
        (("thumb", DIGIT), "no body 'thumb'; expected one of world, finger"),
        (("finger", DIGIT), "has a 'taxels' already"),
        (("finger", "finger", 16, 12, (0, 0, 0), (1, 0, 0, 0), "more"), "unknown sensor profile 'finger'"),
        (("finger", DIGIT, 1, 9, (0, 0, 0), (1, 0, 0, 0), "more"), "taxels: rows"),
    ):
        refused(message, add_taxels, spec, *given)


@pytest.mark.parametrize(("rows", "columns"), [(12, 16), (16, 12), (2, 2), (7, 5)])
def test_the_model_knows_the_number_of_columns(rows, columns):
    spec = mujoco.MjSpec()
    pad(spec, rows=rows, columns=columns)
    spec.add_sensor(name="clock", type=mujoco.mjtSensor.mjSENS_CLOCK)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.sensordata[: 3 * rows * columns] = np.arange(3 * rows * columns)
    read = read_taxels(model, data)
    assert read.shape == (3, rows, columns)
    np.testing.assert_array_equal(read[0, 1, :2], [columns, columns + 1])
    for name in ("skin", "clock"):
        refused(rf"no taxels '{name}', but \['taxels'\]", read_taxels, model, data, name=name)


def test_taxels_of_another_simulation_or_of_none_are_refused():
    spec = mujoco.MjSpec()
    pad(spec)
    model, other = spec.compile(), mujoco.MjSpec().compile()
    data = mujoco.MjData(model)
    for wrong in (None, model, mujoco.MjData(other)):
        refused(r"^data is .*, expected the mujoco\.MjData of the model", read_taxels, model, wrong)
    data.sensordata[7] = np.nan
    refused("taxels 'taxels' read numbers that are not finite at 0 s", read_taxels, model, data)


def test_the_defaults_of_a_scene_do_not_change_the_taxels():
    scene = """<mujoco><default><mesh scale="0.001 0.001 0.001"/>
      <geom type="sphere" size="0.01" mass="3" margin="0.1" rgba="1 0 0 1"/></default></mujoco>"""
    models = []
    for spec in (mujoco.MjSpec(), mujoco.MjSpec.from_string(scene)):
        pad(spec)
        models.append(spec.compile())
    own, other = models
    for name in [name for name in dir(own) if name.startswith(("geom_", "mesh_"))]:
        rows = own.geom("taxels").id if name.startswith("geom_") else ...
        np.testing.assert_array_equal(getattr(other, name)[rows], getattr(own, name)[rows], err_msg=name)
