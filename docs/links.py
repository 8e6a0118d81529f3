"""Check that every page of a built site finds its pictures, scripts and links: `python docs/links.py FOLDER`.

Follows links within the site, with their fragments; addresses on the web are not opened.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class References(HTMLParser):
    """Names of places in a page, and what it refers to."""

    def __init__(self, text: str):
        super().__init__()
        self.places: set[str] = {"", "top"}
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the attributes that name and refer."""
        for name, value in attrs:
            if name == "id" or (tag == "a" and name == "name"):
                self.places.add(value or "")
            elif name in ("href", "src"):
                self.targets.append(value or "")
            elif name == "srcset":
                self.targets += [part.split()[0] for part in (value or "").split(",") if part.strip()]


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
    """Print what is broken and exit with 1 if anything is."""
    pages = len(list(folder.rglob("*.html")))
    wrong = broken_references(folder)
    print(*wrong, f"{pages} pages, {len(wrong)} broken references", sep="\n")
    sys.exit(bool(wrong) or not pages)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
