"""Touch in a running MuJoCo simulation: sites on fingers become tactile sensors."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch

from objectfolder.base.errors import ObjectFolderError, quoted
from objectfolder.objectfile.file import ObjectFile
from objectfolder.sim.body import rotation
from objectfolder.sim.fingers import GRID_REDUCTION, MIN_DEPTH, sensor_angles
from objectfolder.sim.sounding import Objects, check_extent, find_bodies, site_number
from objectfolder.sim.state import SHAPES, STRUCTURE, StateCheck, divergences, require_compiled
from objectfolder.touch.camera import gel_sag
from objectfolder.touch.markers import Markers
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.sheared import shear_touches
from objectfolder.touch.simulate import Touches, press
from objectfolder.touch.tangential import shear_contacts

DEPTH_LEVELS, SHEAR_LEVELS = 5, 4  #: numbers of depths and of shears at which the gel's force is solved for
SHEARS = (2e-5, 1e-3)  #: range of shears, m
SEARCH_RANGE = 0.02  #: m that a pad may be from the stored surface when the simulation has it in contact
CONTACT_MARGIN = 1.5  #: contacts up to so many half images from the optical axis are the gel's
SEARCH_START = 0.004  #: m behind the gel's apex from which the surface is sought
SEARCH_RAYS = (13, 17)  #: of that search, across and up the gel


@dataclass(frozen=True)
class PadTouches:
    """What P pads feel in E environments; without the first axis for a single one.

    Vectors are in the sensor's image: pressure towards the camera, then along image right and image up.
    """

    images: np.ndarray  #: (E, P, H, W, 3) uint8, RGB
    touched: np.ndarray  #: (E, P) int, number of the body that a pad touches, 0 for none
    force: np.ndarray  #: (E, P, 3) N, of the object on the gel, as the simulation has it
    borne: np.ndarray  #: (E, P, 3) N, the same as the pressed and sheared gel has it
    depth: np.ndarray  #: (E, P) m, how far the gel is pressed in; 0 without contact
    shear: np.ndarray  #: (E, P, 2) m, motion of the object against the sensor since they met
    area: np.ndarray  #: (E, P) m², in contact
    marker_flow: np.ndarray  #: (E, P, M, 2) pixels, columns and rows


class Feeling:
    """What tactile sensors on sites of a MuJoCo model feel of its objects.

    A site is where the gel's apex is untouched: its x axis points out of the sensor, its z axis up in the
    image, its y axis to the image's left. The contacts of the site's body within the gel are the sensor's.
    The gel is pressed in until it bears their force, and sheared until it bears their friction.

    Parameters
    ----------
    model : mujoco.MjModel
    pads : str or sequence of str
        Names of the sites.
    objects : mapping from str to ObjectFile, or iterable of ObjectFile
        Objects by the names of their bodies; without names, these are their keys.
    sensor : str, Path or SensorProfile
        With a soft gel; see docs/sensors.md.

    Attributes
    ----------
    profile : SensorProfile
    markers : (M, 2) array
        Places of the markers at rest, columns and rows, pixels.

    Raises
    ------
    ObjectFolderError
        If the scene lacks a site or a body, an object has another size there, or the gel is rigid. `feel`
        raises it if anything that it reads is not finite, the data are of another model, or the model was
        changed so that an object has another size.

    Examples
    --------
    >>> feeling = Feeling(model, ["left_pad", "right_pad"], [ObjectFile.sample("mug")])
    >>> feeling.feel(data).images.shape
    (2, 160, 120, 3)
    """

    def __init__(
        self, model: mujoco.MjModel, pads: str | Sequence[str], objects: Objects,
        sensor: "str | SensorProfile" = "digit",
    ):  # fmt: skip
        require_compiled(model)
        self.profile = load_profile(sensor)
        if self.profile.gel == "rigid":
            raise ObjectFolderError(
                f"the gel of sensor {self.profile.name!r} is rigid and has no forces; use one with gel: soft"
            )
        self._model, self._optics = model, Optics(self.profile)
        self._sites = [site_number(model, name, "pads") for name in pad_names(pads)]
        if not self._sites:
            raise ObjectFolderError("pads is empty: expected the names of sites on fingers")
        self._files: dict[int, ObjectFile] = {}
        self._friction: dict[int, float] = {}
        placed = find_bodies(model, objects)
        self._names = {body: name for body, name, _ in placed}
        self._state = StateCheck(model, "Feeling", self._names, (*STRUCTURE, "opt.cone"), SHAPES)
        for body, name, one in placed:
            if one.scale not in (None, one.file.scale):
                raise ObjectFolderError(
                    f"body {name!r}: touch needs the object's own size, {one.file.scale:g} m, but it has "
                    f"{one.scale:g} m; build the object with that scale"
                )
            self._files[body], self._friction[body] = one.file, one.friction
        self._check_sizes()
        profile = self.profile
        height, width = profile.height // GRID_REDUCTION, profile.width // GRID_REDUCTION
        self._coarse = replace(profile, height=height, width=width)
        self.markers = Markers().places(profile)
        half = profile.camera_to_gel * np.array(profile.half_extent)  # up, across
        across, up = np.meshgrid(*(s * np.linspace(-1, 1, n) for s, n in zip(half[::-1], SEARCH_RAYS)))
        self._face = np.stack([np.zeros(across.size), across.ravel(), up.ravel()], 1)
        self._sag = gel_sag(profile, np.hypot(across, up).ravel())
        self._half = half

    def feel(self, data: "mujoco.MjData | Sequence[mujoco.MjData]") -> PadTouches:
        """Return what all pads feel now, in one environment or in many of the same model."""
        single = isinstance(data, mujoco.MjData) or not isinstance(data, Iterable)
        given = {"data": data} if single else {f"data[{k}]": one for k, one in enumerate(data)}
        many = [self._state.require(one, self._check_sizes, name) for name, one in given.items()]
        for name, one in zip(given, many):
            if divergences(one):
                raise ObjectFolderError(
                    f"{name}: the simulation diverged, and MuJoCo has set it back to its start: take smaller "
                    "time steps or forces, and mujoco.mj_resetData(model, data)"
                )
        contacts = [self._find_contact(one, site) for one in many for site in self._sites]
        rows, shape = len(contacts), (len(many), len(self._sites))
        size = self.profile.height, self.profile.width
        felt = {
            "images": np.tile(self._optics.background.numpy(), (rows, 1, 1, 1)).reshape(rows, *size, 3),
            "touched": np.array([body for body, _, _, _ in contacts]).reshape(rows),
            "force": np.array([force for _, force, _, _ in contacts]).reshape(rows, 3),
            "borne": np.zeros((rows, 3)),
            "depth": np.zeros(rows),
            "shear": np.zeros((rows, 2)),
            "area": np.zeros(rows),
            "marker_flow": np.zeros((rows, len(self.markers), 2), np.float32),
        }
        for body, file in self._files.items():
            chosen = [k for k in range(rows) if contacts[k][0] == body]
            if chosen:
                self._press(file, body, chosen, contacts, felt)
        skipped = 1 if single else 0
        return PadTouches(**{name: of.reshape(shape[skipped:] + of.shape[1:]) for name, of in felt.items()})

    def _check_sizes(self) -> None:
        """Raise ObjectFolderError if a body of the model is not of its object's size."""
        advice = "touch needs the object's own size: build the object with that of the scene"
        for body, file in self._files.items():
            check_extent(self._model, self._names[body], file, file.scale, advice)

    def _find_contact(self, data: mujoco.MjData, site: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
        """Return the body that a pad touches most, the force, and the site's place and axes in its frame."""
        at, axes = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        finger, model = int(self._model.site_bodyid[site]), self._model
        forces: dict[int, np.ndarray] = {}
        wrench = np.zeros(6)
        for k in range(data.ncon):
            contact = data.contact[k]
            if contact.efc_address < 0 or min(contact.geom) < 0:
                continue
            pair = model.geom_bodyid[contact.geom].tolist()
            if finger not in pair or not self._files.keys() & {*pair}:
                continue
            side = pair.index(finger)
            place = (contact.pos - at) @ axes
            if (abs(place) > [SEARCH_RANGE, *(CONTACT_MARGIN * self._half[::-1])]).any():
                continue
            mujoco.mj_contactForce(model, data, k, wrench)
            on_second = wrench[:3] @ contact.frame.reshape(3, 3)
            force = (on_second if side == 1 else -on_second) @ axes
            body = pair[1 - side]
            forces[body] = forces.get(body, np.zeros(3)) + force
        found = {body: force for body, force in forces.items() if force[0] < 0}
        if not found:
            return 0, np.zeros(3), at, axes
        body = min(found, key=lambda each: found[each][0])
        turn, force = rotation(data.xquat[body]), found[body]
        return body, force * [-1, -1, 1], (at - data.xpos[body]) @ turn, turn.T @ axes

    def _press(
        self, file: ObjectFile, body: int, chosen: list[int],
        contacts: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]], felt: dict[str, np.ndarray],
    ) -> None:  # fmt: skip
        """Press the gels that touch one object; fill in the rows of what they feel."""
        places, axes = np.stack([contacts[k][2] for k in chosen]), np.stack([contacts[k][3] for k in chosen])
        met = self._measure_gaps(file, places, axes)
        near = np.flatnonzero(met < SEARCH_RANGE)
        felt["touched"][np.delete(chosen, near)] = 0
        felt["force"][np.delete(chosen, near)] = 0
        if not len(near):
            return
        rows, outward = np.array(chosen)[near], -axes[near, :, 0]
        angle, _, _ = sensor_angles(outward, outward, axes[near, :, 2])
        points = places[near] - met[near, None] * outward
        force = felt["force"][rows]
        poses = points, outward, angle
        depth = self._solve_depths(file, poses, force[:, 0])
        pressed = press(file.surface.caster, *poses, depth, self.profile, file.scale)
        friction = np.full(len(rows), self._friction[body])
        shear = self._solve_shears(file, poses, depth, force[:, 1:], friction)
        still = np.flatnonzero(~shear.any(1))
        images = np.zeros((len(rows), *felt["images"].shape[1:]), np.uint8)
        images[still] = self._render(pressed.displacement[still])  # `shear_touches` renders the others
        found = Touches(**vars(pressed), images=images, profile=self.profile)
        moved = shear_touches(found, shear, np.zeros(len(rows)), friction, None, self._render)
        felt["images"][rows], felt["depth"][rows], felt["shear"][rows] = moved.images, depth, shear
        felt["borne"][rows] = np.c_[pressed.force, moved.shear_force]
        felt["area"][rows], felt["marker_flow"][rows] = pressed.area, moved.marker_flow

    def _render(self, displacement: np.ndarray) -> np.ndarray:
        """Return images (N, H, W, 3) of gels that are displaced by (N, H, W) metres."""
        return self._optics.render(torch.from_numpy(displacement)).numpy()

    def _measure_gaps(self, file: ObjectFile, places: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Return how far the gels (N,) are from the surface along their axes, m; negative: in it."""
        forward = axes[:, :, 0]
        origins = places[:, None] + self._face @ axes.transpose(0, 2, 1) - SEARCH_START * forward[:, None]
        directions = np.broadcast_to(forward[:, None], origins.shape).reshape(-1, 3)
        found, _ = file.surface.caster.first_hit(origins.reshape(-1, 3) / file.scale, directions)
        gap = found.reshape(len(places), -1).astype(np.float64) * file.scale - SEARCH_START + self._sag
        return gap.min(1)

    def _solve_depths(
        self, file: ObjectFile, poses: tuple[np.ndarray, np.ndarray, np.ndarray], forces: np.ndarray
    ) -> np.ndarray:
        """Return the depths at which the gels bear forces (N,), interpolated on logarithmic scales."""
        levels = np.geomspace(MIN_DEPTH, self.profile.max_indentation, DEPTH_LEVELS)
        points, outward, angle = (np.repeat(of, DEPTH_LEVELS, 0) for of in poses)
        depths = np.tile(levels, len(forces))
        found = press(file.surface.caster, points, outward, angle, depths, self._coarse, file.scale)
        return _interpolate(forces, found.force.reshape(-1, DEPTH_LEVELS), levels)

    def _solve_shears(
        self, file: ObjectFile, poses: tuple[np.ndarray, np.ndarray, np.ndarray], depth: np.ndarray,
        forces: np.ndarray, friction: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Return the shears (N, 2) at which the gels bear sideways forces (N, 2), as far as they can."""
        size = np.linalg.norm(forces, axis=1)
        along = forces / np.maximum(size, 1e-12)[:, None]
        pressed = press(file.surface.caster, *poses, depth, self._coarse, file.scale)
        levels = np.geomspace(*SHEARS, SHEAR_LEVELS)
        borne = np.empty((len(size), SHEAR_LEVELS))
        for k, level in enumerate(levels):
            sideways = shear_contacts(pressed.pressure, level * along, 0 * size, friction, self._coarse).force
            borne[:, k] = (sideways * along).sum(1)
        return np.where(size > 1e-6, _interpolate(size, borne, levels), 0.0)[:, None] * along


def pad_names(pads: object) -> list[str]:
    """Return the names of pads, of which a single one may stand for itself, or raise ObjectFolderError."""
    given = [pads] if isinstance(pads, str) else [*pads] if isinstance(pads, Iterable) else [None]
    names = [name for name in given if isinstance(name, str)]
    if len(names) < len(given):
        raise ObjectFolderError(f"pads is {quoted(pads)}, expected the names of sites on fingers")
    return names


def _interpolate(wanted: np.ndarray, found: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return where rising values (N, L) at levels (L,) are the wanted ones (N,), on logarithmic scales.

    Below the first level, values count as proportional to it; above the last one, the last one is returned.
    """
    least = 1e-9
    rising = np.maximum.accumulate(np.maximum(found, least), 1)
    out = np.empty(len(wanted))
    for k, (one, row) in enumerate(zip(np.maximum(wanted, least), rising)):
        if one < row[0]:
            out[k] = levels[0] * one / row[0]
        else:
            out[k] = np.exp(np.interp(np.log(one), np.log(row), np.log(levels)))
    return out
