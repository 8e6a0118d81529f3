"""Resource needs of stages, and the free resources of one machine."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from objectfolder.engine.cgroups import core_quota, memory_left

HOUR = 3600.0
#: Share of the available memory for stages; the rest is for the engine and the system.
MEMORY_SHARE = 0.9
_DEVICES = Path("/dev")


@dataclass(frozen=True)
class Needs:
    """Resources of a running stage.

    Parameters
    ----------
    seconds : float
        Rough time on one core with preset quick; sets the priority of a stage and the estimate of remaining
        time.
    cpus : int
        Number of cores, which is also the thread limit of numerical libraries.
    gpus : float
        Number of GPUs; a fraction is a share of one GPU.
    memory_mb : int
        Peak resident memory, MB.
    timeout : float, optional
        Wall seconds after which the stage is considered hung and killed; None: never.
    """

    seconds: float = 1.0
    cpus: int = 1
    gpus: float = 0.0
    memory_mb: int = 500
    timeout: float | None = HOUR


#: Keys: stage, or stage and its net or renderer (``train_vision/osf``). Memory is above the largest peaks in
#: docs/measurements. One core each, because outputs must not depend on the number of threads. Timeouts are an
#: order of magnitude above the longest run. The paper's nets train for days, and a CPU answers with its
#: VisionNet for as long: these have none.
NEEDS = {
    "generate": Needs(2, memory_mb=500),
    "normalize": Needs(1, memory_mb=2000),
    "voxelize": Needs(7, memory_mb=2500),
    "modal": Needs(45, memory_mb=8000, timeout=3 * HOUR),
    "radiation": Needs(25, memory_mb=2200),
    "render_views": Needs(50, memory_mb=1000, timeout=12 * HOUR),
    "render_views/mitsuba-cuda": Needs(30, gpus=0.5, memory_mb=2000, timeout=3 * HOUR),
    "render_touch": Needs(3, memory_mb=1000, timeout=3 * HOUR),
    "train_vision": Needs(18, memory_mb=2000),
    "train_vision/osf": Needs(100000, gpus=1.0, memory_mb=8000, timeout=None),
    "train_audio": Needs(20, memory_mb=1500),
    "train_audio/spectrogram": Needs(100000, gpus=1.0, memory_mb=8000, timeout=None),
    "train_touch": Needs(5, memory_mb=1500),
    "train_touch/image": Needs(100000, gpus=1.0, memory_mb=8000, timeout=None),
    "pack": Needs(memory_mb=800),
    "evaluate": Needs(9, memory_mb=2000, timeout=3 * HOUR),
    "evaluate/osf": Needs(100000, gpus=1.0, memory_mb=8000, timeout=None),
    "observe": Needs(5, memory_mb=1500, timeout=3 * HOUR),
    "observe/osf": Needs(100000, gpus=1.0, memory_mb=8000, timeout=None),
    "recognize": Needs(1200, gpus=1.0, memory_mb=4000, timeout=None),
    "retrieve": Needs(1200, gpus=1.0, memory_mb=4000, timeout=None),
    "reconstruct": Needs(1200, gpus=1.0, memory_mb=4000, timeout=None),
    "decompose": Needs(15, memory_mb=1500),
    "grasp_data": Needs(60, memory_mb=2000, timeout=None),
    "grasp_stability": Needs(600, gpus=1.0, memory_mb=4000, timeout=None),
    "grasp_policy": Needs(3000, memory_mb=2000, timeout=None),
    "reach": Needs(300, memory_mb=2000, timeout=None),
}

#: Stages that query the net of another stage.
_NET_OF = {"evaluate": "train_vision", "observe": "train_vision"}


def needs_of(address: str, params: Mapping[str, Any]) -> Needs:
    """Return the needs of a stage, by its name and by the net or renderer in the parameters that it uses.

    Parameters
    ----------
    address : str
        Stage address, such as ``train_vision@mug``.
    params : mapping
        Contents of ``params.yaml``.
    """
    stage = address.partition("@")[0]
    section = params.get(_NET_OF.get(stage, stage))
    section = section if isinstance(section, Mapping) else {}
    choice = section.get("net", section.get("renderer"))
    return NEEDS.get(f"{stage}/{choice}", NEEDS.get(stage, Needs()))


def cores() -> int:
    """Return the number of cores that this process may use, in a container or job at most its quota."""
    return max(1, int(min(len(os.sched_getaffinity(0)), core_quota())))


def free_memory() -> int:
    """Return the bytes that can be taken now, in a container or job at most what its limit leaves."""
    return int(min(psutil.virtual_memory().available, memory_left()))


def machine_gpus() -> list[str]:
    """Return the visible NVIDIA GPUs of this machine, as names for ``CUDA_VISIBLE_DEVICES``.

    CUDA counts those that it sees from 0. In a container, device files keep the numbers of the host.
    """
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name.strip() for name in visible.split(",") if name.strip() not in ("", "-1")]
    devices = [path for path in _DEVICES.glob("nvidia*") if path.name.removeprefix("nvidia").isdigit()]
    return [str(number) for number in range(len(devices))]


class Machine:
    """Free resources of one machine while stages run.

    Needs beyond the capacity of the machine are capped, so that no stage waits forever.

    Parameters
    ----------
    cpus : int
        Number of cores to use.
    memory_mb : float, optional
        Memory to use; default: 90 % of the memory available now.
    gpus : sequence of str, optional
        Names of the GPUs to use; default: all. Without GPUs, stages train on the CPU.
    """

    def __init__(self, cpus: int, memory_mb: float | None = None, gpus: Sequence[str] | None = None):
        if memory_mb is None:
            memory_mb = free_memory() / 2**20 * MEMORY_SHARE
        self.cores = cpus
        self._cpus = cpus
        self._memory_mb = max(1, int(memory_mb))  # with none at all, needs would be capped to none
        self._gpus = dict.fromkeys(machine_gpus() if gpus is None else gpus, 1.0)  # free share of each
        self._limits = Needs(cpus=self._cpus, gpus=len(self._gpus), memory_mb=self._memory_mb)
        self._taken: dict[str, tuple[Needs, list[str]]] = {}

    @property
    def has_gpus(self) -> bool:
        """Whether there are GPUs to use."""
        return bool(self._gpus)

    def room(self, needs: Needs) -> str:
        """Return the resource that a stage must wait for: ``cpu``, ``memory`` or ``gpu``; empty if none."""
        needs = self._capped(needs)
        if needs.cpus > self._cpus:
            return "cpu"
        if needs.memory_mb > self._memory_mb:
            return "memory"
        return "" if self._choose_gpus(needs.gpus) is not None else "gpu"

    def take(self, address: str, needs: Needs) -> list[str]:
        """Reserve the resources of a stage; return its GPUs."""
        needs = self._capped(needs)
        chosen = self._choose_gpus(needs.gpus) or []
        self._cpus -= needs.cpus
        self._memory_mb -= needs.memory_mb
        for gpu in chosen:
            self._gpus[gpu] -= min(1.0, needs.gpus)
        self._taken[address] = needs, chosen
        return chosen

    def give(self, address: str) -> None:
        """Release the resources of a stage."""
        needs, chosen = self._taken.pop(address)
        self._cpus += needs.cpus
        self._memory_mb += needs.memory_mb
        for gpu in chosen:
            self._gpus[gpu] += min(1.0, needs.gpus)

    def _capped(self, needs: Needs) -> Needs:
        limits = self._limits
        return Needs(
            cpus=min(needs.cpus, limits.cpus),
            gpus=min(needs.gpus, limits.gpus),
            memory_mb=min(needs.memory_mb, limits.memory_mb),
        )

    def _choose_gpus(self, wanted: float) -> list[str] | None:
        """Return GPUs with enough free share, the busiest first to keep others idle; None if too few."""
        if wanted == 0:
            return []
        share, count = min(1.0, wanted), max(1, round(wanted))
        fitting = sorted((free, gpu) for gpu, free in self._gpus.items() if free >= share - 1e-9)
        return [gpu for _, gpu in fitting[:count]] if len(fitting) >= count else None
