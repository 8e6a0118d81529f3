import subprocess

import pytest

from objectfolder.errors import ObjectFolderError
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


def test_relative_imports_are_followed(project):
    (project / "stages/helper.py").write_text("z = 1\n")
    (project / "stages/other.py").write_text("z = 1\n")
    (project / "stages/solve.py").write_text("from . import helper\nfrom .other import z\n")
    (project / "objectfolder/deep/leaf.py").write_text("from .. import middle\nfrom ..other import y\n")
    assert imported_files("stages/solve.py", project) == [
        "stages/__init__.py",
        "stages/helper.py",
        "stages/other.py",
        "stages/solve.py",
    ]
    assert imported_files("objectfolder/deep/leaf.py", project) == [
        "objectfolder/__init__.py",
        "objectfolder/deep/leaf.py",
        "objectfolder/middle.py",
        "objectfolder/other.py",
    ]


def test_a_module_that_the_pipeline_would_not_see_is_refused(project):
    (project / "own.py").write_text("z = 1\n")
    (project / "stages/solve.py").write_text("import own\n")
    with pytest.raises(ObjectFolderError, match=r"stages/solve\.py imports own .* import stages\.own"):
        imported_files("stages/solve.py", project)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"x = (\n", r"\.py, line 1: '\(' was never closed"), (b"x = '\xe9'\n", "can't decode byte 0xe9")],
)
def test_a_file_that_is_not_python_is_named(project, content, message):
    (project / "objectfolder/middle.py").write_bytes(content)
    with pytest.raises(ObjectFolderError, match=f"objectfolder/middle.*{message}"):
        imported_files("stages/solve.py", project)


def test_a_package_that_lies_beside_its_libraries_is_digested(project):
    (project / "numpy").mkdir()
    (project / "numpy/__init__.py").write_text("")
    assert "objectfolder/deep/leaf.py" in digests("objectfolder/middle.py", project)
    (project / "stages/solve.py").write_text("import numpy\n")
    with pytest.raises(ObjectFolderError, match="imports numpy of the workspace"):
        imported_files("stages/solve.py", project)
