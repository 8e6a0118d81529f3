"""Clips of a MuJoCo scene with objects from Object Files: its sound, and pictures by ray casting."""

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from objectfolder.base.checks import finite_number, whole_number
from objectfolder.base.errors import ObjectFolderError
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.drawing import AMBIENT, LIGHT, SKY, cast_rays, geom_colours, view_frame, view_rays
from objectfolder.sim.hearing import Hearing
from objectfolder.sim.sounding import body_number

FOV = 40.0  #: vertical, degrees, of the camera that is placed without one in the scene
_HIDDEN_GROUP = 5  # group of geoms that the objects' surfaces replace
_SHADOW_SHARE = 0.6  # share of the light that a shadow takes
_SHADOW_OFFSET = 1e-3  # m from a surface at which a shadow ray begins


@dataclass(frozen=True)
class SceneView:
    """A camera, world frame."""

    eye: np.ndarray  #: (3,) m
    target: np.ndarray  #: (3,) m
    fov: float  #: vertical, degrees
    camera: int | None = None  #: of the scene, which then says where it is and how it is turned


@dataclass(frozen=True)
class Take:
    """What was simulated for a clip."""

    sound: np.ndarray  #: (samples,) float32, Pa
    states: list[np.ndarray]  #: of the simulation at each picture


def default_view(model: mujoco.MjModel, data: mujoco.MjData, objects: dict[str, ObjectFile]) -> SceneView:
    """Return the scene's first camera, or one that sees the objects, their fall included.

    ``data`` are at the start (``mj_forward``); objects are given by the names of their bodies.
    """
    if model.ncam:
        ahead = -data.cam_xmat[0].reshape(3, 3)[:, 2]
        return SceneView(data.cam_xpos[0].copy(), data.cam_xpos[0] + ahead, float(model.cam_fovy[0]), 0)
    places = np.array([data.xpos[body_number(model, name)] for name in objects])
    sizes = max(file.scale for file in objects.values())
    low, high = places.min(0) - sizes, places.max(0) + sizes
    low[2] = min(low[2], 0.0)
    target, spread = (low + high) / 2, float(np.linalg.norm(high - low))
    return SceneView(target + spread * np.array([0.75, -1.1, 0.55]), target, FOV)


def simulate(model: mujoco.MjModel, data: mujoco.MjData, hearing: Hearing, seconds: float, rate: int) -> Take:
    """Run a scene from its start; keep its sound, and its state at each picture.

    ``hearing`` is of the same model, at the same time; ``rate`` is in pictures per second. Raises
    ObjectFolderError if there is not one picture.
    """
    pictures = round(finite_number("seconds", seconds) * whole_number("rate", rate, 1))
    if pictures < 1:
        raise ObjectFolderError(f"{seconds:g} s at {rate} frames per second hold no frame; ask for more")
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    start, sounds, states = data.time, [np.zeros(0, np.float32)], []
    for picture in range(pictures):
        due = start + picture / rate
        while data.time < due - model.opt.timestep / 2:
            sounds.append(hearing.simulate(data))
        state = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        states.append(state)
    wanted = round(pictures / rate * hearing.sample_rate)
    while sum(len(sound) for sound in sounds) < wanted:
        sounds.append(hearing.simulate(data))
    return Take(np.concatenate(sounds)[:wanted], states)


