"""Random edits, faults and builds: what `status` calls fresh is what a build from nothing gives."""

import shutil
import signal
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import hypothesis.strategies as st
from dvc.repo import Repo
from hypothesis import HealthCheck, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from objectfolder.engine.build import BuildOptions, build
from objectfolder.engine.prune import prune, survey
from objectfolder.engine.status import Outlook, State, status
from objectfolder.engine.summary import Finished, StageOutcome, Started
from objectfolder.engine.unchanged import CLOCK, recall
from objectfolder.engine.verify import verify

from . import tiny_project
from .processes import DIE_AT_A_CHANGE
from .tiny_project import KEYS, LIBRARY, PROFILES, STAGES, VERSIONS, Sources, parameters

FUZZING = settings.get_current_profile_name() == "fuzz"
SEQUENCES, STEPS = (300, 12) if FUZZING else (1, 6)
MESH = "data/objects/bell.dvc"
#: Picks one of a list. Neither what is drawn nor which rules apply may depend on files: what a killed build
#: leaves depends on timing, and hypothesis ends if equal draws are followed by others.
PICK = st.integers(0, 2**16)
STRAY = "stray.txt"
#: Field of `Sources`, its key if it is a mapping, and the new value.
EDITS = st.one_of(
    st.sampled_from([("values", path, value) for path, three in parameters().items() for value in three]),
    st.tuples(st.just("profiles"), st.sampled_from(PROFILES), st.sampled_from("123")),
    st.tuples(st.just("prose"), st.sampled_from((*STAGES, *LIBRARY)), st.sampled_from("123")),
    st.tuples(st.just("mesh"), st.just(""), st.sampled_from(["mesh 1", "mesh 2", "mesh 3"])),
    st.tuples(st.just("keys"), st.just(""), st.sampled_from([KEYS, KEYS[:1], KEYS[1:]])),
)

#: Dies before its n-th change of a file; stages may stop it with `HALT`.
MORTAL = (
    DIE_AT_A_CHANGE
    + """
import os, signal, sys
from objectfolder.engine import build
from objectfolder.engine.dvc import lockfile

lockfile.PERIOD = lockfile.PERIOD_PER_WRITE = 0.0  # dvc.lock is written after every stage
left, number, root = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
os.environ |= {"ENGINE": str(os.getpid()), "SIGNAL": str(number)}

die_at_a_change(left, number, root)
build.build(options=build.BuildOptions(jobs=1), root=root)
"""
)
#: What a build may do after what was said.
MEANING = {
    Outlook.SKIP: {StageOutcome.SKIPPED},
    Outlook.RESTORE: {StageOutcome.RESTORED, StageOutcome.SKIPPED},
    Outlook.RUN: {StageOutcome.RAN},
    Outlook.PERHAPS: {StageOutcome.RAN, StageOutcome.RESTORED, StageOutcome.SKIPPED},
}


