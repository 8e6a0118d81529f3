"""Touch of thousands of contacts at once, on the device where the environments are."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch

from objectfolder.base.errors import ObjectFolderError, shortened
from objectfolder.objectfile.file import ObjectFile, usable_device
from objectfolder.sim.calls import open_files
from objectfolder.touch.batched_press import BatchedPress, BatchedTouches
from objectfolder.touch.contact import sensor_frames
from objectfolder.touch.profiles import SensorProfile, load_profile
from objectfolder.touch.query import MOST_TWIST
from objectfolder.touch.senses import GeometricSense

_AWAY = 1e3  # m along each axis, where bad rows are computed: their sensors face away from all objects

RIGID = 1e-4  #: most that axes of a pose may differ from orthonormal ones


class BatchedTouch:
    """Tactile sensors of one kind that press Object Files, B contacts at a time, on one device.

    On a CUDA device, rays are cast by NVIDIA Warp (extra ``batch``), and gels and images are computed as
    tensors; from the arguments to the answer, nothing waits for the device if ``checks`` is False. On a CPU,
    rays are cast by Embree. Answers agree with those of `ObjectFile.press` to the tolerances of its
    iterations, not to the bit.

    Parameters
    ----------
    files : ObjectFile, str or sequence of these
        Objects, paths or names of samples, which ``object_index`` numbers; of different keys.
    sensor : str, Path or SensorProfile, optional
        Default: the stored sensor, which must be the same in all files.
    device : str or torch.device
    checks : bool
        Whether bad rows raise an error, for which the values are copied to the host. Otherwise a bad row is
        computed as an untouched sensor, and all its numbers but the image are NaN; other rows do not notice.

    Attributes
    ----------
    profile : SensorProfile
    markers : (M, 2) tensor
        Places of the markers at rest, columns and rows, pixels.

    Raises
    ------
    ObjectFolderError
        If a file holds no touch net of kind geometric and renderer gel, stored sensors differ, torch cannot
        use the device, or Warp is not installed and the device is no CPU.

    Examples
    --------
    >>> touch = BatchedTouch(["mug", "die"], "digit", "cuda")
    >>> felt = touch.press(index, points=points, normals=normals, depth=0.001, shear=shear)
    >>> felt.images.shape, felt.wrench.shape
    (torch.Size([1024, 160, 120, 3]), torch.Size([1024, 6]))
    """

    def __init__(
        self, files: "ObjectFile | str | Path | Sequence[ObjectFile | str | Path]",
        sensor: "str | Path | SensorProfile | None" = None, device: str | torch.device = "cpu",
        checks: bool = True,
    ):  # fmt: skip
        self.files, self.checks, self.device = open_files(files), checks, usable_device(device)
        nets = [_geometric(file, sensor is None) for file in self.files]
        self.profile = nets[0].profile if sensor is None else load_profile(sensor)
        for file, net in zip(self.files, nets):
            if sensor is None and net.profile != self.profile:
                raise ObjectFolderError(
                    f"{file.key} has the sensor {net.profile.name!r}, and {self.files[0].key} "
                    f"{self.profile.name!r}, or another of that name; choose one: sensor=..."
                )
        backgrounds = [net.background.cpu() for net in nets if net.profile == self.profile]
        if any(not torch.equal(other, backgrounds[0]) for other in backgrounds[1:]):
            raise ObjectFolderError(
                f"the files hold different pictures of the untouched sensor {self.profile.name!r}; make one "
                "BatchedTouch for each of them"
            )
        background = backgrounds[0] if backgrounds else None
        self._presses = BatchedPress([net.surface for net in nets], self.profile, self.device, background)
        self.markers = self._presses.gel.markers
        self._scales, self._offsets, self._frictions = (
            torch.tensor(values, dtype=torch.float64, device=self.device)
            for values in zip(
                *((net.scale, net.depth_offset, file.friction) for file, net in zip(self.files, nets))
            )
        )

    @property
    def background(self) -> torch.Tensor:
        """Image of the untouched sensor on the device; (H, W, 3) uint8."""
        return self._presses.optics.background

    def press(
        self, object_index: Any, pose: Any = None, depth: Any = 0.001, shear: Any = None, twist: Any = None,
        *, points: Any = None, normals: Any = None, angle: Any = 0.0, friction: Any = None, scale: Any = None,
        fitted: bool = True, start: torch.Tensor | None = None,
    ) -> BatchedTouches:  # fmt: skip
        """Press B sensors on objects, then move the objects sideways and turn them.

        All may be tensors, arrays or numbers; one serves all contacts. With tensors on the device, a pose and
        no checks, nothing is copied from the host.

        Parameters
        ----------
        object_index : (B,) int
            Numbers of the files.
        pose : (B, 4, 4), optional
            Of the sensors in their objects' frames, metres: the columns are image-out x (into the object),
            image left y, image up z, and the point on which the gel's apex is pressed.
        depth : (B,)
            How far the apex is pressed past the point along x, metres.
        shear : (B, 2), optional
        twist : (B,), optional
            Motion of the object after the press, as in `ObjectFile.press`.
        points, normals : (B, 3), optional
            Instead of a pose: where the apex is pressed, and the sensors' outward axes, unit vectors, such as
            `ObjectFile.contact_normals`. Points are not moved to the surface.
        angle : (B,)
            Beside these: of `ObjectFile.touch`.
        friction : (B,), optional
            Coefficients; default: those of the objects' materials.
        scale : (B,), optional
            Longest sides of the objects, metres; default: those of the files.
        fitted : bool
            Whether the depth offset that was fitted to the stored surface is added, as `ObjectFile.press`
            does.
        start : (B, H, W) tensor, optional
            ``pressed`` of the last answer for the same contacts, which have moved a little: fewer steps.

        Returns
        -------
        BatchedTouches

        Raises
        ------
        ObjectFolderError
            If shapes do not fit; with ``checks`` also if a row is not finite, an index is none, a pose is not
            rigid, a normal has another length than 1, a depth, a shear or a twist is out of range, a friction
            is negative, or a size is not positive.
        """
        moves = shear is not None or twist is not None
        if moves and not self._presses.gel.soft:
            raise ObjectFolderError(
                f"the gel of sensor {self.profile.name!r} is rigid and cannot be sheared; use a soft one"
            )
        which, frames, where = self._placed(object_index, pose, points, normals, angle)
        count = len(where)
        index = which.clamp(0, len(self.files) - 1)
        nothing = torch.zeros((), dtype=torch.float64, device=self.device)
        defaults = {"friction": self._frictions[index], "scale": self._scales[index]}
        wanted = {"depth": depth, "shear": shear, "twist": twist, "friction": friction, "scale": scale}
        given = {
            name: self._values(
                name, defaults.get(name, nothing) if of is None else of, (count, 2)[: 1 + (name == "shear")]
            )
            for name, of in wanted.items()
        }
        good = self._good_rows(which, frames, where, given)
        clean = {
            name: _replaced(values, good, 1.0 if name == "scale" else 0.0) for name, values in given.items()
        }
        where = _replaced(where, good, _AWAY)
        frames = torch.where(
            good[:, None, None], frames, torch.eye(3, dtype=frames.dtype, device=self.device)
        )
        pressed = clean["depth"] + (self._offsets[index] if fitted else 0.0)
        contact = index, where, frames, pressed.clamp(0, self.profile.max_indentation), clean["scale"]
        motion = tuple(clean[name].float() for name in ("shear", "twist", "friction")) if moves else None
        found = self._presses.press(*contact, motion, start)  # type: ignore[arg-type]
        return found if self.checks else _without(found, good)

    def _placed(
        self, object_index: Any, pose: Any, points: Any, normals: Any, angle: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return object numbers (B,), frames (B, 3, 3) and contact points (B, 3)."""
        if (pose is None) == (points is None or normals is None):
            raise ObjectFolderError("press takes either pose=, or points= and normals=")
        if pose is not None:
            poses = torch.as_tensor(pose, dtype=torch.float64, device=self.device)
            if poses.shape[-2:] != (4, 4):
                raise ObjectFolderError(f"pose has the shape {tuple(poses.shape)}, expected (B, 4, 4)")
            frames, where = poses.view(-1, 4, 4)[:, :3, :3], poses.view(-1, 4, 4)[:, :3, 3]
        else:
            where = torch.as_tensor(points, dtype=torch.float64, device=self.device).view(-1, 3)
            outward = self._values("normals", normals, (len(where), 3))
            frames = sensor_frames(outward, self._values("angle", angle, (len(where),)))
        which = torch.as_tensor(object_index, device=self.device)
        if which.dtype.is_floating_point or which.dtype == torch.bool:
            raise ObjectFolderError(f"object_index is of type {which.dtype}, expected whole numbers")
        count = max(len(where), which.numel() if which.dim() else 1)
        try:
            expanded = which.long().expand(count), frames.expand(count, 3, 3), where.expand(count, 3)
        except RuntimeError:
            raise ObjectFolderError(
                f"object_index has {which.numel()} numbers for {len(where)} contacts; expected as many, or "
                "one"
            ) from None
        return expanded

    def _values(self, name: str, given: Any, shape: tuple[int, ...]) -> torch.Tensor:
        try:
            return torch.as_tensor(given, dtype=torch.float64, device=self.device).expand(shape)
        except (RuntimeError, TypeError, ValueError) as error:
            raise ObjectFolderError(
                f"{name} cannot be read as numbers of shape {shape}: {shortened(error, 100)}"
            ) from None

    def _good_rows(
        self, which: torch.Tensor, frames: torch.Tensor, where: torch.Tensor, given: dict[str, torch.Tensor]
    ) -> torch.Tensor:
        """Return which rows can be computed (B,); with checks, raise an error that names the first other."""
        deepest, files = self.profile.max_indentation, len(self.files)
        crooked = (
            (frames.mT @ frames - torch.eye(3, dtype=frames.dtype, device=self.device)).abs().amax((1, 2))
        )
        x, y, z = frames.unbind(2)
        turned = (torch.linalg.cross(x, y) * z).sum(1)
        longest = torch.linalg.norm(given["shear"], dim=1)
        faults = {
            "object_index": ((which < 0) | (which >= files), which, f", expected 0 to {files - 1}"),
            "point": (~where.isfinite().all(1), where, ", expected three finite numbers, metres"),
            "pose": (
                ~((crooked <= RIGID) & (turned > 0)), frames,
                f", whose axes are not orthonormal and right-handed within {RIGID:g}; expected a rigid pose",
            ),
            "depth": (
                ~((given["depth"] >= 0) & (given["depth"] <= deepest)), given["depth"],
                f" m, expected 0 to {deepest:g} m, the maximal indentation of sensor {self.profile.name!r}",
            ),
            "shear": (~(longest <= deepest), given["shear"], f" m, expected at most {deepest:g} m of length"),
            "twist": (
                ~(given["twist"].abs() <= MOST_TWIST + 1e-6), given["twist"],
                f" rad, expected at most {MOST_TWIST:.3g} either way",
            ),
            "friction": (
                ~((given["friction"] >= 0) & given["friction"].isfinite()), given["friction"],
                ", expected 0 or more",
            ),
            "scale": (
                ~((given["scale"] > 0) & given["scale"].isfinite()), given["scale"], " m, expected above 0"
            ),
        }  # fmt: skip
        bad = torch.stack([fault for fault, _, _ in faults.values()])
        if self.checks and bad.any():
            name, (fault, values, expected) = next(pair for pair in faults.items() if pair[1][0].any())
            row, many = int(fault.nonzero()[0, 0]), int(fault.sum())
            of = f" ({many} of {len(fault)} rows)" if many > 1 else ""
            raise ObjectFolderError(f"contact {row}: {name} is {values[row].tolist()}{expected}{of}")
        return ~bad.any(0)


