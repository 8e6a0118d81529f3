"""OpenUSD that the library of Pixar opens: `make test-extras` installs it."""

from importlib.metadata import version

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation

from objectfolder.sim.body import density
from objectfolder.sim.usd import AssetInfo, write_usd

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade

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


def test_usd_labels_object_and_materials(stage, brick, body):
    root, labels = stage.GetDefaultPrim(), {}
    for prim in stage.Traverse():
        for taxonomy in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
            found = UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get()
            labels[str(prim.GetPath()), taxonomy] = [*found]
    assert labels == {
        ("/brick", "class"): ["physical object"],
        ("/brick", "wikidata_qcode"): ["Q223557"],
        ("/brick/materials/look", "material"): ["plastic"],
        ("/brick/materials/contact", "material"): ["plastic"],
    }
    said = stage.GetRootLayer().customLayerData["SimReady_Metadata"]
    assert said["mass"] == pytest.approx(body.mass)
    np.testing.assert_allclose(said["asset_extents"], np.ptp(brick.bounds, axis=0), rtol=1e-6)
    assert root.HasAPI(UsdPhysics.MassAPI)


def test_usd_info_that_makes_no_sense_is_refused():
    refused("qcode is 'mug', expected Q and digits", AssetInfo, qcode="mug")
    refused("licence is empty", AssetInfo, licence=" ")


def test_usd_core_finds_no_error(stage):
    """All validators of OpenUSD, which its older ComplianceChecker became."""
    validation = pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no UsdValidation")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    errors = validation.ValidationContext(validators).Validate(stage)
    assert [(str(error.GetName()), error.GetMessage()) for error in errors] == []


def test_usd_is_simready(path, record_property):
    """The profile of props that belong to no simulator; the report says which version passed."""
    simready = pytest.importorskip("simready.validate", reason="simready-validate is not installed")
    pytest.importorskip("simready.foundation.tier_core", reason="the tier of SimReady is not installed")
    simready.initialize([], [], [])
    result = simready.validate_asset(simready.AssetValidationConfig(str(path), "Robotics-Prop", "4.0.0"))
    verdict = {name: one for name, one in result.features_summary.items() if one["blocking_failure"]}
    record_property("simready-foundation-tier-core", version("simready-foundation-tier-core"))
    record_property("Robotics-Prop 4.0.0", "failed" if verdict else "passed")
    assert verdict == {}, [str(issue.message) for issue in result.issues]
    assert simready.features_summary_passed(result.features_summary)


def test_usd_passes_the_default_rules_of_the_asset_validator(path):
    validator = pytest.importorskip(
        "omni.asset_validator", reason="omniverse-asset-validator is not installed"
    )
    results = validator.ValidationEngine().validate(str(path))
    found = [str(issue.message) for issue in results.issues() if issue.severity.name in ("ERROR", "FAILURE")]
    assert found == []
