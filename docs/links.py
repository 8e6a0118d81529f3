"""Check the pages of a built site: `python docs/links.py FOLDER`.

Every page finds its pictures, scripts and links within the site, with their fragments; addresses on the web
are not opened. Lines of code fit their column.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Characters of a line of code that fit their column in a window of 1,300 pixels; see _static/site.css.
LONGEST = 110


class References(HTMLParser):
    """Names of places in a page, what it refers to, and its blocks of code."""

    def __init__(self, text: str):
        super().__init__()
        self.places: set[str] = {"", "top"}
        self.targets: list[str] = []
        self.blocks: list[str] = []
        self._in_block = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the attributes that name and refer, and begin blocks of code."""
        if tag == "pre":
            self._in_block = True
            self.blocks.append("")
        for name, value in attrs:
            if name == "id" or (tag == "a" and name == "name"):
                self.places.add(value or "")
            elif name in ("href", "src"):
                self.targets.append(value or "")
            elif name == "srcset":
                self.targets += [part.split()[0] for part in (value or "").split(",") if part.strip()]

    def handle_endtag(self, tag: str) -> None:
        """End blocks of code."""
        self._in_block = self._in_block and tag != "pre"

    def handle_data(self, data: str) -> None:
        """Collect code."""
        if self._in_block:
            self.blocks[-1] += data


def wide_lines(folder: Path) -> list[str]:
    """Return lines of code that are too long for their column, as "page: line"; sources of modules may be."""
    return [
        f"{path.relative_to(folder)}: {line}"
        for path in sorted(folder.rglob("*.html"))
        if "_modules" not in path.parts
        for block in References(path.read_text("utf-8")).blocks
        for line in block.splitlines()
        if len(line) > LONGEST
    ]


def broken_references(folder: Path) -> list[str]:
    """Return what pages refer to and the site lacks, as "page: reference"."""
    pages = {path.resolve(): References(path.read_text("utf-8")) for path in sorted(folder.rglob("*.html"))}
    wrong = []
    for path, page in pages.items():
        for target in page.targets:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            place = path if not parts.path else (path.parent / unquote(parts.path)).resolve()
            place = place / "index.html" if place.is_dir() else place
            found = place.is_file() and place.is_relative_to(folder.resolve())
            if found and place in pages:
                found = unquote(parts.fragment) in pages[place].places
            if not found:
                wrong.append(f"{path.relative_to(folder.resolve())}: {target}")
    return wrong


def main(folder: Path) -> None:
    """Print what is broken or too wide and exit with 1 if anything is."""
    pages = len(list(folder.rglob("*.html")))
    broken, wide = broken_references(folder), wide_lines(folder)
    counts = (
        f"{pages} pages, {len(broken)} broken references, {len(wide)} lines of code over {LONGEST} characters"
    )
    print(*broken, *wide, counts, sep="\n")
    sys.exit(bool(broken or wide) or not pages)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
