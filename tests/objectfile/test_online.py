"""Releases of an address: what is asked for comes into a cache, as released, or a reason is given."""

import csv
import hashlib
import io
import logging
import pickle
import sys

import pytest
from index_rows import BELL, MUG
from refusals import refused

from objectfolder import Dataset
from objectfolder.base.download import WAITS
from objectfolder.base.installation import install_command
from objectfolder.base.io import file_digest
from objectfolder.objectfile.dataset import COLUMNS

INDEX, BRICK = "/kitchen/objects.csv", "/kitchen/objects/the%20brick"
COMMIT = "0123456789" * 4


def index(*rows):
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, list(COLUMNS))
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue().encode()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="session")
def row(brick, brick_path):
    """Of the brick in the index; its file's name has to be written otherwise in an address."""
    own = {"key": brick.key, "material": brick.material, "path": "objects/the brick"}
    return MUG | own | {"bytes": brick_path.stat().st_size, "sha256": file_digest(brick_path)}


@pytest.fixture
def address(publisher, row, brick_path):
    publisher.pages = {INDEX: index(row, BELL), BRICK: brick_path.read_bytes()}
    return f"{publisher.url}/kitchen"


def asked(publisher):
    return [path for path, _ in publisher.requests]


def test_a_file_comes_when_it_is_asked_for_and_stays(publisher, address, cache, brick_path):
    dataset = Dataset(f"{address}/")
    assert repr(dataset) == f"Dataset('{address}'): 2 objects"
    assert asked(publisher) == [INDEX]
    for part in (dataset, dataset.filter(material="plastic"), pickle.loads(pickle.dumps(dataset))):
        assert part["brick"].key == "brick"
    assert asked(publisher) == [INDEX, BRICK]
    assert Dataset(address).path("brick").read_bytes() == brick_path.read_bytes()
    assert asked(publisher) == [INDEX, BRICK, INDEX]
    assert dataset.path("brick").is_relative_to(cache / "objectfolder" / "releases")
    left = sorted(path.name for path in dataset.folder.rglob("*") if path.is_file())
    assert left == ["objects.csv", "the brick"]


def test_an_interrupted_download_goes_on(publisher, address, no_waits):
    dataset = Dataset(address)
    publisher.drops[BRICK] = [1000, *[0] * len(WAITS)]
    refused(rf"objects/the brick of {address} is not in the cache, .*broke off.* 1000 bytes", dataset.verify)
    assert Dataset(address)[0].key == "brick"
    assert publisher.requests[-1][1]["Range"] == "bytes=1000-"


def test_without_a_network_the_cache_answers_and_names_what_it_lacks(publisher, address, caplog, no_waits):
    refused(r"objects\.csv of http.*/none is not in the cache, /.*404", Dataset, f"{publisher.url}/none")
    Dataset(address)["brick"]
    publisher.refusals[INDEX] = [410]
    assert Dataset(address).keys == ("brick", "bell")
    assert "answered 410 Gone" in caplog.text
    publisher.close()
    publisher.close = lambda: None
    with caplog.at_level(logging.WARNING):
        dataset = Dataset(address)
    assert "cannot be reached" in caplog.text
    assert f"objects.csv is that of the cache, {dataset.folder}" in caplog.text
    assert dataset["brick"].key == "brick"
    lacks = r"objects/bell\.safetensors of .*/kitchen is not in the cache, .*/releases/.*cannot be reached"
    assert str(dataset.folder) in refused(lacks, lambda: dataset["bell"])
    refused(r"objects\.csv of .* not in the cache.* cannot be reached", Dataset, f"{publisher.url}/other")


def test_a_file_with_another_checksum_is_refused_and_a_damaged_one_comes_again(publisher, address, row):
    released = publisher.pages[BRICK]
    publisher.pages[BRICK] = released[:-1] + bytes([released[-1] ^ 1])
    dataset = Dataset(address)
    differs = rf"the%20brick: SHA-256 is [0-9a-f]{{64}}, expected {row['sha256']} as in the index; try again"
    refused(differs, dataset.path, 0)
    assert not [path for path in dataset.folder.rglob("*") if "brick" in path.name or "part" in path.name]
    publisher.pages[BRICK] = released + b"more"
    refused("the%20brick is larger than", dataset.path, 0)
    publisher.pages[BRICK] = released
    dataset.path(0).write_bytes(b"damaged")
    assert dataset[0].key == "brick"


def test_a_new_index_of_the_publisher_is_read_the_next_time(publisher, address, row):
    Dataset(address)
    publisher.pages[INDEX] = index(row)
    assert Dataset(address).keys == ("brick",)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"<!doctype html>", r"is not a release \(its content looks like XML or HTML\): .* lacks key, path"),
        (b"key,material\n", r"is not a release: .*objects\.csv lacks path"),
    ],
)
def test_an_index_of_something_else_is_no_release(publisher, address, content, said):
    publisher.pages[INDEX] = content
    assert address in refused(said, Dataset, address)


def test_a_cache_that_cannot_be_written_is_named(address, cache):
    cache.write_text("a file")
    refused(rf"cannot use {cache}.*: Not a directory; .*set XDG_CACHE_HOME", Dataset, address)


