"""OpenUSD that the library of Pixar opens: `make test-extras` installs it."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from objectfolder.base.installation import install_command
from objectfolder.cli import app
from objectfolder.sim.body import density

WITH_USD = pytest.mark.skipif(not find_spec("pxr"), reason="usd-core is not installed")

pytestmark = pytest.mark.usefixtures("small_textures")


@pytest.fixture(scope="module")
def path(brick, body, tmp_path_factory):
    from objectfolder.sim.usd import write_usd

    return write_usd(brick, tmp_path_factory.mktemp("usd"), hulls=body.hulls)


@pytest.fixture
def stage(path):
    from pxr import Usd

    return Usd.Stage.Open(str(path))


@WITH_USD
def test_usd_is_in_metres_and_kilograms_with_z_up(stage):
    from pxr import UsdGeom, UsdPhysics

    assert stage.GetDefaultPrim().GetPath() == "/brick"
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1


@WITH_USD
def test_usd_holds_mass_centre_and_inertia(stage, body):
    from pxr import UsdPhysics

    prim = stage.GetDefaultPrim()
    assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(prim)
    assert mass.GetMassAttr().Get() == pytest.approx(body.mass, rel=1e-6)
    np.testing.assert_allclose(mass.GetCenterOfMassAttr().Get(), body.centre, atol=1e-8)
    axes = mass.GetPrincipalAxesAttr().Get()
    turn = Rotation.from_quat([*axes.imaginary, axes.real]).as_matrix()
    inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
    np.testing.assert_allclose(inertia, body.inertia, atol=1e-6 * body.inertia.max())


@WITH_USD
def test_usd_hulls_collide_and_the_surface_is_drawn(stage, brick, body):
    from pxr import UsdGeom, UsdPhysics, UsdShade

    colliders = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(colliders) == len(body.hulls)
    for prim, hull in zip(colliders, body.hulls):
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
        assert UsdGeom.Imageable(prim).GetPurposeAttr().Get() == "guide"
        np.testing.assert_allclose(UsdGeom.Mesh(prim).GetPointsAttr().Get(), hull.vertices, atol=1e-7)
        material = UsdShade.MaterialBindingAPI(prim).GetDirectBinding("physics").GetMaterial().GetPrim()
        contact = UsdPhysics.MaterialAPI(material)
        assert contact.GetDynamicFrictionAttr().Get() == pytest.approx(body.friction)
        assert contact.GetDensityAttr().Get() == pytest.approx(density(brick))
    look = UsdGeom.Mesh(stage.GetPrimAtPath("/brick/look"))
    points = np.asarray(look.GetPointsAttr().Get())
    np.testing.assert_allclose([points.min(0), points.max(0)], body.bounds, atol=0.002 * brick.scale)
    assert not look.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
    count = len(points)
    assert max(look.GetFaceVertexIndicesAttr().Get()) < count
    assert len(look.GetNormalsAttr().Get()) == count


@WITH_USD
def test_usd_texture_is_found_beside_the_file(stage, path):
    from pxr import UsdGeom, UsdShade

    texture = UsdShade.Shader(stage.GetPrimAtPath("/brick/materials/look/texture"))
    assert texture.GetInput("file").Get().resolvedPath == str(path.with_name("visual.png"))
    place = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/brick/look")).GetPrimvar("st")
    uv = np.asarray(place.Get())
    assert uv.shape[1] == 2
    assert (uv >= 0).all()
    assert (uv <= 1).all()


def test_without_the_library_the_usd_export_says_what_to_install(brick_path, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    done = CliRunner().invoke(app, ["export", "usd", str(tmp_path / "out"), str(brick_path)])
    assert install_command("usd") in str(done.exception)
    assert not (tmp_path / "out").exists()
