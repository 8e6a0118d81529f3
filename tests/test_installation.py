"""Messages name a command that installs this package from where it is, since no package index has it."""

import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from typer.testing import CliRunner

import objectfolder
from objectfolder.base import installation
from objectfolder.base.installation import install_command, installed_version, requirement
from objectfolder.cli import app

ROOT = Path(__file__).parents[1]
GIT = {"url": "https://example.org/o.git", "vcs_info": {"vcs": "git", "commit_id": "abc123"}}
WEB = {"url": "https://example.org/o-1.0-py3-none-any.whl", "archive_info": {}}


def test_in_a_clone_it_is_the_clone():
    assert install_command("usd") == f"pip install -e '{ROOT}[usd]'"
    assert install_command() == f"pip install -e {ROOT}"
    assert requirement("build") == f"objectfolder[build] @ file://{ROOT}"


@pytest.fixture
def recorded(monkeypatch, tmp_path):
    """An installation elsewhere, of which pip has recorded this."""

    def record(found):
        monkeypatch.setattr(installation, "_HOME", tmp_path / "site-packages")
        monkeypatch.setattr(installation, "_recorded", lambda: found)

    return record


@pytest.mark.parametrize(
    ("found", "source"),
    [(GIT, "git+https://example.org/o.git@abc123"), (WEB, "https://example.org/o-1.0-py3-none-any.whl")],
)
def test_a_commit_or_wheel_on_a_server_is_its_url(recorded, found, source):
    recorded(found)
    assert install_command("rl") == f"pip install 'objectfolder[rl] @ {source}'"
    assert requirement("rl") == f"objectfolder[rl] @ {source}"


def test_a_clone_or_wheel_on_this_machine_is_named_while_it_is_there(recorded, tmp_path):
    clone, wheel = tmp_path / "my clone", tmp_path / "o-1.0-py3-none-any.whl"
    clone.mkdir()
    wheel.touch()
    recorded({"url": clone.as_uri(), "dir_info": {}})
    assert install_command("rl") == f"pip install '{clone}[rl]'"
    assert requirement("rl") == f"objectfolder[rl] @ {clone.as_uri()}"
    recorded({"url": wheel.as_uri(), "archive_info": {}})
    assert install_command("rl") == f"pip install 'objectfolder[rl] @ {wheel.as_uri()}'"
    wheel.unlink()
    assert install_command("rl").startswith("pip install 'CLONE[rl]' (CLONE: a clone of the repository")


def test_without_a_record_the_clone_is_left_to_the_reader(recorded):
    recorded({})
    unknown = "pip install 'CLONE[rl]' (CLONE: a clone of the repository of objectfolder)"
    assert install_command("rl") == unknown
    assert requirement("build") == f"objectfolder[build]=={version('objectfolder')}"


def test_no_message_names_a_package_that_no_index_has():
    named = re.compile(r"pip install (-\S+ )*['\"]?objectfolder")
    assert [path for path in ROOT.glob("objectfolder/**/*.py") if named.search(path.read_text())] == []


def test_the_version_is_at_hand_without_imports_that_take_time():
    assert objectfolder.__version__ == installed_version() == version("objectfolder")
    assert CliRunner().invoke(app, ["--version"]).output == f"objectfolder {version('objectfolder')}\n"
    code = "import sys, objectfolder as o; print(o.__version__, *dir(o)); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (found, *names), modules = (line.split() for line in ran.stdout.splitlines())
    assert found == version("objectfolder")
    assert {"ObjectFile", "Dataset", "__version__"} < set(names)
    assert {"torch", "numpy", "objectfolder.objectfile"}.isdisjoint(modules)
