import subprocess

import pytest

from objectfolder.workspace.code_digests import digests, imported_files

FILES = {
    "objectfolder/__init__.py": '"""Doc."""\n',
    "objectfolder/deep/__init__.py": "",
    "objectfolder/deep/leaf.py": "import numpy\n",
    "objectfolder/middle.py": "def f():\n    from objectfolder.deep import leaf\n",
    "objectfolder/typed.py": "x = 1\n",
    "objectfolder/other.py": "y = 1\n",
    "stages/__init__.py": "import sys\n",
    "stages/solve.py": (
        "from typing import TYPE_CHECKING\n"
        "import objectfolder.middle\n"
        "if TYPE_CHECKING:\n    from objectfolder import typed\n"
        "from stages import run\n"
    ),
}


@pytest.fixture
def project(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_imports_are_followed_into_functions_but_not_into_type_checking(project):
    assert imported_files("stages/solve.py", project) == [
        "objectfolder/__init__.py",
        "objectfolder/deep/leaf.py",
        "objectfolder/middle.py",
        "stages/__init__.py",
        "stages/solve.py",
    ]


def test_digests_change_with_what_is_imported_and_nothing_else(project):
    before = digests("stages/solve.py", project)
    (project / "objectfolder/other.py").write_text("y = 2\n")
    assert digests("stages/solve.py", project) == before
    (project / "objectfolder/deep/leaf.py").write_text("import scipy\n")
    changed = set(digests("stages/solve.py", project).splitlines()) ^ set(before.splitlines())
    assert {line.split()[1] for line in changed} == {"objectfolder/deep/leaf.py"}


def test_digests_are_those_of_sha256sum(project):
    checked = subprocess.run(
        ["sha256sum", "--check", "-"],
        input=digests("stages/solve.py", project),
        cwd=project,
        text=True,
        capture_output=True,
    )
    assert checked.returncode == 0, checked.stdout
