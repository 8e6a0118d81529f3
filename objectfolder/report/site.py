"""A static site about Object Files that works from disk and offline."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from objectfolder.base.disk import refuse_links
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import write_text
from objectfolder.base.text import in_html, in_script
from objectfolder.report.facts import SCORES, ObjectReport, missing_object, object_report, read_key
from objectfolder.viewer.page import fill_page, page_parts, static_text


def write_site(
    files: Iterable[Path],
    out: Path,
    missing: Mapping[str, dict[str, Any]] | None = None,
    single_file: bool = False,
    on_object: Callable[[str], None] = lambda key: None,
    on_failure: Callable[[str, ObjectFolderError], None] | None = None,
    costs: bool = True,
    title: str = "Objects",
) -> Path:
    """Write a report, complete or not at all, and return the page to open.

    Truth and scores of Object Files in a workspace are read from there; ``missing`` are entries of
    params.yaml, by key, of objects that are not built. ``out`` is a folder for ``index.html``, ``viewer.js``
    and ``objects/KEY.js``, whose other files are left alone; with ``single_file`` it is one page that holds
    everything, to be mailed. ``on_object`` is called with the key of each object that is done, ``on_failure``
    with key and error of each that cannot be reported, which the overview then says; by default the error is
    raised. ``costs`` says whether to report what builds cost, which differs from one to the next.

    Raises ObjectFolderError if two files hold objects of one key.
    """
    paths = list(files)
    found = [read_key(path) for path in paths]
    taken = set(missing or {})
    for path, known in zip(paths, found):
        if known in taken:
            twice = f"{path}: another file holds an object of the key {known}; give one of them"
            raise ObjectFolderError(twice)
        if known is not None:
            taken.add(known)
    keys = []
    for path, known in zip(paths, found):
        guess = path.absolute().parent.name if path.stem == "ObjectFile" else path.stem
        keys.append(known or (guess if guess not in taken else str(path)))
        taken.add(keys[-1])
    rows = [missing_object(key, entry) for key, entry in (missing or {}).items()]
    held: list[str] = []

    def report(write: Callable[[ObjectReport], None]) -> str:
        """Report on all objects; return the page."""
        for path, key in zip(paths, keys):
            try:
                found = object_report(path, costs)
            except ObjectFolderError as error:
                if on_failure is None:
                    raise
                on_failure(key, error)
                rows.append(missing_object(key, {"material": "unknown"}, error))
            else:
                rows.append(found.row)
                write(found)
                on_object(key)
        return _page(title, rows, held, single_file)

    def embed(found: ObjectReport) -> None:
        tag = f'<script type="application/json" data-report="{in_html(found.row["key"])}">'
        held.append(f"{tag}{in_script(found.detail)}</script>")

    if single_file:
        write_text(out, report(embed))
        return out
    out.mkdir(parents=True, exist_ok=True)
    refuse_links(out / "objects", out)
    with TemporaryDirectory(dir=out, prefix=".report.") as folder:
        scratch = Path(folder)
        names: list[str] = []

        def keep(name: str, text: str) -> None:
            write_text(scratch / name, text)
            names.append(name)

        def keep_object(found: ObjectReport) -> None:
            """Write the file that the page loads when it opens an object: scripts load from disk."""
            keep(f"objects/{found.row['key']}.js", f"objectfolderReport({in_script(found.detail)});\n")

        page = report(keep_object)
        keep("viewer.js", f"objectfolderViewer({in_script(static_text('viewer.js'))});\n")
        keep("index.html", page)
        for name in names:
            (out / name).parent.mkdir(exist_ok=True)
            (scratch / name).replace(out / name)
    return out / "index.html"


def _page(title: str, rows: list[dict[str, Any]], held: list[str], single_file: bool) -> str:
    # What the live viewer is made of; the page puts an object into it.
    parts = page_parts({}, "{{title}}") | {"objects": "{{objects}}", "script": "{{script}}"}
    frame = fill_page("page.html", parts)
    content = {
        "title": in_html(title),
        "data": in_script({"rows": rows, "scores": SCORES, "frame": frame}),
        "objects": "\n".join(held),
        "viewer": in_script(static_text("viewer.js")) if single_file else "null",
        "script": static_text("report.js"),
    }
    return fill_page("report.html", content)
