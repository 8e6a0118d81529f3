import os
import threading

import pytest

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.resources import NEEDS, Machine, Needs, cores, free_memory, machine_gpus, needs_of
from objectfolder.engine.workers import LocalWorkers
from objectfolder.workspace.stages import PAPERS_NET, STAGES

GB = 1000


def machine(cpus=4, memory_mb=8 * GB, gpus=()):
    return Machine(cpus, memory_mb, gpus)


def test_room_names_what_is_lacking_and_comes_back():
    accounts = machine(cpus=2, memory_mb=3 * GB)
    accounts.take("a", Needs(memory_mb=2 * GB))
    assert accounts.room(Needs(memory_mb=1 * GB)) == ""
    assert accounts.room(Needs(memory_mb=2 * GB)) == "memory"
    accounts.take("b", Needs(memory_mb=1 * GB))
    assert accounts.room(Needs(memory_mb=0)) == "cpu"
    accounts.give("a")
    assert accounts.room(Needs(memory_mb=2 * GB)) == ""


def test_stage_larger_than_the_machine_runs_alone():
    accounts = machine(cpus=2, memory_mb=1 * GB)
    huge = Needs(cpus=64, gpus=3, memory_mb=999 * GB)
    assert accounts.room(huge) == ""
    accounts.take("huge", huge)
    assert accounts.room(Needs(cpus=1, memory_mb=1)) != ""
    accounts.give("huge")
    accounts.take("small", Needs(memory_mb=1))
    assert accounts.room(huge) != ""
    accounts.give("small")
    assert accounts.room(huge) == ""


def test_gpus_are_given_whole_or_in_shares():
    accounts = machine(gpus=["0", "1"])
    half, whole = Needs(gpus=0.5, memory_mb=1), Needs(gpus=1.0, memory_mb=1)
    first = accounts.take("a", half)
    assert accounts.take("b", half) == first  # the second half of the same one
    assert accounts.room(whole) == ""
    (other,) = accounts.take("c", whole)
    assert {*first, other} == {"0", "1"}
    assert accounts.room(half) == "gpu"
    assert accounts.room(Needs(memory_mb=1)) == ""
    accounts.give("a")
    assert accounts.room(half) == ""
    assert accounts.room(whole) == "gpu"
    accounts.give("b")
    assert accounts.take("d", whole) == first
    assert accounts.take("e", Needs(memory_mb=1)) == []


def test_two_gpus_for_one_stage_and_three_thirds_of_one():
    accounts = machine(gpus=["0", "1"])
    assert sorted(accounts.take("both", Needs(gpus=2, memory_mb=1))) == ["0", "1"]
    accounts.give("both")
    third = Needs(gpus=1 / 3, memory_mb=1)
    assert {accounts.take(name, third)[0] for name in "abc"} == {"0"}
    assert accounts.take("d", third) == ["1"]


def test_without_a_gpu_a_stage_that_can_use_one_waits_for_none():
    accounts = machine(gpus=[])
    assert not accounts.has_gpus
    assert accounts.room(Needs(gpus=1.0, memory_mb=1)) == ""
    assert accounts.take("a", Needs(gpus=1.0, memory_mb=1)) == []


@pytest.mark.parametrize(
    ("visible", "expected"),
    [("", []), ("-1", []), ("2", ["2"]), ("0, 3", ["0", "3"]), ("GPU-8f6a,GPU-11", ["GPU-8f6a", "GPU-11"])],
)
def test_visible_gpus_are_those_of_the_environment(monkeypatch, visible, expected):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert machine_gpus() == expected


@pytest.mark.parametrize(("quota", "expected"), [(1.0, 1), (0.5, 1), (1e6, None), (float("inf"), None)])
def test_cores_are_at_most_the_quota(monkeypatch, quota, expected):
    monkeypatch.setattr("objectfolder.engine.resources.core_quota", lambda: quota)
    assert cores() == (expected or len(os.sched_getaffinity(0)))


def test_memory_is_at_most_what_the_limit_leaves(monkeypatch):
    monkeypatch.setattr("objectfolder.engine.resources.memory_left", lambda: 1000)
    assert free_memory() == 1000
    monkeypatch.setattr("objectfolder.engine.resources.memory_left", lambda: float("inf"))
    assert free_memory() > 2**20


def test_without_free_memory_stages_run_one_by_one():
    accounts = machine(memory_mb=0)
    accounts.take("a", Needs())
    assert accounts.room(Needs()) == "memory"


