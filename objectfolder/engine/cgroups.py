"""Limits of the control groups that this process is in: of a container, a SLURM job or a systemd unit.

Groups are nested, and each may have limits; the tightest one counts. The second version of control groups has
one tree, the first one a tree for each kind of limit. A container may see the path that its group has on the
host, which it does not have itself; then its root is its own group.
"""

from collections.abc import Iterator
from pathlib import Path

_TREES = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")  # lines such as 4:memory:/user and, of the second version, 0::/user


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
    """Return the content of a file; empty if there is none that can be read."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""
