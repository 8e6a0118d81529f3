"""Test the optional extras that ``make test`` leaves out, each installed beside the others if it installs.

Usage: ``make test-extras``. Environments are kept in .venv-extras/; the table on standard output is Markdown.
"""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".venv-extras"
LLVM = "DRJIT_LIBLLVM_PATH"


@dataclass(frozen=True)
class Extra:
    """Extra of pyproject.toml, or a system library, with the tests that need it."""

    name: str  #: as the table shows it
    requirements: tuple[str, ...]  #: to install; ``[s3]`` is an extra of this package
    package: str  #: distribution whose version is shown
    select: str  #: expression for ``pytest -k``
    tests: tuple[str, ...]  #: files
    environment: str = "main"  #: virtual environment; extras whose pins conflict need one of their own
    unpinned: tuple[str, ...] = ()  #: packages that constraints.txt does not hold
    pinned: bool = True  #: False where it holds nothing: the package wants older releases of most of it


RENDERERS = "tests/vision/test_renderers.py"
LEROBOT, NERFSTUDIO = (f"tests/benchmarks/datasets/test_{name}.py" for name in ("lerobot", "nerfstudio"))
# The last for Python 3.11, and the last.
LEROBOTS = ("lerobot==0.4.4; python_version < '3.12'", "lerobot[dataset]==0.6.1; python_version >= '3.12'")
# Of later versions, torch may refuse how Nerfstudio indexes, and fpsample has no wheels.
NERFSTUDIOS = ("nerfstudio==1.1.5", "torch==2.10.0", "fpsample<1")
# Validators of assets of OpenUSD; for Python 3.12 at most.
SIMREADY = ("simready-validate", "simready-foundation-tier-core", "omniverse-asset-validator")
REACH, RELEASE = "tests/sim/test_reach.py", "tests/hub/release/test_release.py"
EXTRAS = (
    Extra("raster", ("[raster]",), "pyrender", "raster or tacto", (RENDERERS, "tests/touch/test_tacto.py")),
    Extra("cycles", ("[cycles]",), "bpy", "cycles", (RENDERERS,)),
    Extra("mitsuba-llvm", (), "mitsuba", "llvm", (RENDERERS,)),
    Extra("s3", ("[s3]", "moto[s3,server]"), "dvc-s3", "s3 or outage", ("tests/engine/test_remotes.py",)),
    Extra("usd", ("[usd]",), "usd-core", "usd", ("tests/sim/test_usd_export.py",)),
    Extra(
        "simready",
        ("[usd]", *SIMREADY),
        "simready-foundation-tier-core",
        "usd",
        ("tests/sim/test_usd_export.py",),
    ),
    Extra("batch", ("[batch,rl]",), "warp-lang", "warp", ("tests/sim/test_batched_touch.py",)),
    Extra("lerobot", ("[hub]", *LEROBOTS), "lerobot", "lerobot", (LEROBOT,), "lerobot", pinned=False),
    Extra("nerfstudio", NERFSTUDIOS, "nerfstudio", "nerfstudio", (NERFSTUDIO,), "nerfstudio", pinned=False),
    Extra("croissant", ("[hub]", "mlcroissant"), "mlcroissant", "croissant", (RELEASE,)),
    Extra("metaworld", ("[metaworld]",), "metaworld", "metaworld", (REACH,), "metaworld", ("mujoco",)),
)


def run(*command: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the repository; its output goes to standard error as well."""
    print("$", *command, file=sys.stderr, flush=True)
    outputs = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run([*map(str, command)], cwd=ROOT, env=os.environ | environment, **outputs)
    print(done.stdout, file=sys.stderr, flush=True)
    return done


def install(extra: Extra) -> str:
    """Install what an extra needs; return why that failed, or nothing."""
    home = HOME / extra.environment
    pins = home / "constraints.txt"
    if not (home / "bin" / "python").exists():
        run(sys.executable, "-m", "venv", home)
    lines = (ROOT / "constraints.txt").read_text().splitlines(keepends=True) if extra.pinned else []
    pins.write_text("".join(line for line in lines if line.split("==")[0] not in extra.unpinned))
    own = [word for word in extra.requirements if not word.startswith("[")]
    extras = ",".join(["build", *(word.strip("[]") for word in extra.requirements if word not in own)])
    arguments = os.environ.get("PIP_ARGS", "").split()
    pip = (home / "bin" / "pip", "install", "--quiet", "--disable-pip-version-check", "-c", pins, *arguments)
    done = run(*pip, "-e", f".[{extras}]", *own, "pytest", "hypothesis")
    return "" if done.returncode == 0 else f"does not install: {_last(done.stdout, 'ERROR')}"


def _last(text: str, word: str) -> str:
    """Last line with a word in it, else the last line."""
    lines = text.strip().splitlines() or [""]
    return next((line for line in reversed(lines) if word in line), lines[-1]).strip()[:200]


def version(extra: Extra) -> str:
    """Version of the extra's package; empty if it is not installed."""
    code = f"from importlib.metadata import version; print(version({extra.package!r}))"
    done = run(HOME / extra.environment / "bin" / "python", "-c", code)
    return done.stdout.strip() if done.returncode == 0 else ""


def newest_llvm() -> dict[str, str]:
    """Environment variable that names the newest LLVM library, unless the user has set it."""
    found = [path for folder in ("/usr/lib", "/usr/local/lib") for path in Path(folder).rglob("libLLVM.so.*")]
    found = [path for path in found if path.suffixes[-1][1:].isdigit() or path.suffix == ".1"]
    numbered = {int(path.name.split(".so.")[1].split(".")[0]): path for path in found}
    return {} if LLVM in os.environ or not numbered else {LLVM: str(numbered[max(numbered)])}


def test(extra: Extra) -> tuple[str, int, int, int, str]:
    """Return version, tests passed, failed and skipped, and the reason for those that did not pass."""
    if reason := install(extra):
        return "", 0, 0, 0, reason
    if not (installed := version(extra)):
        return "", 0, 0, 0, f"{extra.package} has no build for this Python"
    report = HOME / f"{extra.name}.xml"
    report.unlink(missing_ok=True)
    python = HOME / extra.environment / "bin" / "python"
    options = ("-m", "slow or not slow", "-p", "no:cacheprovider", f"--junitxml={report}")
    # Plugins for pytest that packages bring take no part: those of old releases stop it.
    environment = newest_llvm() | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = run(python, "-m", "pytest", *options, "-k", extra.select, *extra.tests, **environment)
    if not report.exists():
        return installed, 0, 1, 0, _last(done.stdout, "Error")
    cases = list(ET.parse(report).iter("testcase"))
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    skipped = [case for case in cases if case.find("skipped") is not None]
    reasons = [case.get("name", "") for case in failed]
    reasons += [case.find("skipped").get("message", "") for case in skipped]  # type: ignore[union-attr]
    text = "; ".join(dict.fromkeys(reasons))[:300].replace("|", "/").replace("\n", " ")
    return installed, len(cases) - len(failed) - len(skipped), len(failed), len(skipped), text


def main() -> int:
    """Test every extra, or those that are named; print the table."""
    chosen = [extra for extra in EXTRAS if not sys.argv[1:] or extra.name in sys.argv[1:]]
    rows = [(extra.name, *test(extra)) for extra in chosen]
    print("| extra | version | passed | failed | skipped | reason |\n|---|---|---:|---:|---:|---|")
    for row in rows:
        print("|", " | ".join(str(cell) for cell in row), "|")
    return any(row[3] for row in rows)


if __name__ == "__main__":
    sys.exit(main())
