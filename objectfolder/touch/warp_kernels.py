"""Kernels that cast the rays of batches, compiled by NVIDIA Warp at first use and cached."""

# mypy: disable-error-code="valid-type"

import logging

import warp

warp.config.log_level = logging.ERROR  # no greeting, nor that there is no GPU
warp.set_module_options({"enable_backward": False})

_FAR = warp.constant(1.0e6)  # longer than any ray


@warp.kernel
def find_enclosed(
    meshes: warp.array(dtype=warp.uint64),
    index: warp.array(dtype=int),
    cameras: warp.array(dtype=warp.vec3),
    chosen: warp.array(dtype=int),
    probes: warp.array(dtype=warp.vec3),
    enclosed: warp.array(dtype=int),
) -> None:
    """Find which cameras are inside their surfaces, by majority of three rays."""
    i = warp.tid()
    if chosen[i] == 0:
        return
    leaving = int(0)  # noqa: RUF046, UP018 - a variable of the kernel
    for k in range(3):
        found = warp.mesh_query_ray(meshes[index[i]], cameras[i], probes[k], _FAR)
        if found.result and warp.dot(found.normal, probes[k]) > 0.0:
            leaving += 1
    if leaving >= 2:
        enclosed[i] = 1


@warp.kernel
def find_first_surface(
    meshes: warp.array(dtype=warp.uint64),
    index: warp.array(dtype=int),
    cameras: warp.array(dtype=warp.vec3),
    frames: warp.array(dtype=warp.mat33),
    scales: warp.array(dtype=float),
    chosen: warp.array(dtype=int),
    enclosed: warp.array(dtype=int),
    rays: warp.array(dtype=warp.vec3),
    base: warp.array(dtype=float),
    limit: warp.array(dtype=float),
    distance: warp.array2d(dtype=float),
    blocked: warp.array(dtype=int),
    overlap: warp.array(dtype=float),
) -> None:
    """Find the first surface beyond the base on each pixel's ray, as `contact._first_surface`."""
    i, pixel = warp.tid()
    if chosen[i] == 0:
        return
    mesh = meshes[index[i]]
    way = frames[i] * rays[pixel] / scales[i]
    begin = base[pixel]
    start = cameras[i] + begin * way
    obstructed = enclosed[i] == 1
    if not obstructed:
        obstructed = warp.mesh_query_ray_anyhit(mesh, cameras[i], way, begin)
    length = limit[pixel] - begin
    if obstructed:
        length = _FAR
        warp.atomic_add(blocked, i, 1)
    found = warp.mesh_query_ray(mesh, start, way, length)
    first = warp.inf
    if found.result:
        first = begin + found.t
        if obstructed and warp.dot(found.normal, way) > 0.0:  # it starts inside: across the base
            first = 0.0
            back = warp.mesh_query_ray(mesh, start, -way, _FAR)
            reach = warp.inf
            if back.result:
                reach = back.t
            warp.atomic_max(overlap, i, reach)
    distance[i, pixel] = first
