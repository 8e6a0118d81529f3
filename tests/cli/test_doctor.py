import io
import platform
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

import objectfolder
from objectfolder.base.installation import install_command
from objectfolder.cli import app, doctor

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
REQUIREMENTS = [
    "numpy>=2.0",
    "colorama; sys_platform == 'linux'",
    "mitsuba>=3.7; extra == 'build'",
    "dvc==3.67.1; extra == 'build'",
    "bpy; python_version < '3' and extra == 'cycles'",
]


@pytest.fixture
def machine(monkeypatch):
    """A machine with the given versions of packages and libraries, and what Dr.Jit says of LLVM."""

    def make(packages=(), libraries=(), torch="libtorch_cpu.so", llvm=""):
        versions = dict(packages)
        monkeypatch.setattr(doctor, "find_version", lambda package: versions.get(package, ""))
        monkeypatch.setattr(doctor, "has_library", lambda library: library in libraries)
        monkeypatch.setattr(doctor, "requires", lambda package: REQUIREMENTS)
        monkeypatch.setattr(
            doctor, "distribution", lambda package: SimpleNamespace(files=[Path("torch/lib", torch)])
        )
        monkeypatch.setattr(doctor.subprocess, "run", lambda *a, **k: SimpleNamespace(stdout=llvm))
        monkeypatch.setattr(doctor.shutil, "which", dict(packages).get)

    return make


def test_every_extra_for_users_is_listed():
    extras = set(PYPROJECT["project"]["optional-dependencies"])
    assert set(doctor.EXTRAS) == extras - {"dev", "docs"}


def test_a_bare_machine_gets_what_to_install_for_each_part(machine):
    machine()
    parts = {part.name: part for part in doctor.examine()}
    assert not any(part.usable or part.found for part in parts.values())
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 0
    first, _, *rows = result.output.splitlines()
    assert first == f"objectfolder {objectfolder.__version__} in {ROOT}, Python {platform.python_version()}"
    assert [row.split("  ")[0].strip() for row in rows] == list(parts)
    for row, part in zip(rows, parts.values(), strict=True):
        assert "missing" in row
        assert part.brings in row
        assert part.get in row
    assert "libllvm19" in parts["LLVM 19"].get
    assert parts["extra build"].get == install_command("build")
    assert "not for this Python" in parts["extra cycles"].get


def test_remedies_are_folded_in_a_narrow_terminal(machine, monkeypatch):
    machine()
    terminal = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    monkeypatch.setattr(doctor, "console", terminal)
    doctor.doctor()
    text = terminal.file.getvalue()
    assert "…" not in text
    header, *rows = [line for line in text.splitlines() if line.startswith(" ")]
    folded = "".join(row[header.index("if missing") :].strip() for row in rows).replace(" ", "")
    assert "apt-getinstalllibllvm19,andDRJIT_LIBLLVM_PATH(see--help)" in folded


@pytest.mark.parametrize(
    ("name", "here", "found"),
    [
        ("Embree", {"packages": {"embreex": "4.4"}}, "4.4"),
        ("PARDISO (MKL)", {"packages": {"pypardiso": "0.4.7", "mkl": "2026.2"}}, "0.4.7"),
        ("CHOLMOD", {"packages": {"cvxopt": "1.3"}}, "1.3"),
        ("LLVM 19", {"packages": {"mitsuba": "3.9"}, "llvm": "19.1.7\n"}, "19.1.7"),
        ("OpenGL", {"libraries": ["libEGL.so.1"]}, "libEGL.so.1"),
        (
            "CUDA",
            {"libraries": ["libcuda.so.1"], "torch": "libtorch_cuda.so"},
            "NVIDIA driver, torch with CUDA",
        ),
        ("Blender", {"packages": {"blender": "/opt/blender"}}, "/opt/blender"),
        (
            "node, Chromium",
            {"packages": {"node": "/bin/node", "google-chrome": "/bin/google-chrome"}},
            "/bin/node, /bin/google-chrome",
        ),
        ("ffmpeg", {"packages": {"ffmpeg": "/bin/ffmpeg"}}, "/bin/ffmpeg"),
        ("extra build", {"packages": {"mitsuba": "3.9", "dvc": "3.67.1"}}, "installed"),
    ],
)
def test_a_part_that_is_there_is_usable_and_alone(machine, name, here, found):
    machine(**here)
    usable = {part.name: part.found for part in doctor.examine() if part.usable}
    assert usable == {name: found}


@pytest.mark.parametrize(
    ("name", "here", "found"),
    [
        ("PARDISO (MKL)", {"packages": {"pypardiso": "0.4.7"}}, ""),
        ("LLVM 19", {"packages": {"mitsuba": "3.9"}, "llvm": "15.0.6, too old\n"}, "15.0.6, too old"),
        ("CUDA", {"libraries": ["libcuda.so.1"]}, "NVIDIA driver"),
        ("CUDA", {"torch": "libtorch_cuda.so"}, "torch with CUDA"),
        ("node, Chromium", {"packages": {"node": "/bin/node"}}, "/bin/node"),
        ("extra build", {"packages": {"mitsuba": "3.9"}}, "without dvc"),
        ("extra build", {"packages": {"mitsuba": "3.9", "dvc": "3.60"}}, "without dvc"),
    ],
)
def test_half_a_part_is_not_usable(machine, name, here, found):
    machine(**here)
    part = next(part for part in doctor.examine() if part.name == name)
    assert not part.usable
    assert part.found == found


def test_a_library_that_dr_jit_cannot_load_is_missing_and_prints_nothing(monkeypatch, capfd):
    pytest.importorskip("mitsuba")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    assert doctor.llvm().found == ""
    assert capfd.readouterr() == ("", "")


def test_here_it_imports_nothing_heavy():
    code = (
        "import sys; from objectfolder.cli.doctor import examine; parts = examine();"
        "print(next(part.usable for part in parts if part.name == 'Embree'), *sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    usable, *modules = ran.stdout.split()
    assert usable == "True"
    assert {"torch", "drjit", "mitsuba", "dvc", "scipy"}.isdisjoint(modules)