def relative_poses(
    site_at: torch.Tensor, site_axes: torch.Tensor, body_at: torch.Tensor, body_axes: torch.Tensor
) -> torch.Tensor:
    """Return poses of sites in the frames of bodies, as `BatchedTouch.press` takes them; (B, 4, 4) float64.

    Places (B, 3), metres, and axes in columns (B, 3, 3), in the world: of MuJoCo's ``site_xpos``,
    ``site_xmat``, ``xpos`` and ``xmat``. A site is a sensor as `objectfolder.sim.feeling.Feeling` has it: x
    out of the sensor, z up in the image, where the gel's apex is untouched.
    """
    places, axes, origins, frames = (v.double() for v in (site_at, site_axes, body_at, body_axes))
    pose = torch.eye(4, dtype=torch.float64, device=places.device).repeat(len(places), 1, 1)
    pose[:, :3, :3] = frames.mT @ axes
    pose[:, :3, 3] = (frames.mT @ (places - origins)[:, :, None])[:, :, 0]
    return pose


def _replaced(values: torch.Tensor, good: torch.Tensor, by: float) -> torch.Tensor:
    return torch.where(good.view(-1, *[1] * (values.dim() - 1)), values, by)


def _without(found: BatchedTouches, good: torch.Tensor) -> BatchedTouches:
    """Return touches with NaN instead of all numbers of bad rows, but their images."""
    names = [field.name for field in fields(found) if field.name not in ("images", "pressed")]
    return replace(found, **{name: _replaced(getattr(found, name), good, torch.nan) for name in names})


def _geometric(file: ObjectFile, own: bool) -> Any:
    """Return the net of a file that presses a stored surface, or raise ObjectFolderError."""
    sense = file.touch_sense if "touch" in file.header else None
    if not isinstance(sense, GeometricSense) or (own and sense.net.renderer != "gel"):
        raise ObjectFolderError(
            f"{file.key}: batches of touches need a touch net of kind geometric and renderer gel; build the "
            "object with train_touch.net: geometric and render_touch.renderer: gel"
        )
    return sense.net