@pytest.mark.parametrize(
    "address",
    [
        *("http://example.org/kitchen", "ftp://a.test/kitchen", "https://me:secret@a.test/kitchen"),
        *("https://a.test/kitchen?x", "https://a.test/#x", "hf://kitchen", "hf://a/b/c", "hf://a/b@", "://"),
        "http://localhost.a.test/kitchen",
    ],
)
def test_other_addresses_are_refused(address):
    refused(r"is not the address of a release; expected hf://OWNER/NAME, .* or a folder", Dataset, address)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("stream", "shows"), [(Terminal, True), (io.StringIO, False)])
def test_progress_is_shown_on_a_terminal_only(address, monkeypatch, stream, shows, row):
    dataset = Dataset(address)
    monkeypatch.setattr(sys, "stderr", stream())
    dataset.path(0)
    size = f"{row['bytes'] / 1e6:,.1f}"
    shown = sys.stderr.getvalue()
    assert (f"\robjects/the brick: 0.0 of {size} MB" in shown) == shows
    assert shown.endswith("\r\x1b[K") == shows


# The Hugging Face Hub, with its own library

KITCHEN = "/datasets/smith/kitchen"


@pytest.fixture
def hub(publisher, monkeypatch, tmp_path, row, brick_path):
    """The cache of the Hub, for which a server answers: a release at v1, nothing at v0."""
    constants = pytest.importorskip("huggingface_hub.constants")

    class Handler(publisher.server.RequestHandlerClass):
        def do_HEAD(self):
            content = publisher.pages.get(self.path)
            self.send_response(200 if content else 404)
            self.send_header("X-Repo-Commit", COMMIT)
            if content:
                self.send_header("ETag", f'"{hashlib.sha256(content).hexdigest()}"')
                self.send_header("Content-Length", str(len(content)))
            else:
                dataset, _, rest = self.path.partition("/resolve/")
                missing = "RevisionNotFound" if rest.startswith("v2/") else "EntryNotFound"
                codes = {KITCHEN: missing, "/datasets/smith/gated": "GatedRepo"}
                self.send_header("X-Error-Code", codes.get(dataset, "RepoNotFound"))
            self.end_headers()

    publisher.server.RequestHandlerClass = Handler
    files = {"objects.csv": index(row, BELL), "objects/the%20brick": brick_path.read_bytes()}
    publisher.pages = {
        f"{KITCHEN}/resolve/{revision}/{name}": content
        for revision in ("v1", COMMIT)
        for name, content in files.items()
    }
    template = f"{publisher.url}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    return tmp_path / "hub"


def test_a_release_of_the_hub_is_that_of_one_commit_in_its_cache(hub, publisher, row):
    dataset = Dataset("hf://smith/kitchen@v1")
    assert dataset.folder == hub / "datasets--smith--kitchen" / "snapshots" / COMMIT
    assert asked(publisher) == [f"{KITCHEN}/resolve/v1/objects.csv"]
    assert dataset["brick"].key == "brick"
    assert dataset.filter(material="plastic")[0].key == "brick"
    assert asked(publisher)[1:] == [f"{KITCHEN}/resolve/{COMMIT}/objects/the%20brick"]
    refused(r"objects/bell\.safetensors of hf://.* the dataset has no such file", lambda: dataset["bell"])
    stored = dataset.path("brick").resolve()
    stored.write_bytes(b"damaged")
    differs = rf"SHA-256 is .*, expected {row['sha256']} as in the index; delete {stored} and try again"
    refused(differs, lambda: dataset["brick"])


def test_without_the_hub_its_cache_answers_and_names_what_it_lacks(hub, monkeypatch):
    Dataset("hf://smith/kitchen@v1")["brick"]
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    dataset = Dataset("hf://datasets/smith/kitchen@v1")
    assert dataset["brick"].key == "brick"
    lacks = rf"bell\.safetensors of hf://datasets/smith/kitchen@v1 is not in the cache, {hub}: the Hub cannot"
    refused(lacks, lambda: dataset["bell"])


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("hf://smith/gone", "there is no such dataset"),
        ("hf://smith/gated", "accept its terms on its page of the Hub, and run `hf auth login`"),
        ("hf://smith/kitchen@v2", "there is no such revision"),
        ("hf://smith/kitchen@v0", "the dataset has no such file; check the address"),
        ("hf://smith/kit--chen", "Cannot have -- or"),  # of the library
    ],
)
def test_what_the_hub_refuses_is_said(hub, address, reason):
    refused(rf"objects\.csv of {address} is not in the cache, {hub}: .*{reason}", Dataset, address)


def test_a_cache_of_the_hub_that_cannot_be_written_is_named(hub):
    hub.write_text("a file")
    refused(rf"cannot use {hub}.*: .* set HF_HUB_CACHE to another folder", Dataset, "hf://smith/kitchen@v1")


def test_without_the_library_of_the_hub_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    message = refused("huggingface_hub is not installed; hf://a/b needs: pip install", Dataset, "hf://a/b")
    assert message.endswith(install_command("hub"))
