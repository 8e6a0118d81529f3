"""Resource needs of stages, and the free resources of one machine."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from objectfolder.nets.settings import papers_net
from objectfolder.workspace.stages import PAPERS_NET, STAGES, Needs, section_config

#: Share of the available memory for stages; the rest is for the engine and the system.
MEMORY_SHARE = 0.9
_DEVICES = Path("/dev")
_TREES = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")  # lines such as 4:memory:/user and, of the second version, 0::/user


NEEDS = {name: stage.needs for name, stage in STAGES.items()}  #: by stage


def needs_of(address: str, params: Mapping[str, Any]) -> Needs:
    """Return the needs of a stage, by its name and by the net or renderer in the parameters that it uses.

    ``address``: stage address, such as ``train_vision@mug``.
    """
    stage = address.partition("@")[0]
    row = STAGES.get(stage)
    if row is not None:
        section = params.get(row.net_in or stage)
        section = section if isinstance(section, Mapping) else {}
        if row.net_in and papers_net(section_config(row.net_in), str(section.get("net"))):
            return PAPERS_NET
        if section.get("renderer") in row.of_renderer:
            return row.of_renderer[section["renderer"]]
    return NEEDS.get(stage, Needs())


def cores() -> int:
    """Return the number of cores that this process may use, in a container or job at most its quota."""
    return max(1, int(min(len(os.sched_getaffinity(0)), core_quota())))


def free_memory() -> int:
    """Return the bytes that can be taken now, in a container or job at most what its limit leaves."""
    import psutil  # a build with nothing to do needs none

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

    ``cpus``: number of cores to use. ``memory_mb``: memory to use; default: 90 % of the memory available now.
    ``gpus``: names of the GPUs to use; default: all. Without GPUs, stages train on the CPU.
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
        needs = self._cap(needs)
        if needs.cpus > self._cpus:
            return "cpu"
        if needs.memory_mb > self._memory_mb:
            return "memory"
        return "" if self._choose_gpus(needs.gpus) is not None else "gpu"

    def take(self, address: str, needs: Needs) -> list[str]:
        """Reserve the resources of a stage; return its GPUs."""
        needs = self._cap(needs)
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

    def _cap(self, needs: Needs) -> Needs:
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


def core_quota() -> float:
    """Return how many cores the groups allow; infinite without a limit."""
    out = float("inf")
    for folder in _groups("cpu"):
        quota, _, period = (_read(folder / "cpu.max") or _quota_of_first_version(folder)).partition(" ")
        if quota.isdigit() and period.isdigit() and int(period):
            out = min(out, int(quota) / int(period))
    return out


def memory_left() -> float:
    """Return the bytes that the groups leave; infinite without a limit."""
    out = float("inf")
    for folder in _groups("memory"):
        for names in (
            ("memory.max", "memory.current", "inactive_file"),
            ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
        ):
            limit, used = (_read(folder / name) for name in names[:2])
            if limit.isdigit() and used.isdigit():
                # Pages of files that nobody has used lately count as used, but the system takes them back.
                lines = dict(line.split() for line in _read(folder / "memory.stat").splitlines())
                out = min(out, max(0, int(limit) - int(used) + int(lines.get(names[2], 0))))
    return out


def _groups(kind: str) -> Iterator[Path]:
    """Yield the folders of the groups that this process is in, from inside to outside, of both versions."""
    for line in _read(_OWN).splitlines() or ["0::/"]:
        _, kinds, path = line.split(":", 2)
        if kind in kinds.split(",") or not kinds:
            tree = _TREES / kinds if kinds else _TREES
            group = Path(path.lstrip("/"))
            yield from (tree / each for each in (group, *group.parents) if (tree / each).is_dir())


def _quota_of_first_version(folder: Path) -> str:
    return f"{_read(folder / 'cpu.cfs_quota_us')} {_read(folder / 'cpu.cfs_period_us')}"


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
