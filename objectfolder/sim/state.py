"""What hearing and feeling read of a MuJoCo simulation, checked before it becomes sound or touch."""

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np

from objectfolder.base.errors import ObjectFolderError, quoted

#: Fields of the data that are read, by MuJoCo's functions too, or that the next step reads: their owners.
#: Those that are set by hand come first, as the others follow from them.
DATA = {
    "mocap_pos": "mocap", "mocap_quat": "mocap", "ctrl": "actuator", "qfrc_applied": "dof",
    "xfrc_applied": "body", "act": "", "qpos": "joint", "qvel": "dof", "qacc": "dof", "xpos": "body",
    "xquat": "body", "xmat": "body", "xipos": "body", "cvel": "body", "subtree_com": "body",
    "site_xpos": "site", "site_xmat": "site", "cdof": "dof", "qLD": "", "qLDiagInv": "dof", "efc_force": "",
    "efc_vel": "",
}  # fmt: skip
#: Fields of each contact that are read: numbers, and places in other arrays.
CONTACT = ("pos", "frame", "dist", "includemargin", "friction", "solref")
CONTACT_PLACES = ("geom", "efc_address", "dim")
#: Fields of the model that say which body is what.
STRUCTURE = (
    "geom_bodyid", "site_bodyid", "body_rootid", "body_mocapid", "body_geomadr", "body_geomnum",
    "mesh_vertadr", "mesh_vertnum",
)  # fmt: skip
#: Fields of the model that say how large bodies are; of ``mesh_vert``, some rows of each mesh count.
SHAPES = (
    "geom_type", "geom_dataid", "geom_pos", "geom_quat", "geom_size", "geom_aabb", "geom_contype",
    "geom_conaffinity", "mesh_vert",
)  # fmt: skip
#: Fields of the model that say how bodies move and bounce.
DYNAMICS = ("body_mass", "body_inertia", "body_iquat", "geom_solref", "pair_solref", "opt.gravity")

COMPARED_VERTICES = 8  #: vertices of each mesh that are compared; all those of a scene can be megabytes
MAX_VALUE = 1 / mujoco.mjMINVAL  #: of the numbers of a state; MuJoCo's inverses of inertia reach it
REMEDY = (
    "expected finite numbers: set such mocap poses, controls and forces, or, if the simulation has diverged, "
    "use a shorter time step or softer contacts; then reset it"
)
_DIVERGED = [getattr(mujoco.mjtWarning, f"mjWARN_BADQ{of}") for of in ("POS", "VEL", "ACC")]


