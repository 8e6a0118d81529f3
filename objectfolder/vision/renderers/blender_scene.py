"""Build a scene and render the views requested on stdin; run by Blender or a Python with bpy.

This script imports nothing of this project. Its argument is the folder that `CyclesRenderer` has filled. Each
line of stdin is a view as JSON: its image is written to ``image.npy`` in the folder, then `DONE` to stdout.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

DONE = "objectfolder: rendered"  #: printed when the scene is ready and after each view
MIN_VERSION = (4, 2)  # the first version whose principled BSDF has the sockets used here


def main(folder: Path) -> None:
    """Build the scene of a folder, report that it is ready, then render views until stdin ends."""
    import bpy

    if bpy.app.version < MIN_VERSION:
        found, wanted = (".".join(map(str, version)) for version in (bpy.app.version, MIN_VERSION))
        sys.exit(f"this is Blender {found}, expected {wanted} or newer")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    settings = json.loads((folder / "scene.json").read_text())
    _set_up_cycles(scene, settings)
    _add_object(bpy, scene, folder, settings)
    light = bpy.data.lights.new("light", "POINT")
    # Blender's watts: an isotropic point light of power P has the radiant intensity P / 4 pi.
    light.energy = 4 * math.pi * settings["light_intensity"]
    light.shadow_soft_size = 0.0
    light_object = bpy.data.objects.new("light", light)
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit, camera.sensor_width = "HORIZONTAL", 36.0
    camera.clip_start, camera.clip_end = 1e-3, 1e3
    camera_object = scene.camera = bpy.data.objects.new("camera", camera)
    for item in (light_object, camera_object):
        scene.collection.objects.link(item)
    if settings["ambient"]:
        world = scene.world = bpy.data.worlds.new("room")
        world.use_nodes = True
        background = world.node_tree.nodes["Background"]
        background.inputs["Color"].default_value = (1, 1, 1, 1)
        background.inputs["Strength"].default_value = settings["ambient"]
    print(f"{DONE} {bpy.app.version_string}", flush=True)
    for line in sys.stdin:
        view = json.loads(line)
        camera_object.matrix_world = np.transpose(view["camera_to_world"])  # Blender expects columns
        light_object.location = view["light"]
        camera.lens = view["focal"] / view["width"] * camera.sensor_width
        camera.shift_x, camera.shift_y = view["shift"]
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = view["pixel_aspect"]
        scene.render.resolution_x, scene.render.resolution_y = view["width"], view["height"]
        scene.cycles.samples, scene.cycles.seed = view["samples"], view["seed"]
        np.save(folder / "image.npy", _render(bpy, scene, folder))
        print(DONE, flush=True)


def _set_up_cycles(scene: Any, settings: dict[str, Any]) -> None:
    scene.render.engine = "CYCLES"
    cycles, render = scene.cycles, scene.render
    cycles.device = "CPU"
    render.threads_mode, render.threads = "FIXED", 1
    render.use_persistent_data = True
    render.resolution_percentage = 100
    render.film_transparent = True
    render.image_settings.file_format = "OPEN_EXR"  # linear: no view transform, no dither
    render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
    render.use_compositing = render.use_sequencer = False
    # As unbiased as possible: no clamping, glossy blur, light threshold or denoising.
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = cycles.light_sampling_threshold = 0.0
    cycles.pixel_filter_type = "BOX"
    bounces = settings["bounces"]
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces


def _add_object(bpy: Any, scene: Any, folder: Path, settings: dict[str, Any]) -> None:
    # From arrays, since Blender's importers rotate the axes.
    with np.load(folder / "mesh.npz", allow_pickle=False) as arrays:
        names = ("vertices", "faces", "uv", "colors", "normals")
        vertices, faces, uv, colors, normals = (arrays[name] for name in names)
    mesh = bpy.data.meshes.new("object")
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    if len(uv):
        mesh.uv_layers.new(name="uv").data.foreach_set("uv", uv[faces.ravel()].ravel())
    mesh.color_attributes.new("base_color", "FLOAT_COLOR", "POINT").data.foreach_set("color", colors.ravel())
    mesh.shade_flat()
    mesh.validate(clean_customdata=False)
    if len(normals):
        mesh.shade_smooth()
        mesh.normals_split_custom_set_from_vertices(normals)
    mesh.materials.append(_material(bpy, folder, settings))
    scene.collection.objects.link(bpy.data.objects.new("object", mesh))


def _material(bpy: Any, folder: Path, settings: dict[str, Any]) -> Any:
    material = bpy.data.materials.new("surface")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output, surface = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeBsdfPrincipled")
    surface.distribution = "GGX"
    surface.inputs["Roughness"].default_value = settings["roughness"]
    surface.inputs["Metallic"].default_value = settings["metallic"]
    surface.inputs["Specular IOR Level"].default_value = settings["specular"]
    if settings["textured"]:
        color = nodes.new("ShaderNodeTexImage")
        color.image = bpy.data.images.load(str(folder / "texture.png"))  # PNG files load as sRGB
        color.interpolation, color.extension = "Linear", "REPEAT"
    else:
        color = nodes.new("ShaderNodeAttribute")
        color.attribute_name = "base_color"  # not "color": Cycles reads that as the object's colour
    links.new(color.outputs["Color"], surface.inputs["Base Color"])
    links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return material


def _render(bpy: Any, scene: Any, folder: Path) -> np.ndarray:
    """Render the current view; (H, W, 4) float32, linear, premultiplied."""
    path = folder / "image.exr"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))  # in background mode, the render result itself has no pixels
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "PREMUL"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    shape = (image.size[1], image.size[0], 4)
    bpy.data.images.remove(image)
    return pixels.reshape(shape)[::-1]  # Blender stores the bottom row first


if __name__ == "__main__":
    main(Path(sys.argv[-1]))
