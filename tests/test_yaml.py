"""YAML from elsewhere: what is small to read and huge to show, or too deep, is refused in a short message."""

import time

import pytest
from refusals import refused

from objectfolder.base.errors import MAX_MESSAGE, ObjectFolderError, quoted
from objectfolder.base.yamlfile import MAX_NESTING, read_yaml
from objectfolder.engine.dvc.repository import open_repository
from objectfolder.hub.fetch.catalogue import read_catalogue
from objectfolder.hub.fetch.run import read_checksums
from objectfolder.touch.profiles import load_profile
from objectfolder.workspace import params
from objectfolder.workspace.discover import discover
from objectfolder.workspace.document import editable
from objectfolder.workspace.presets import read_preset


def bomb(levels=9, width=10):
    """A list of 500 bytes that stands for ``width ** levels`` words."""
    lines = [f"a0: &a0 [{', '.join(['lol'] * width)}]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * width)}]" for i in range(1, levels)]
    return "\n".join(lines)


def read_materials(path):
    path.rename(path.with_name("materials.yaml"))
    discover(path.parent)


def open_workspace(path):
    with open_repository(path.parent):
        pass


READERS = {
    "parameters": params.read,
    "document": editable,
    "preset": lambda path: read_preset("params", path.parent.parent),
    "catalogue": read_catalogue,
    "checksums": read_checksums,
    "materials": read_materials,
    "profile": load_profile,
    "workspace": open_workspace,
}
#: What parses, and what does not.
BOMBS = {
    "aliases": (bomb(), r"has over 16,777,216 characters with a copy for each alias"),
    "mapping": (f"objects: {{}}\nprocedural: {{}}\n{bomb()}", "has over 16,777,216 characters"),
    "nesting": ("a: " + "[" * 5000 + "]" * 5000, f"more than {MAX_NESTING} deep"),
    "itself": ("a: &b [*b]", r"the alias \*b in what it stands for"),
    "number": ("a: 0x" + "f" * 5000, "a value of 5,002 characters"),
}


@pytest.fixture
def path(tmp_path):
    folder = tmp_path / "params"
    folder.mkdir()
    return folder / "params.yaml"


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("text", "message"), BOMBS.values(), ids=BOMBS)
def test_bombs_are_refused_at_once_and_shortly(path, reader, text, message):
    path.write_text(text)
    start = time.process_time()
    error = refused(message, reader, path)
    assert time.process_time() - start < 2
    assert len(error) < 300 + len(str(path))


BROKEN = ["a: 1\na: 2", "a: 2001-99-99", "a: !!int x", "a: [", "a: !foo 1", "? {a: 1}\n: 2", "a: *b", "\xff"]


@pytest.mark.parametrize("text", BROKEN)
def test_what_cannot_be_loaded_is_said_in_one_line(path, text):
    path.write_text(text, encoding="latin-1")
    assert "\n" not in refused(r"params\.yaml.* is not valid YAML: .*correct it", read_yaml, path)


def test_a_key_that_is_there_twice_is_named_with_its_line(path):
    path.write_text("seed: 0\nobjects: {}\nseed: 1\n")
    refused(r'params\.yaml, line 3 is not valid YAML.* duplicate key "seed"', params.read, path)


def test_aliases_and_nesting_within_reason_are_read(path):
    deep = "[" * (MAX_NESTING - 1) + "]" * (MAX_NESTING - 1)
    path.write_text(f"a: &a {{b: 1}}\nc: {{<<: *a, d: *a}}\ne: {deep}")
    values = read_yaml(path)
    assert values["c"] == {"b": 1, "d": {"b": 1}}


def test_values_in_messages_are_short(path):
    nested = []
    for _ in range(200):
        nested = [nested]
    for value in ("x" * 10**6, [1] * 10**6, dict.fromkeys(range(1000), "y" * 1000), nested, 10**4000):
        assert len(quoted(value)) <= 310
    assert quoted({"b": 1, "a": ["x", None]}) == "{'a': ['x', None], 'b': 1}"
    assert len(str(ObjectFolderError("m" * 10**6))) < MAX_MESSAGE + 10
    assert str(ObjectFolderError("a message")) == "a message"
    path.write_text(f"objects: {{a: {{mesh: {'m' * 1900}}}}}\nprocedural: {{}}\n")
    values = params.read(path)
    assert len(refused(r"objects\.a: material", params.object_entry, "a", values, path)) < 1000
