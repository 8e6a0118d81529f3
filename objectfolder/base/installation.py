"""How the package that runs was installed: its version, and what installs it again with an extra.

It is on no package index, so the source is a clone, a commit of its repository, or a wheel.
"""

import json
import re
import shlex
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname

_NAME = "objectfolder"
_PACKAGES = {"igl": "libigl", "pxr": "usd-core", "sklearn": "scikit-learn"}  # whose modules have other names
_HOME = Path(__file__).resolve().parents[2]  # directory that contains the package


def installed_version() -> str:
    """Return the version of the package; ``unknown`` if it is on the path, but not installed."""
    try:
        return version(_NAME)
    except PackageNotFoundError:
        return "unknown"


def install_command(extra: str = "") -> str:
    """Return the command that installs this package with an extra, for messages.

    Where the package is from is not known if the clone or wheel is gone: the command then names a clone as
    CLONE, and says so.
    """
    brackets = f"[{extra}]" if extra else ""
    source = _source()
    if source is None:
        return f"pip install 'CLONE{brackets}' (CLONE: a clone of the repository of {_NAME})"
    if isinstance(source, str):
        return f"pip install {shlex.quote(f'{_NAME}{brackets} @ {source}')}"
    editable = "-e " if source == _HOME else ""
    return f"pip install {editable}{shlex.quote(f'{source}{brackets}')}"


def extra_with(module: str) -> str:
    """Return the first extra that asks for a module's package; ``build`` if none does. "": the base does."""
    top = module.partition(".")[0]
    package = _PACKAGES.get(top, top.replace("_", "-"))
    with suppress(PackageNotFoundError):
        for line in requires(_NAME) or ():
            if line.startswith(package) and not re.match(r"[\w.-]", line[len(package) :]):
                found = re.search(r"extra == ['\"]([\w-]+)", line)
                return found[1] if found else ""
    return "build"


def requirement(extra: str) -> str:
    """Return this package with an extra as a line of a requirements file.

    By number if nothing is known of where it is from.
    """
    source = _source()
    if source is None:
        return f"{_NAME}[{extra}]=={installed_version()}"
    return f"{_NAME}[{extra}] @ {source.as_uri() if isinstance(source, Path) else source}"


def _source() -> Path | str | None:
    """Return the folder of a clone, the URL of a commit or a wheel for pip, or None if it is not known."""
    if all((_HOME / name).is_file() for name in ("pyproject.toml", "dvc.yaml")):
        return _HOME
    recorded = _recorded()
    url = str(recorded.get("url", ""))
    if vcs := recorded.get("vcs_info"):
        return f"{vcs['vcs']}+{url}@{vcs['commit_id']}"
    if not url.startswith("file:"):
        return url or None
    path = Path(url2pathname(urlparse(url).path))
    return path if path.is_dir() else url if path.is_file() else None


def _recorded() -> dict[str, Any]:
    """Return what pip recorded of the place that it installed the package from; empty for an index."""
    with suppress(PackageNotFoundError):
        return dict(json.loads(distribution(_NAME).read_text("direct_url.json") or "{}"))
    return {}
