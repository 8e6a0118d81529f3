"""Write a release."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from objectfolder.base.disk import new_folder
from objectfolder.base.errors import ObjectFolderError
from objectfolder.base.io import file_digest, write_json, write_text
from objectfolder.hub.release.croissant import croissant
from objectfolder.hub.release.entries import index_text
from objectfolder.hub.release.notices import Notice
from objectfolder.hub.release.pages import LICENCES, Words, card, datasheet
from objectfolder.objectfile.dataset import INDEX, OBJECTS, IndexEntry
from objectfolder.report.site import write_site
from objectfolder.workspace.layout import Build


def write_release(
    out: Path,
    entries: Sequence[IndexEntry],
    words: Words,
    notices: Mapping[str, Notice],
    site: bool = True,
    root: Path = Path(),
    on_object: Callable[[str], None] = lambda key: None,
) -> None:
    """Write a release: complete, or not at all. The same objects and words give the same bytes.

    ``out``: folder to create; ``entries``: of built objects; ``notices``: those of the meshes that have one,
    by key; they are passed on; ``site``: whether to add the report on its objects; ``on_object``: called with
    the key of each object that is done. Raises ObjectFolderError if the folder exists, the disk is full, or
    an object was built anew since it was described.
    """
    size = sum(entry.bytes for entry in entries)
    with new_folder("a release", out, (3 if site else 1) * size, ", or release fewer objects") as folder:
        (folder / OBJECTS).mkdir()
        for entry in entries:
            shutil.copyfile(Build(entry.key, root).object_file, folder / entry.path)
            if file_digest(folder / entry.path) != entry.sha256:
                anew = f"{entry.key} was rebuilt while the release was written"
                raise ObjectFolderError(f"{anew}; run it again after the build")
            if not site:
                on_object(entry.key)
        write_text(folder / INDEX, index_text(entries))
        write_json(folder / "croissant.json", croissant(entries, words, file_digest(folder / INDEX)))
        write_text(folder / "README.md", card(entries, words, notices, site))
        write_text(folder / "DATASHEET.md", datasheet(entries, words))
        if notices:
            (folder / LICENCES).mkdir()
        for key, notice in notices.items():
            shutil.copyfile(notice.path, folder / LICENCES / f"{key}.txt")
        if site:
            built = [Build(entry.key, root).object_file for entry in entries]
            write_site(built, folder / "site", on_object=on_object, costs=False, title=words.name)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        sums = [f"{file_digest(path)}  {path.relative_to(folder)}" for path in files]
        write_text(folder / "SHA256SUMS", "\n".join(sums) + "\n")