class StateCheck:
    """Checks the data of a model, and that the model is still as a sense has read it.

    ``sense`` is the name of the class that reads it, ``bodies`` are the numbers of the objects' bodies. The
    fields of the model named in ``fixed`` must not change; those in ``adaptable`` may, as long as the objects
    fit their bodies. Raises ObjectFolderError if a field is not finite, or a mass or inertia is negative.
    """

    def __init__(
        self, model: mujoco.MjModel, sense: str, bodies: Iterable[int], fixed: Iterable[str],
        adaptable: Iterable[str],
    ):  # fmt: skip
        self._model, self._sense, self._fixed = model, sense, (*fixed,)
        self._vertices = _sample_vertices(model, bodies)
        self._known = {name: self._bytes(model, name) for name in (*fixed, *adaptable)}
        self._plain = [name for name in self._known if name != "mesh_vert" and "." not in name]
        self._others = [name for name in self._known if name not in self._plain]
        for name in self._known:
            _require_finite(model, name)

    def require_same(self, data: object, name: str = "data") -> mujoco.MjData:
        """Return the data if they are of the model or of one that is alike, else raise ObjectFolderError."""
        if not isinstance(data, mujoco.MjData):
            raise ObjectFolderError(
                f"{name} is {quoted(data)}, expected the mujoco.MjData of the model that "
                f"{self._sense} was made with"
            )
        other, model = data.model, self._model
        if other is not model:
            for size in ("nbody", "nq", "nv", "ngeom", "nsite", "nmeshvert", "nmocap", "nu"):
                if getattr(other, size) != getattr(model, size):
                    self._refuse_other(f"its model has {size} = {getattr(other, size)}, expected "
                                       f"{getattr(model, size)}")  # fmt: skip
            if differ := self._find_changes(other):
                self._refuse_other(f"{_difference(model, other, differ[0])}")
        return data

    def require(self, data: object, fits: Callable[[], None], name: str = "data") -> mujoco.MjData:
        """Return the data of a step if all that is read of it is right; ``name`` is that of the argument.

        ``fits`` raises ObjectFolderError if the model no longer has the objects in their sizes and materials.
        So does this method if it is no data of the model, a number is not finite, or the model has been
        changed so that it is another one for the sense.
        """
        checked = self.require_same(data, name)
        if changed := self._find_changes(self._model):
            self._adapt(changed, fits)
        if not _is_valid(checked):
            _refuse(self._model, checked)
        return checked

    def _find_changes(self, model: mujoco.MjModel) -> list[str]:
        """Return the names of the fields that differ from those that the sense has read."""
        was = self._known
        plain = [name for name in self._plain if getattr(model, name).tobytes() != was[name]]  # fast
        return plain + [name for name in self._others if self._bytes(model, name) != was[name]]

    def _adapt(self, changed: list[str], fits: Callable[[], None]) -> None:
        """Take over the fields of the model that have changed, if they may."""
        made = f"since {self._sense} was made"
        for name in changed:
            _require_finite(self._model, name)
            if name in self._fixed:
                now = quoted(_field(self._model, name))
                raise ObjectFolderError(
                    f"{name} of the model was changed {made}, and is now {now}: make a new {self._sense}"
                )
        try:
            fits()
        except ObjectFolderError as error:
            raise ObjectFolderError(f"{', '.join(changed)} of the model changed {made}: {error}") from error
        self._known |= {name: self._bytes(self._model, name) for name in changed}

    def _bytes(self, model: mujoco.MjModel, name: str) -> bytes:
        if name == "mesh_vert":
            return model.mesh_vert[self._vertices].tobytes()
        return np.asarray(_field(model, name)).tobytes()

    def _refuse_other(self, difference: str) -> None:
        raise ObjectFolderError(
            f"the data are of another model than {self._sense}: {difference}; give those of "
            f"mujoco.MjData(model), or make a {self._sense} of each model"
        )


def require_compiled(model: object) -> None:
    """Raise ObjectFolderError unless a model is compiled."""
    if not isinstance(model, mujoco.MjModel):
        raise ObjectFolderError(
            f"model is of type {type(model).__name__}, expected a mujoco.MjModel; of an MjSpec, that is what "
            "spec.compile() returns"
        )


def divergences(data: mujoco.MjData) -> int:
    """Return how often a simulation has diverged since it was reset."""
    return sum(int(data.warning[kind].number) for kind in _DIVERGED)


def _is_valid(data: mujoco.MjData) -> bool:
    """Return whether all that is read of a step is finite, and in its range."""
    parts = [getattr(data, name) for name in DATA]
    if data.ncon:
        contact = data.contact
        if not _is_known_contact(data, contact):
            return False
        parts += [getattr(contact, name) for name in CONTACT]
    values = np.concatenate(parts, axis=None)
    return bool(abs(data.time) <= MAX_VALUE and np.abs(values, out=values).max(initial=0) <= MAX_VALUE)


def _is_known_contact(data: mujoco.MjData, contact: Any) -> bool:
    """Return whether one contact, or all, are of geoms and constraints that there are."""
    geoms, address, dims = (np.asarray(getattr(contact, name)) for name in CONTACT_PLACES)
    return bool(
        geoms.min() >= -1 and geoms.max() < data.model.ngeom and address.max() < data.nefc
        and dims.min() >= 1 and dims.max() <= 6
    )  # fmt: skip


