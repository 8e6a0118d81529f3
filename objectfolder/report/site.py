"""A static site about Object Files that works from disk and offline."""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from objectfolder.errors import ObjectFolderError
from objectfolder.io import write_text
from objectfolder.report.facts import SCORES, ObjectReport, missing_object, object_report
from objectfolder.viewer.page import filled_page, page_parts, static_text


def write_site(
    files: Iterable[Path],
    out: Path,
    missing: Mapping[str, dict[str, Any]] | None = None,
    single_file: bool = False,
    on_object: Callable[[str], None] = lambda key: None,
) -> Path:
    """Write a report.

    Parameters
    ----------
    files : iterable of Path
        Object Files; truth and scores of those in a workspace are read from there.
    out : Path
        Folder for ``index.html``, ``viewer.js`` and ``objects/KEY.js``; with ``single_file`` the page.
    missing : mapping, optional
        Objects that are not built: entries of params.yaml by key.
    single_file : bool
        Write one page that holds everything, to be mailed.
    on_object : callable
        Called with the key of each object that is done.

    Returns
    -------
    Path
        The page to open.

    Raises
    ------
    ObjectFolderError
        If two files hold objects of one key.
    """
    rows = [missing_object(key, entry) for key, entry in (missing or {}).items()]
    held = []
    for path in files:
        report = object_report(path)
        key = report.row["key"]
        if any(key == row["key"] for row in rows):
            raise ObjectFolderError(
                f"{path}: another file holds an object of the key {key}; give one of them"
            )
        rows.append(report.row)
        if single_file:
            held.append(_embedded(report))
        else:
            write_text(out / "objects" / f"{key}.js", _script(report))
        on_object(key)
    page = out if single_file else out / "index.html"
    # What the live viewer is made of; the page puts an object into it.
    frame = filled_page(
        "page.html", page_parts({}, "{{title}}") | {"objects": "{{objects}}", "script": "{{script}}"}
    )
    content = {
        "title": "Report of objects",
        "data": _json({"rows": rows, "scores": SCORES, "frame": frame}),
        "objects": "\n".join(held),
        "viewer": _json(static_text("viewer.js")) if single_file else "null",
        "script": static_text("report.js"),
    }
    if not single_file:
        write_text(out / "viewer.js", static_text("viewer.js"))
    write_text(page, filled_page("report.html", content))
    return page


def _script(report: ObjectReport) -> str:
    """Return the file that the page loads when an object is opened; scripts load from disk, data does not."""
    return f"objectfolderReport({_json(report.detail)});\n"


def _embedded(report: ObjectReport) -> str:
    return (
        f'<script type="application/json" data-report="{report.row["key"]}">{_json(report.detail)}</script>'
    )


def _json(value: Any) -> str:
    """Return JSON that may stand in a script element."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
