"""Export to OpenUSD: look and rigid body of an object, valid for SimReady's profile Robotics-Prop 4.0.0."""

import datetime
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from PIL import Image

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.mesh.srgb import decode
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import RigidBody
from objectfolder.sim.drawing import draw_look
from objectfolder.sim.export import OwnHulls, PhysicsModel, export_folder
from objectfolder.sim.hulls import MAX_HULLS
from objectfolder.sim.visual import GREY, ROUGHNESS, texture_image

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, Vt

TEXTURE = "visual.png"
FOLDER = "usd"  #: below that of the object; profiles of SimReady ask for one
THUMBNAIL = ".thumbs/256x256"  #: folder of the thumbnail, below that


@dataclass(frozen=True)
class AssetInfo:
    """What an Object File does not know of its object, and catalogues of assets ask.

    Raises ObjectFolderError if a text is empty, or the code is none of Wikidata.
    """

    label: str = "physical object"  #: semantic class
    qcode: str = "Q223557"  #: of the class in Wikidata; the default is that of "physical object"
    author: str = "unknown"
    licence: str = "unknown"  #: of the mesh that the object was made from, such as CC-BY-4.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value.strip():
                raise ObjectFolderError(f"{name} is empty, expected a text, or leave it out")
        if not re.fullmatch(r"Q[0-9]+", self.qcode):
            raise ObjectFolderError(
                f"qcode is {quoted(self.qcode)}, expected Q and digits, the code of a class in Wikidata, "
                "such as Q223557"
            )


def write_usd(
    file: ObjectFile, out: str | Path, max_hulls: int = MAX_HULLS, hulls: OwnHulls = None,
    info: AssetInfo = AssetInfo(),
) -> Path:  # fmt: skip
    """Write ``OUT/<key>/usd/<key>.usd`` with its texture and thumbnail: metres, kilograms, z up.

    The default prim, named after the object, is a rigid body with mass, centre and principal moments of
    `rigid_body`, and has the semantic labels. Below it are the textured surface ``look`` and the convex
    hulls, which collide and are drawn as guides alone. Friction and density belong to a physics material.
    Otherwise as `objectfolder.sim.export.write_mjcf`.
    """
    with export_folder(file, out, max_hulls, hulls) as (new, model):
        fill_usd(new, model, info)
    return Path(out) / file.key / FOLDER / f"{file.key}.usd"


def fill_usd(folder: Path, model: PhysicsModel, info: AssetInfo = AssetInfo()) -> None:
    """Write what `write_usd` does into a folder, which may hold other formats of the same object."""
    from pxr import Usd, UsdGeom, UsdPhysics

    new, body, look = folder / FOLDER, model.body, model.look
    (new / THUMBNAIL).mkdir(parents=True)
    image = texture_image(look)
    if image is not None:
        image.save(new / TEXTURE)
    Image.fromarray(draw_look(look)).save(new / THUMBNAIL / f"{body.key}.usd.png")
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    _add_body(stage, body)
    for name, fact in model.facts.items():
        stage.GetDefaultPrim().SetCustomDataByKey(f"objectfolder:{name}", fact)
    UsdGeom.Scope.Define(stage, f"/{body.key}/materials")
    _add_look(stage, body.key, look, image is not None)
    _add_hulls(stage, body, model.density)
    _add_labels(stage, model.file, info)
    layer = stage.GetRootLayer()
    layer.customLayerData = {"SimReady_Metadata": _metadata(model.file, body, info)}
    layer.Export(str(new / f"{body.key}.usd"), comment="")


def _metadata(file: ObjectFile, body: RigidBody, info: AssetInfo) -> dict[str, object]:
    """Return where the asset is from, as SimReady names it (requirement SR.004)."""
    from pxr import Gf

    return {
        "asset_name": file.key,
        "asset_type": "prop",
        "author": info.author,
        "asset_license": info.licence,
        "category": info.label,
        "qcode": info.qcode,
        "source_file": f"{file.key}.safetensors",
        "usd_date_generated": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "rigid_body_count": 1,
        "asset_extents": Gf.Vec3f(*map(float, np.ptp(file.bounds, axis=0))),
        "mass": float(body.mass),
    }


def _add_labels(stage: "Usd.Stage", file: ObjectFile, info: AssetInfo) -> None:
    """Label the object by its class, and its materials by what they are."""
    from pxr import UsdSemantics, Vt

    prim, material = stage.GetDefaultPrim(), file.header["material"]
    labels = [(prim, "class", info.label), (prim, "wikidata_qcode", info.qcode)]
    labels += [(one, "material", material) for one in prim.GetChild("materials").GetChildren()]
    for one, taxonomy, text in labels:
        UsdSemantics.LabelsAPI.Apply(one, taxonomy).CreateLabelsAttr(Vt.TokenArray([text]))


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
        mesh.CreateNormalsAttr(_vectors(hull.face_normals))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.uniform)
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
