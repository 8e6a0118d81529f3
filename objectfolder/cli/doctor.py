"""Command that shows what is installed: doctor."""

import ctypes
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, requires, version

from packaging.requirements import Requirement
from rich.table import Column, Table
from rich.text import Text

from objectfolder.base.installation import install_command, installed_version
from objectfolder.cli.console import console, print_wide
from objectfolder.workspace.installed import INSTALLED

#: What each extra of pyproject.toml brings, and its size on disk. Extras for developers are left out.
EXTRAS = {
    "build": "add, build and all stages; 1.4 GB",
    "inspect": "inspect of meshes, solids and views (VTK); 0.6 GB",
    "bench": "grasp stability: scores and baselines (scikit-learn); 0.06 GB",
    "rl": "robot environments, export mjcf and urdf (MuJoCo); 0.1 GB",
    "hub": "export of training sets, releases of hf://; 0.3 GB",
    "batch": "touches in batches on a GPU (NVIDIA Warp); 0.4 GB",
    "usd": "export usd (OpenUSD); 0.1 GB",
    "ray": "build --engine ray, on a cluster; 0.25 GB",
    "s3": "remotes on S3; 0.03 GB",
    "cycles": "render_views.renderer cycles (bpy, GPL); 0.4 GB to download",
    "raster": "render_views.renderer raster, previews; 0.03 GB",
    "metaworld": "bench reach --metaworld, in an environment of its own",
}
# In a process of its own, because Dr.Jit prints, and a library that it cannot use may end the process.
LLVM_PROBE = """
import drjit
from objectfolder.vision.renderers.mitsuba import MIN_LLVM
found = drjit.detail.llvm_version()
print("" if found[0] < 0 else ".".join(map(str, found)) + ("" if found >= MIN_LLVM else ", too old"))
"""


@dataclass(frozen=True)
class Part:
    """Library, program or extra that is used where it is installed."""

    name: str
    found: str  #: versions or paths; empty if nothing is installed
    usable: bool
    brings: str  #: what it is for, and what it costs
    get: str  #: how to install it


def doctor() -> None:
    """Show what is installed, and what is missing: what it adds, its size, and how to install it.

    Queries need only Embree. `objectfolder build` needs the extra **build**. The other parts add commands or
    settings, or save time.

    Installed packages do not affect results, with two exceptions: PARDISO, CHOLMOD and SuperLU give
    vibration modes that agree to rounding, and the nets of the paper and of benchmarks are trained on a GPU
    if there is one.

    **LLVM** is for `render_views.renderer: mitsuba-llvm` in params.yaml. Debian's package is libllvm19. If an
    older one is found first, set `DRJIT_LIBLLVM_PATH=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1`.
    """
    python = sys.version.partition(" ")[0]
    console.print(f"objectfolder {installed_version()} in {INSTALLED}, Python {python}", soft_wrap=True)
    table = Table(
        *(Column(name, overflow="fold") for name in ("part", "found", "brings", "if missing")), box=None
    )
    for part in examine():
        found = Text(part.found or "missing", style="green" if part.usable else "yellow")
        table.add_row(part.name, found, part.brings, "" if part.usable else part.get)
    print_wide(table, console)


def examine() -> list[Part]:
    """Look for every part."""
    return [*(check() for check in CHECKS), *map(extra, EXTRAS)]


def embree() -> Part:
    """Look for the ray caster of all queries."""
    found = find_version("embreex")
    return Part("Embree", found, bool(found), "all queries and most stages", install_command())


def pardiso() -> Part:
    """Look for the fastest factorisation."""
    found, mkl = find_version("pypardiso"), find_version("mkl")
    brings = "modal in half the time and memory; 0.9 GB of the extra build, x86-64 only"
    get = install_command("build")
    return Part("PARDISO (MKL)", mkl and found, bool(mkl and found), brings, get)


def cholmod() -> Part:
    """Look for the factorisation used without PARDISO."""
    found = find_version("cvxopt")
    brings = "modal without PARDISO; GPL, so no extra installs it"
    return Part("CHOLMOD", found, bool(found), brings, "pip install cvxopt")


def llvm() -> Part:
    """Ask Dr.Jit which LLVM it finds."""
    found = ""
    if find_version("mitsuba"):
        ran = subprocess.run([sys.executable, "-c", LLVM_PROBE], capture_output=True, text=True)
        found = ran.stdout.strip()
    brings = "renderer mitsuba-llvm: views in half the time; 0.15 GB"
    get = "apt-get install libllvm19, and DRJIT_LIBLLVM_PATH (see --help)"
    return Part("LLVM 19", found, bool(found) and "too old" not in found, brings, get)


def opengl() -> Part:
    """Look for OpenGL without a screen."""
    found = ", ".join(name for name in ("libEGL.so.1", "libOSMesa.so.8") if has_library(name))
    brings = "pictures of inspect, renderer raster"
    return Part("OpenGL", found, bool(found), brings, "apt-get install libegl1 libgl1-mesa-dri")


def cuda() -> Part:
    """Look for an NVIDIA driver, and for torch's CUDA library without importing torch."""
    driver = has_library("libcuda.so.1")
    torch = any(file.name == "libtorch_cuda.so" for file in distribution("torch").files or ())
    found = ", ".join((["NVIDIA driver"] if driver else []) + (["torch with CUDA"] if torch else []))
    brings = "faster training, renderer mitsuba-cuda; several GB"
    return Part("CUDA", found, driver and torch, brings, "an NVIDIA driver, and torch from the default index")


def blender() -> Part:
    """Look for Blender's program."""
    found = shutil.which("blender") or ""
    brings = "renderer cycles without its extra; GPL"
    return Part("Blender", found, bool(found), brings, "Blender 4.2 or newer, on the PATH")


def chromium() -> Part:
    """Look for what tests the page of `objectfolder view`."""
    node, browser = shutil.which("node"), shutil.which("chromium") or shutil.which("google-chrome")
    found = ", ".join(path for path in (node, browser) if path)
    brings = "make viewer and perf/viewer.py, which test the page of view; any browser shows it"
    get = "apt-get install chromium nodejs npm"
    return Part("node, Chromium", found, bool(node and browser), brings, get)


def ffmpeg() -> Part:
    """Look for the encoder of videos."""
    found = shutil.which("ffmpeg") or ""
    return Part("ffmpeg", found, bool(found), "objectfolder video, simulate", "apt-get install ffmpeg")


CHECKS = (embree, pardiso, cholmod, llvm, opengl, cuda, blender, chromium, ffmpeg)


def extra(name: str) -> Part:
    """Compare an extra of pyproject.toml with the installed packages."""
    wanted = [
        one
        for one in map(Requirement, requires("objectfolder") or ())
        if one.marker and one.marker.evaluate({"extra": name}) and not one.marker.evaluate({"extra": ""})
    ]
    missing = [one.name for one in wanted if not one.specifier.contains(find_version(one.name) or "0", True)]
    shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
    found = "" if len(missing) == len(wanted) else f"without {shown}" if missing else "installed"
    get = install_command(name) if wanted else "not for this Python or machine"
    return Part(f"extra {name}", found, bool(found) and not missing, EXTRAS[name], get)


def find_version(package: str) -> str:
    """Version of an installed package; empty if it is missing."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def has_library(library: str) -> bool:
    """Whether the system has a shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
