"""OpenUSD that the library of Pixar opens: `make test-extras` installs it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from objectfolder.sim.body import density
from objectfolder.sim.usd import write_usd

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

pytestmark = pytest.mark.usefixtures("small_textures")


@pytest.fixture(scope="module")
def path(brick, body, tmp_path_factory):
    return write_usd(brick, tmp_path_factory.mktemp("usd"), hulls=body.hulls)


@pytest.fixture
def stage(path):
    return Usd.Stage.Open(str(path))


def test_usd_is_in_metres_and_kilograms_with_z_up(stage):
    assert stage.GetDefaultPrim().GetPath() == "/brick"
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1


def test_usd_holds_mass_centre_and_inertia(stage, body):
    prim = stage.GetDefaultPrim()
    assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(prim)
    assert mass.GetMassAttr().Get() == pytest.approx(body.mass, rel=1e-6)
    np.testing.assert_allclose(mass.GetCenterOfMassAttr().Get(), body.centre, atol=1e-8)
    axes = mass.GetPrincipalAxesAttr().Get()
    turn = Rotation.from_quat([*axes.imaginary, axes.real]).as_matrix()
    inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
    np.testing.assert_allclose(inertia, body.inertia, atol=1e-6 * body.inertia.max())


def test_usd_hulls_collide_and_the_surface_is_drawn(stage, brick, body):
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


def test_usd_texture_is_found_beside_the_file(stage, path):
    texture = UsdShade.Shader(stage.GetPrimAtPath("/brick/materials/look/texture"))
    assert texture.GetInput("file").Get().resolvedPath == str(path.with_name("visual.png"))
    place = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/brick/look")).GetPrimvar("st")
    uv = np.asarray(place.Get())
    assert uv.shape[1] == 2
    assert (uv >= 0).all()
    assert (uv <= 1).all()
