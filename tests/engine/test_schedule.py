from collections import defaultdict

from objectfolder.engine.schedule import Schedule, object_groups, remaining_paths

EQUAL = defaultdict(lambda: 1).__getitem__
DIAMOND = {"a": set(), "x": set(), "b": {"a"}, "c": {"a"}, "d": {"b", "c"}}


def test_remaining_path_counts_the_stage_itself():
    weight = {"a": 1, "b": 10, "c": 2, "d": 5, "x": 3}
    assert remaining_paths(DIAMOND, weight.__getitem__) == {"a": 16, "x": 3, "b": 15, "c": 7, "d": 5}


def test_longest_path_comes_first():
    schedule = Schedule(
        {"normalize@a": set(), "pack@z": set(), "modal@b": set(), "train_audio@b": {"modal@b"}},
        {"normalize@a": 4, "pack@z": 1, "modal@b": 30, "train_audio@b": 45}.__getitem__,
    )
    assert [schedule.pop() for _ in range(4)] == ["modal@b", "normalize@a", "pack@z", None]


def test_ready_only_when_all_upstream_is_done():
    schedule = Schedule(DIAMOND, EQUAL)
    assert [schedule.pop(), schedule.pop(), schedule.pop()] == ["a", "x", None]
    schedule.finish("a")
    assert [schedule.pop(), schedule.pop()] == ["b", "c"]
    schedule.finish("b")
    assert schedule.pop() is None
    schedule.finish("c")
    assert schedule.pop() == "d"


def test_downstream_is_transitive_and_ordered():
    assert Schedule(DIAMOND, EQUAL).downstream("a") == ["b", "c", "d"]
    assert Schedule(DIAMOND, EQUAL).downstream("x") == []


def test_objects_are_finished_a_group_at_a_time():
    chains = {}
    for key in "abcd":
        chains |= {f"first@{key}": {"shared"}, f"second@{key}": {f"first@{key}"}}
    upstream = {"shared": set(), **chains, "last": set(chains)}
    schedule = Schedule(upstream, EQUAL, object_groups(upstream, 2))
    order = []
    while (address := schedule.pop()) is not None:
        order.append(address)
        schedule.finish(address)
    assert order == [
        *("shared", "first@a", "first@b", "second@a", "second@b"),
        *("first@c", "first@d", "second@c", "second@d", "last"),
    ]