def _refuse(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise ObjectFolderError with the first number of a step that is wrong, and its owner."""
    when = f"at {data.time:g} s"
    for name, owner in DATA.items():
        values = getattr(data, name)
        wrong = ~(np.abs(values) <= MAX_VALUE)
        if wrong.any():
            row = int(np.argwhere(wrong)[0, 0])
            whose = _owner(model, owner, row)
            raise ObjectFolderError(f"{whose}{name}[{row}] is {values[row].tolist()} {when}, {REMEDY}")
    for k, one in enumerate(data.contact):
        if not _is_known_contact(data, one):
            found = ", ".join(f"{name} {np.asarray(getattr(one, name)).tolist()}" for name in CONTACT_PLACES)
            raise ObjectFolderError(f"contact {k} has {found} {when}, which are not in the data; {REMEDY}")
        for name in CONTACT:
            if not (np.abs(getattr(one, name)) <= MAX_VALUE).all():
                both = " and ".join(_owner(model, "geom", int(n)) for n in one.geom).replace(": ", "")
                value = np.asarray(getattr(one, name)).tolist()
                raise ObjectFolderError(f"contact {k} of {both}: {name} is {value} {when}, {REMEDY}")
    raise ObjectFolderError(f"time is {data.time} s, {REMEDY}")


def _require_finite(model: mujoco.MjModel, name: str) -> None:
    """Raise ObjectFolderError unless a field of a model is finite, and no mass or inertia below zero."""
    values = np.atleast_1d(_field(model, name))
    least = 0.0 if name in ("body_mass", "body_inertia") else -MAX_VALUE
    wrong = ~((values >= least) & (values <= MAX_VALUE))
    if wrong.any():
        row = int(np.argwhere(wrong)[0, 0])
        whose = _owner(model, name.partition("_")[0], row)
        expected = "finite numbers" if least else "finite numbers of at least 0"
        raise ObjectFolderError(
            f"{whose}{name}[{row}] of the model is {values[row].tolist()}, expected {expected}"
        )


def _difference(model: mujoco.MjModel, other: mujoco.MjModel, name: str) -> str:
    """Return in words how a field of another model differs."""
    expected, found = (np.atleast_1d(_field(one, name)) for one in (model, other))
    if expected.shape != found.shape:
        return f"its {name} is {found.shape}, expected {expected.shape}"
    row = int(np.argwhere(expected != found)[0, 0])
    whose = _owner(model, name.partition("_")[0], row)
    return f"{whose}{name}[{row}] is {found[row].tolist()}, expected {expected[row].tolist()}"


def _owner(model: mujoco.MjModel, kind: str, row: int) -> str:
    """Return whose a row of a field is, for a message; empty if nobody's."""
    if kind == "mocap":
        kind, row = "body", int(np.flatnonzero(model.body_mocapid == row)[0])
    elif kind == "dof":
        kind, row = "body", int(model.dof_bodyid[row])
    elif kind == "joint":
        row = int(np.searchsorted(model.jnt_qposadr, row, side="right")) - 1
        kind, row = "body", int(model.jnt_bodyid[row])
    if kind not in ("actuator", "body", "geom", "pair", "site") or row < 0:
        return ""
    name = getattr(model, kind)(row).name
    return f"{kind} {name!r}: " if name else f"{kind} {row}: "


def _field(model: mujoco.MjModel, name: str) -> Any:
    return getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)


def _sample_vertices(model: mujoco.MjModel, bodies: Iterable[int]) -> np.ndarray:
    """Return the rows of some vertices of each mesh of bodies; (V,) int."""
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, [*bodies]))
    meshes = np.unique(model.geom_dataid[geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH]])
    first, count = model.mesh_vertadr[meshes], model.mesh_vertnum[meshes]
    places = np.linspace(0, 1, COMPARED_VERTICES)[:, None]
    rows: np.ndarray = (first + places * (count - 1)).astype(int).ravel()
    return rows
