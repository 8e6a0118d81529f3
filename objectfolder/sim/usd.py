"""Export to OpenUSD: look and rigid body of an object, by the schemas UsdGeom, UsdShade and UsdPhysics."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from objectfolder.mesh.srgb import decode
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import RigidBody
from objectfolder.sim.export import OwnHulls, PhysicsModel, export_folder
from objectfolder.sim.hulls import MAX_HULLS
from objectfolder.sim.visual import GREY, ROUGHNESS, texture_image

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, Vt

TEXTURE = "visual.png"


def write_usd(file: ObjectFile, out: str | Path, max_hulls: int = MAX_HULLS, hulls: OwnHulls = None) -> Path:
    """Write ``OUT/<key>/<key>.usda`` with its texture: metres, kilograms, z up.

    The default prim, named after the object, is a rigid body with mass, centre and principal moments of
    `rigid_body`. Below it are the textured surface ``look`` and the convex hulls, which collide and are drawn
    as guides alone. Friction and density belong to a physics material.
    Otherwise as `objectfolder.sim.export.write_mjcf`.
    """
    with export_folder(file, out, max_hulls, hulls) as (new, model):
        fill_usd(new, model)
    return Path(out) / file.key / f"{file.key}.usda"


def fill_usd(folder: Path, model: PhysicsModel) -> None:
    """Write what `write_usd` does into a folder, which may hold other formats of the same object."""
    from pxr import Usd, UsdGeom, UsdPhysics

    body, look = model.body, model.look
    image = texture_image(look)
    if image is not None:
        image.save(folder / TEXTURE)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    _add_body(stage, body)
    for name, fact in model.facts.items():
        stage.GetDefaultPrim().SetCustomDataByKey(f"objectfolder:{name}", fact)
    _add_look(stage, body.key, look, image is not None)
    _add_hulls(stage, body, model.density)
    stage.GetRootLayer().Export(str(folder / f"{body.key}.usda"), comment="")


def _add_body(stage: "Usd.Stage", body: RigidBody) -> None:
    """Add the rigid body as the default prim."""
    from pxr import Gf, UsdGeom, UsdPhysics

    prim = UsdGeom.Xform.Define(stage, f"/{body.key}").GetPrim()
    stage.SetDefaultPrim(prim)
    UsdPhysics.RigidBodyAPI.Apply(prim)
    moments, axes = body.principal()
    x, y, z, w = map(float, axes.as_quat())
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(float(body.mass))
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, body.centre)))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*map(float, moments)))
    mass.CreatePrincipalAxesAttr(Gf.Quatf(w, x, y, z))


def _add_look(stage: "Usd.Stage", key: str, look: trimesh.Trimesh, textured: bool) -> None:
    """Add the surface with its material."""
    from pxr import Gf, Sdf, UsdGeom, UsdShade, Vt

    mesh = _add_mesh(stage, f"/{key}/look", look)
    mesh.CreateNormalsAttr(_vectors(look.vertex_normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    material = UsdShade.Material.Define(stage, f"/{key}/materials/look")
    shader = UsdShade.Shader.Define(stage, f"/{key}/materials/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(ROUGHNESS)
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    color = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if textured:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        place = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
        uv = getattr(look.visual, "uv", None)  # a textured mesh has them
        place.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv, np.float32)))
        reader = UsdShade.Shader.Define(stage, f"/{key}/materials/look/st")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        texture = UsdShade.Shader.Define(stage, f"/{key}/materials/look/texture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{TEXTURE}"))
        texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        for side in ("wrapS", "wrapT"):
            texture.CreateInput(side, Sdf.ValueTypeNames.Token).Set("repeat")
        output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(output)
        color.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
    else:
        color.Set(Gf.Vec3f(*[float(decode(np.float64(GREY)))] * 3))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _add_hulls(stage: "Usd.Stage", body: RigidBody, filled: float) -> None:
    """Add the colliders with their physics material; ``filled`` is the density, kg/m^3."""
    from pxr import UsdGeom, UsdPhysics, UsdShade

    material = UsdShade.Material.Define(stage, f"/{body.key}/materials/contact")
    contact = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    contact.CreateStaticFrictionAttr(float(body.friction))
    contact.CreateDynamicFrictionAttr(float(body.friction))
    contact.CreateDensityAttr(float(filled))
    for k, hull in enumerate(body.hulls):
        mesh = _add_mesh(stage, f"/{body.key}/hull{k:02d}", hull)
        mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
        prim = mesh.GetPrim()
        UsdPhysics.CollisionAPI.Apply(prim)
        shape = UsdPhysics.MeshCollisionAPI.Apply(prim)
        shape.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, materialPurpose="physics")


def _add_mesh(stage: "Usd.Stage", path: str, mesh: trimesh.Trimesh) -> "UsdGeom.Mesh":
    from pxr import UsdGeom, Vt

    added = UsdGeom.Mesh.Define(stage, path)
    added.CreatePointsAttr(_vectors(mesh.vertices))
    added.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(mesh.faces)))
    corners = np.ascontiguousarray(mesh.faces.reshape(-1), np.int32)
    added.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners))
    added.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    added.CreateExtentAttr(_vectors(mesh.bounds))
    return added


def _vectors(values: np.ndarray) -> "Vt.Vec3fArray":
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))