class SceneCamera:
    """Draws objects by their stored surfaces and colours, and the rest of a scene by its geoms.

    Parameters
    ----------
    model : mujoco.MjModel
    objects : dict
        Object Files by the names of their bodies.
    view : SceneView
    height, width : int
        Pixels.
    """

    def __init__(
        self, model: mujoco.MjModel, objects: dict[str, ObjectFile], view: SceneView, height: int, width: int
    ):
        self._objects = {body_number(model, name): file for name, file in objects.items()}
        self._view, self._shape = view, (height, width)
        self._rest = copy.copy(model)
        self._colours = geom_colours(model)
        self._rest.geom_group[np.isin(model.geom_bodyid, [*self._objects])] = _HIDDEN_GROUP
        self._visible_groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)  # as MuJoCo: others are for collisions

    def pictures(self, take: Take) -> Iterator[np.ndarray]:
        """Draw each picture of a take; (height, width, 3) uint8, sRGB."""
        data = mujoco.MjData(self._rest)
        for state in take.states:
            mujoco.mj_setState(self._rest, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
            mujoco.mj_kinematics(self._rest, data)
            mujoco.mj_comPos(self._rest, data)
            mujoco.mj_camlight(self._rest, data)
            yield self.picture(data)

    def picture(self, data: mujoco.MjData) -> np.ndarray:
        """Draw a simulation with current positions; (height, width, 3) uint8, sRGB."""
        eye, rays = self._view_rays(data)
        geom, distance, normals = cast_rays(self._rest, data, eye, rays, self._visible_groups)
        hit = geom >= 0
        distance, colours = np.where(hit, distance, np.inf), np.full((len(rays), 3), SKY)
        colours[hit] = self._colours[geom[hit]]
        for body, file in self._objects.items():
            turn, at = data.xmat[body].reshape(3, 3), data.xpos[body]
            found = self._cast(file, turn, at, np.broadcast_to(eye, rays.shape), rays)
            nearer = np.flatnonzero(found < distance)
            distance[nearer] = found[nearer]
            hit[nearer] = True
            points = (eye + found[nearer, None] * rays[nearer] - at) @ turn / file.scale
            facing = file.surface.grid.normals(torch.from_numpy(points.astype(np.float32))).numpy()
            normals[nearer] = facing @ turn.T
            painted = file.base_colors
            colours[nearer] = painted(points) / 255 if painted is not None and len(points) else 0.7
        seen = np.flatnonzero(hit)
        places = eye + distance[seen, None] * rays[seen] + _SHADOW_OFFSET * normals[seen]
        lit = (normals[seen] @ LIGHT).clip(0, 1)
        for body, file in self._objects.items():
            turn, at = data.xmat[body].reshape(3, 3), data.xpos[body]
            towards = np.broadcast_to(LIGHT, places.shape)
            lit[np.isfinite(self._cast(file, turn, at, places, towards))] *= 1 - _SHADOW_SHARE
        colours[seen] *= (AMBIENT + (1 - AMBIENT) * lit)[:, None]
        return np.rint(255 * colours.clip(0, 1)).astype(np.uint8).reshape(*self._shape, 3)

    def _view_rays(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Return where the camera is, (3,) m, and the rays through its pixels; world frame."""
        view = self._view
        if view.camera is None:
            eye, frame = np.asarray(view.eye, np.float64), view_frame(view.eye, view.target)
        else:
            eye, frame = data.cam_xpos[view.camera].copy(), data.cam_xmat[view.camera].reshape(3, 3)
        return eye, view_rays(frame, view.fov, *self._shape)

    @staticmethod
    def _cast(
        file: ObjectFile, turn: np.ndarray, at: np.ndarray, origins: np.ndarray, rays: np.ndarray
    ) -> np.ndarray:
        """Return the distances at which rays meet an object, m; ``inf`` where they do not."""
        out = np.full(len(rays), np.inf)
        near = np.flatnonzero(_meets(origins - at, rays, file.scale * 0.9))
        if len(near):
            starts = (origins[near] - at) @ turn / file.scale
            found, _ = file.surface.caster.first_hit(starts, rays[near] @ turn)
            out[near] = found * file.scale
        return out


def _meets(origins: np.ndarray, rays: np.ndarray, radius: float) -> np.ndarray:
    """Return whether rays of length 1 meet a ball about the origin."""
    along = (origins * rays).sum(1)
    return (origins**2).sum(1) - along**2 < radius**2
