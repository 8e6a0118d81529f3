"""Command that packs objects for others: release."""

import datetime
import os
import re
from pathlib import Path
from typing import Annotated

import typer

from objectfolder.base.checks import is_web_address, one_line
from objectfolder.base.errors import ObjectFolderError, plural, quoted, shortened
from objectfolder.cli.console import console, print_line, show_status
from objectfolder.cli.files import OWN, folder_to_write, object_keys


def release(
    *,
    objects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[OBJECT]...",
            help=f"Built objects, each by its {OWN}; default: all.",
            callback=object_keys,
        ),
    ] = None,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to create.")],
    licence: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[OBJECT=]LICENCE",
            help="Licence of an object, or of all whose mesh has no SOURCE.txt, such as CC0-1.0. Repeatable.",
        ),
    ] = None,
    category: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[OBJECT=]CATEGORY",
            help="Category of an object, or of all others. Generated objects have one. Repeatable.",
        ),
    ] = None,
    catalogue: Annotated[
        Path | None,
        typer.Option(help="Catalogue of fetched objects, for their categories, such as catalogs/real.yaml."),
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the dataset.")] = "Object Files",
    creator: Annotated[str, typer.Option(metavar="NAME", help="Publisher.")] = "unnamed",
    version: Annotated[str, typer.Option(metavar="X.Y.Z", help="Version of the dataset.")] = "1.0.0",
    date: Annotated[
        str | None, typer.Option(metavar="YYYY-MM-DD", help="Date of publication; default: today.")
    ] = None,
    url: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Web address of the dataset.")
    ] = "https://example.org",
    draft: Annotated[
        bool, typer.Option("--draft", help="Allow placeholders, and licences that have no SPDX identifier.")
    ] = False,
    site: Annotated[bool, typer.Option("--site/--no-site", help="Add the report on its objects.")] = True,
) -> None:
    """Pack built objects into a dataset for others (docs/dataset.md).

    The folder holds Object Files, an index, a dataset card, a datasheet, Croissant metadata, licences,
    checksums and the report. In Python, `objectfolder.Dataset("OUT")` reads it.

    Example: `objectfolder release kitchen --name Kitchen --creator "A. Smith" --url URL --licence CC0-1.0`
    """
    from objectfolder.hub.fetch.catalogue import read_catalogue
    from objectfolder.hub.release.entries import (
        check_publishable,
        entry_of,
        kept_licences,
        notices_of,
        select_keys,
    )
    from objectfolder.hub.release.pages import describe_release
    from objectfolder.hub.release.write import write_release
    from objectfolder.objectfile.dataset import MAX_CATEGORY, MAX_TEXT
    from objectfolder.workspace import params
    from objectfolder.workspace.check import check_own

    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9}){2}", version):
        raise ObjectFolderError(f"--version {quoted(version)}, expected three numbers such as 1.0.0")
    if not is_web_address(url):
        raise ObjectFolderError(
            f"--url {quoted(url)}, expected an address such as https://HOST/kitchen, without password"
        )
    one_line("--name", name)
    one_line("--creator", creator)
    if os.path.lexists(folder_to_write(out)):
        raise ObjectFolderError(f"{out} exists already: choose another name, or delete it")
    check_own(values := params.read())
    keys = select_keys(objects or (), values)
    licences = _by_key("--licence", licence, keys, MAX_TEXT)
    listed = read_catalogue(catalogue).objects if catalogue else {}
    categories = {
        key: one_line(f"{catalogue}: category of {key}", entry.category, MAX_CATEGORY)
        for key, entry in listed.items()
        if entry.category
    }
    categories |= _by_key("--category", category, keys, MAX_CATEGORY)
    with show_status("reading objects") as show:
        entries = [entry_of(key, values, licences, categories) for key in keys]
        words = describe_release(
            entries, name=name, creator=creator, version=version, date=_day(date), url=url
        )
        notices = notices_of(keys, values)
        kept = kept_licences(licences[""], entries, notices) if "" in licences else ""
        if not draft:
            check_publishable(entries, words, notices)
        write_release(out, entries, words, notices, site, on_object=lambda key: show(f"{key} is done"))
    size = sum(entry.bytes for entry in entries) / 1e6
    print_line(f"{out}: {plural(len(entries), 'object')}, {size:.1f} MB of Object Files")
    if kept:
        console.print(
            f"note: --licence {licences['']} does not apply where SOURCE.txt states another: {kept}",
            highlight=False,
        )
    unnamed = [entry.key for entry in entries if not entry.source]
    if unnamed:
        console.print(
            f"note: no source of {shortened(', '.join(unnamed))}: state it in SOURCE.txt beside the mesh",
            highlight=False,
        )
    unscored = [entry.key for entry in entries if entry.vision_psnr is None]
    if unscored:
        console.print(
            f"note: no scores of {shortened(', '.join(unscored))}: `objectfolder build` writes them",
            highlight=False,
        )


def _day(date: str | None) -> str:
    try:
        return (datetime.date.fromisoformat(date) if date else datetime.date.today()).isoformat()
    except ValueError as error:
        raise ObjectFolderError(f"--date {quoted(date)}, expected a day such as 2026-11-24") from error


def _by_key(option: str, texts: list[str] | None, keys: list[str], most: int) -> dict[str, str]:
    """Split OBJECT=TEXT; a text without an object has the key ""."""
    from objectfolder.workspace.params import KEY

    found: dict[str, str] = {}
    for text in texts or ():
        key, equals, value = text.partition("=")
        if not equals or not KEY.fullmatch(key):  # a URL may have a query
            key, value = "", text
        if key and key not in keys:
            raise ObjectFolderError(
                f"{option} {quoted(text)}: {quoted(key)} is not among the objects of this release, "
                f"{shortened(', '.join(keys))}"
            )
        if key in found or not value.strip():
            problem = "is given twice" if key in found else "is empty"
            of = key or "all objects without one"
            raise ObjectFolderError(f"{option} {quoted(text)}: that of {of} {problem}, expected one text")
        found[key] = one_line(f"{option} {key}".rstrip(), value.strip(), most)
    return found