def test_gpus_are_counted_as_cuda_does_not_named_as_on_the_host(monkeypatch, tmp_path):
    for name in ("nvidia3", "nvidia7", "nvidiactl", "nvidia-uvm"):
        (tmp_path / name).touch()
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setattr("objectfolder.engine.resources._DEVICES", tmp_path)
    assert machine_gpus() == ["0", "1"]


def test_needs_come_from_the_stage_and_its_net_or_renderer():
    params = {"train_vision": {"net": "osf"}, "render_views": {"renderer": "mitsuba-cuda"}, "modal": 3}
    assert needs_of("train_vision@mug", params) == PAPERS_NET
    assert needs_of("render_views@mug", params) == STAGES["render_views"].of_renderer["mitsuba-cuda"]
    assert needs_of("train_vision@mug", {"train_vision": {"net": "surface"}}) == NEEDS["train_vision"]
    assert needs_of("train_touch@mug", {"train_touch": {"net": "image"}}) == PAPERS_NET
    for stage in ("evaluate", "observe"):  # which query the net that another stage trained
        needs = needs_of(f"{stage}@mug", params | {stage: {}})
        assert (needs.gpus, needs.timeout) == (1.0, None)
        assert needs_of(f"{stage}@mug", {"train_vision": {"net": "surface"}}) == NEEDS[stage]
    assert needs_of("modal@mug", params) == NEEDS["modal"]
    assert needs_of("modal", {}) == NEEDS["modal"]
    assert needs_of("unheard_of@mug", params) == Needs()
    assert cores() >= 1


def test_memory_is_above_the_peaks_of_preset_standard():
    for stage, peak in (("modal", 7124), ("radiation", 1874), ("pack", 549)):  # MB, measured
        assert NEEDS[stage].memory_mb > peak


def spans(workspace):
    """Start and end of every command, by address."""
    calls = {(call[0], call[1]): float(call[2]) for call in workspace.calls()}
    return {address: (calls[address, "start"], calls[address, "end"]) for address, _ in calls}


def overlap(first, second):
    return first[0] < second[1] and second[0] < first[1]


@pytest.fixture
def build_with(workspace, monkeypatch):
    """Build the three objects' `prepare` on a machine of 4 GB, with given needs; each takes half a second."""

    def run(*, gpus=(), **needs):
        monkeypatch.setattr("objectfolder.engine.build.needs_of", lambda address, _: needs[address[8:]])
        for key in needs:
            workspace.control(f"prepare@{key}", "0.5")
        summary = build(
            [f"prepare@{key}" for key in needs],
            BuildOptions(jobs=4),
            workspace.root,
            make_workers=lambda jobs, finished: LocalWorkers(Machine(jobs, 4 * GB, gpus), finished),
        )
        assert summary.ok
        return spans(workspace)

    return run


def test_stages_that_together_exceed_the_memory_do_not_overlap(build_with):
    large, small = Needs(memory_mb=3 * GB), Needs(memory_mb=1 * GB)
    times = build_with(bell=large, bowl=large, mug=small)
    assert not overlap(times["prepare@bell"], times["prepare@bowl"])


def test_what_waits_for_memory_lets_nothing_pass(build_with):
    # In order of their names; the small one would fit beside the first.
    times = build_with(bell=Needs(memory_mb=3 * GB), bowl=Needs(memory_mb=3 * GB), mug=Needs(memory_mb=1))
    assert times["prepare@mug"][0] >= times["prepare@bell"][1]


def test_what_waits_for_a_gpu_lets_others_pass(build_with):
    gpu = Needs(gpus=1.0, memory_mb=1)
    times = build_with(gpus=["0"], bell=gpu, bowl=gpu, mug=Needs(memory_mb=1))
    assert not overlap(times["prepare@bell"], times["prepare@bowl"])
    assert times["prepare@mug"][0] < times["prepare@bowl"][0]


def test_stage_sees_the_gpus_it_was_given_and_no_other(make_workspace, monkeypatch):
    command = "echo $CUDA_VISIBLE_DEVICES > ${item}"
    workspace = make_workspace(
        f'stages: {{see: {{foreach: [a, b], do: {{cmd: "{command}", outs: ["${{item}}"]}}}}}}\n'
    )
    needs = {"see@a": Needs(gpus=1.0, memory_mb=1), "see@b": Needs(memory_mb=1)}
    monkeypatch.setattr("objectfolder.engine.build.needs_of", lambda address, _: needs[address])
    workers = []

    def make(jobs, finished):
        workers.append(LocalWorkers(Machine(2, GB, ["7"]), finished))
        return workers[0]

    assert build(root=workspace.root, make_workers=make).ok
    assert (workspace.root / "a").read_text() == "7\n"
    assert (workspace.root / "b").read_text() == "-1\n"
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("see@")]