class Sequence(RuleBasedStateMachine):
    """A workspace that is edited, damaged and built in any order.

    ``template``: a built workspace, which is copied; ``home``: folder for the copies; ``server``: runs the
    builds that are killed.
    """

    counts: ClassVar[Counter[str]] = Counter()

    def __init__(self, template: Path, home: Path, server):
        super().__init__()
        self.counts["sequences"] += 1
        self.home = home / f"{self.counts['sequences']}"
        self.root = shutil.copytree(template.parent, self.home) / template.name
        self.server = server
        self.sources = Sources()
        self.earlier = [self.sources]
        self.recorded_mesh = self.sources.mesh
        self.locks = [self.lock.read_bytes()]
        self.changes = 0  # since the last build
        self.damaged = False  # cached objects, behind DVC's back
        self.lost = False  # cached objects, until a build of everything
        self.said: dict[str, Outlook] = {}

    def teardown(self):
        try:
            if sys.exc_info()[0] is None:  # nothing failed before
                self.check_build_from_nothing()
        finally:
            shutil.rmtree(self.home)

    @property
    def lock(self):
        return self.root / "dvc.lock"

    @property
    def mesh(self):
        return self.root / "data/objects/bell/mesh.obj"

    @property
    def outputs(self):
        """Files that stages have written, sorted; without half copies, which the next build removes."""
        folders = [self.root / name for name in ("build", "benchmarks", "data/objects/mug")]
        found = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
        return sorted(path for path in found if ".logs" not in path.parts and path.suffix != ".tmp")

    @property
    def objects(self):
        """Cached objects, sorted."""
        return sorted(p for p in (self.root / ".dvc/cache/files/md5").rglob("*") if p.is_file())

    @property
    def truth(self):
        return tiny_project.outputs(self.sources)

    def change(self):
        self.changes += 1

    def set(self, sources):
        """Write the files that differ."""
        self.change()
        self.earlier.append(sources)
        for name, text in sources.files().items():
            if self.sources.files()[name] != text:
                (self.root / name).write_text(text)
        if sources.params() != self.sources.params():
            (self.root / "params.yaml").write_text(sources.params())
        if sources.mesh != self.sources.mesh:
            self.mesh.parent.mkdir(exist_ok=True)
            self.mesh.write_text(sources.mesh)
        self.sources = sources

    # Changes; after two of them comes a build

    @precondition(lambda self: self.changes < 2)
    @rule(name=st.sampled_from((*STAGES, *LIBRARY)), version=st.sampled_from(VERSIONS))
    def edit_code(self, name, version):
        self.set(self.sources.with_one("versions", name, "2" if name in LIBRARY else version))

    @precondition(lambda self: self.changes < 2)
    @rule(what=EDITS)
    def edit(self, what):
        self.set(self.edited(*what))

    def edited(self, name, key, value):
        if name == "values":
            return self.sources.with_parameter(key, value)
        return self.sources.with_one(name, key, value) if key else replace(self.sources, **{name: value})

    @precondition(lambda self: self.changes < 2)
    @rule(pick=PICK)
    def revert(self, pick):
        self.set(picked(self.earlier, pick))

    @precondition(lambda self: self.changes < 2)
    @rule(pick=PICK)
    def bring_old_lock_back(self, pick):
        self.change()
        self.lock.write_bytes(picked(self.locks, pick))

    @rule(pick=PICK)
    def touch(self, pick):
        before = self.states()
        sources = [path for name in ("objectfolder", "stages") for path in (self.root / name).rglob("*.py")]
        everything = [*self.outputs, *sorted(sources), self.root / "params.yaml", self.lock]
        picked([path for path in everything if path.exists()], pick).touch()
        assert self.states() == before

    @precondition(lambda self: self.changes < 2)
    @rule(pick=PICK, how=st.sampled_from(["delete", "delete directory", "empty", "change", "stray"]))
    def spoil_output(self, pick, how):
        self.change()
        if not self.outputs:
            return
        path = picked(self.outputs, pick)
        if how == "delete":
            path.unlink()
        elif how == "delete directory":
            shutil.rmtree(path.parent)
        elif how == "stray":
            (path.parent / STRAY).write_text("stray")
        else:
            path.write_text("other" if how == "change" else "")

    @precondition(lambda self: self.changes < 2)
    @rule()
    def delete_mesh(self):
        self.change()
        if self.said.get(MESH) is Outlook.SKIP:
            shutil.rmtree(self.mesh.parent)

    @precondition(lambda self: self.changes < 2)
    @rule(pick=PICK, how=st.sampled_from(["delete", "damage"]))
    def spoil_cached_object(self, pick, how):
        self.change()
        if not (self.objects and self.mesh.exists()):
            return
        path = picked(self.objects, pick)
        if how == "delete":
            path.unlink()
            self.lost = True
            return
        path.chmod(0o644)
        path.write_bytes(bytes([path.read_bytes()[0] ^ 1, *path.read_bytes()[1:]]))
        path.chmod(0o444)
        self.damaged = True

    @precondition(lambda self: self.changes < 2)
    @rule(what=st.sampled_from(["cache", "cache/files", "cache/runs", "tmp"]))
    def lose_cache(self, what):
        self.change()
        if not self.mesh.exists():
            return
        shutil.rmtree(self.root / ".dvc" / what, ignore_errors=True)
        self.lost = True

    @rule()
    def prune(self):
        prune(survey(self.root), self.root)

    @rule()
    def push(self):
        if self.damaged:
            return
        with Repo(str(self.root)) as repo:
            repo.push(run_cache=True)

    # Builds

    @rule(jobs=st.sampled_from([1, 2]))
    def build(self, jobs):
        self.check_build((), BuildOptions(jobs=jobs))

    @rule(what=st.sampled_from(["mug", "observe@bell", "recognize", "build/bell/surface.txt", "hash_code"]))
    def build_target(self, what):
        gone = {"bell", "mug"} - set(self.sources.keys)
        self.check_build(() if any(key in what for key in gone) else (what,), BuildOptions(jobs=2))

    @rule(path=st.sampled_from(list(parameters())), jobs=st.sampled_from([1, 2]))
    def go_back_and_forth(self, path, jobs):
        first, second, *third = parameters()[path]
        for value in (first, second, first, *third):
            self.set(self.edited("values", path, value))
            self.states()
            self.check_build((), BuildOptions(jobs=jobs))
            self.what_is_fresh_is_true()

    @rule()
    def build_by_force(self):
        self.check_build((), BuildOptions(jobs=2, force=True))

    @rule()
    def build_with_pull(self):
        self.check_build((), BuildOptions(jobs=2, pull=True))

    @rule(
        what=EDITS | st.tuples(st.just("versions"), st.sampled_from(STAGES), st.sampled_from(VERSIONS)),
        started=st.integers(1, 4),
        reverted=st.booleans(),
        force=st.booleans(),
    )
    def build_during_an_edit(self, what, started, reverted, force):
        before, left = self.sources, started

        def edit(event):
            nonlocal left
            if isinstance(event, Started):
                left -= 1
                if left == 0:
                    self.set(self.edited(*what))
            elif isinstance(event, Finished) and reverted and left <= 0 and self.sources != before:
                self.set(before)

        self.counts["edits during builds"] += 1
        build((), BuildOptions(jobs=2, force=force), self.root, edit)
        self.counts["edited during builds"] += left <= 0

    def check_build(self, targets, options):
        self.changes = 0
        self.counts["builds"] += 1
        summary = build(targets, options, self.root)
        broken = [a for a in summary.stages if a != MESH and self.truth[a] is None]
        assert summary.ok == (not broken), summary.failures
        if not options.force and not options.pull and not self.damaged:
            did = {a: result.status for a, result in summary.stages.items() if a not in broken}
            # What a stage needs of the cache, another may bring back that writes the same content.
            meaning = (
                MEANING | {Outlook.RUN: {StageOutcome.RAN, StageOutcome.RESTORED}} if self.lost else MEANING
            )
            assert not {a: (self.said[a], did[a]) for a in did if did[a] not in meaning[self.said[a]]}
        assert {a for a, state in self.states(*targets).items() if state is not State.FRESH} == set(broken)
        assert not [path for path in self.root.rglob("*.tmp*") if path.is_file()]
        self.lost = self.lost and (bool(targets) or bool(broken))
        self.locks.append(self.lock.read_bytes())
        time.sleep(CLOCK / 1e9)
        build(targets, BuildOptions(remember=time.time_ns()), self.root)

    def check_build_from_nothing(self):
        """Build in an empty cache, and compare all bytes."""
        self.states()
        self.check_build((), BuildOptions(jobs=2))
        fresh = self.home / "fresh"
        made = shutil.ignore_patterns("build", "benchmarks", "metrics", "mug", "cache", "tmp", "dvc.lock")
        shutil.copytree(self.root, fresh, ignore=made)
        build(root=fresh)
        for address, files in self.truth.items():
            for path in files or ():
                assert (fresh / path).read_bytes() == (self.root / path).read_bytes(), (address, path)
        self.counts["compared with a build from nothing"] += 1

    @rule(moment=st.integers(1, 150), number=st.sampled_from([signal.SIGKILL, signal.SIGINT]))
    def build_killed_at_a_change_of_a_file(self, moment, number):
        self.killed("", moment, number)

    @rule(pick=PICK, number=st.sampled_from([signal.SIGKILL, signal.SIGINT]))
    def build_killed_while_a_stage_writes(self, pick, number):
        paths = [path for files in self.truth.values() for path in files or () if ".code" not in path]
        self.killed(picked(paths, pick), 0, number)

    def killed(self, path, moment, number):
        self.changes = 0
        self.counts["kills"] += 1
        with (self.home / "log").open("wb") as log:
            command = ("-c", MORTAL, str(moment), str(int(number)), str(self.root))
            engine = self.server.start(command, tiny_project.ROOT, log, log, HALT=path)
            code = engine.wait(100)
        assert code in (0, -number), (self.home / "log").read_text()
        self.counts["killed"] += code != 0

    @rule()
    def repair(self):
        verify((), self.root, repair=True, jobs=2)

    # What holds after each of them

    def states(self, *targets):
        found = status(targets, self.root)
        self.said = {one.address: one.outlook for one in found}
        return {one.address: one.state for one in found}

    @invariant()
    def what_is_fresh_is_true(self):
        self.counts["steps"] += 1
        if not self.mesh.exists():  # a build brings back what was recorded
            self.sources = replace(self.sources, mesh=self.recorded_mesh)
        states = self.states()
        if recalled := recall((), self.root):
            self.counts["recalled"] += 1
            assert {states[address] for address in recalled.stages} == {State.FRESH}
        truth = self.truth
        if states.pop(MESH, None) is State.FRESH:
            assert self.mesh.read_text() == self.sources.mesh
            self.recorded_mesh = self.sources.mesh
        assert states.keys() == truth.keys()
        for address, state in states.items():
            self.counts[state] += 1
            if state is State.FRESH:
                assert truth[address] is not None, f"{address} cannot be built"
                assert self.written(address, truth[address]) == truth[address], address
        assert {path.relative_to(self.root).as_posix() for path in self.outputs} <= self.known()
        findings = verify((), self.root, jobs=1).findings
        bad = {
            f.address for f in findings if not f.path.startswith(".dvc") and "in the cache" not in f.problem
        }
        assert not {address for address in bad if states.get(address) is State.FRESH}, findings
        if set(states.values()) == {State.FRESH} and not self.damaged:
            assert not [f for f in findings if f.address in states], findings
        said = {address for address, state in states.items() if state is State.MISSING}
        assert said <= {f.address for f in findings}

    def written(self, address, files):
        """Files in the places of some, with what else is in their directories."""
        places = {self.root / path for path in files}
        if address.startswith("observe@"):
            places |= set((self.root / "benchmarks/observations" / address.partition("@")[2]).iterdir())
        return {p.relative_to(self.root).as_posix(): p.read_text() for p in places if p.is_file()}

    def known(self):
        """Files that some stage may write, and the stray ones of these tests."""
        files = {path for found in tiny_project.outputs(Sources()).values() for path in found or ()}
        return files | {str(Path(path).parent / STRAY) for path in files}


def picked(things, pick):
    return things[pick % len(things)]


def test_what_status_calls_fresh_is_what_a_build_from_nothing_gives(
    template, tmp_path, fork_server, monkeypatch
):
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)  # of the stages: it can be outdated
    run_state_machine_as_test(
        lambda: Sequence(template, tmp_path, fork_server),
        settings=settings(
            max_examples=SEQUENCES,
            stateful_step_count=STEPS,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
    print(dict(Sequence.counts))
