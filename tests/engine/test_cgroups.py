import math

import pytest

from objectfolder.engine.resources import core_quota, memory_left

JOB = "slurm/uid_7/job_42"


@pytest.fixture
def place(monkeypatch, tmp_path):
    """Return a function that makes this process a member of groups with files."""

    def put(own, files):
        (tmp_path / "own").write_text(own)
        for name, text in files.items():
            path = tmp_path / "trees" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{text}\n")
        monkeypatch.setattr("objectfolder.engine.resources._OWN", tmp_path / "own")
        monkeypatch.setattr("objectfolder.engine.resources._TREES", tmp_path / "trees")

    return put


def test_without_groups_there_is_no_limit(place):
    place("", {})
    assert core_quota() == memory_left() == math.inf


@pytest.mark.parametrize(
    ("cpu", "memory", "cores", "left"),
    [
        ("max 100000", "max", math.inf, math.inf),
        ("150000 100000", "3000000000", 1.5, 1_000_000_000),
        ("50000 100000", "1000000000", 0.5, 0),  # more is used than allowed
    ],
)
def test_a_containers_limits_count(place, cpu, memory, cores, left):
    place("0::/\n", {"cpu.max": cpu, "memory.max": memory, "memory.current": "2000000000"})
    assert (core_quota(), memory_left()) == (cores, left)


def test_pages_that_the_system_takes_back_are_left(place):
    stat = "anon 1\ninactive_file 400000000"
    place("0::/\n", {"memory.max": "3000000000", "memory.current": "2500000000", "memory.stat": stat})
    assert memory_left() == 900_000_000


@pytest.mark.parametrize("tightest", [JOB, f"{JOB}/step_0", "slurm"])
def test_the_tightest_of_nested_groups_counts(place, tightest):
    files = {}
    for folder in ("slurm", "slurm/uid_7", JOB, f"{JOB}/step_0"):
        files |= {f"{folder}/memory.max": "8000", f"{folder}/memory.current": "1000"}
        files |= {f"{folder}/cpu.max": "800000 100000"}
    files |= {f"{tightest}/memory.max": "3000", f"{tightest}/cpu.max": "200000 100000"}
    place(f"0::/{JOB}/step_0\n", files)
    assert (core_quota(), memory_left()) == (2, 2000)


def test_groups_of_the_first_version_have_a_tree_for_each_kind(place):
    files = {
        f"memory/{JOB}/memory.limit_in_bytes": "5000",
        f"memory/{JOB}/memory.usage_in_bytes": "4000",
        f"memory/{JOB}/memory.stat": "inactive_file 1\ntotal_inactive_file 300",
        "memory/memory.limit_in_bytes": "9223372036854771712",
        "memory/memory.usage_in_bytes": "100000",
        "cpu,cpuacct/user/cpu.cfs_quota_us": "300000",
        "cpu,cpuacct/user/cpu.cfs_period_us": "100000",
        "cpu,cpuacct/cpu.cfs_quota_us": "-1",
        "cpu,cpuacct/cpu.cfs_period_us": "100000",
    }
    place(f"4:memory:/{JOB}\n3:cpu,cpuacct:/user\n1:name=systemd:/user\n0::/user\n", files)
    assert (core_quota(), memory_left()) == (3, 1300)


def test_a_container_that_sees_the_path_on_the_host_has_its_own_limits_at_the_root(place):
    files = {"memory/memory.limit_in_bytes": "5000", "memory/memory.usage_in_bytes": "1000"}
    place("4:memory:/docker/0123abc\n", files)
    assert memory_left() == 4000
