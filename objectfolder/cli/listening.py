"""Commands of a listening study: make, score."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import plural
from objectfolder.cli.console import App, console, print_line
from objectfolder.cli.files import page_to_write

listening_app = App(
    help="Ask listeners which of two sounds is more real: `make` a page, `score` the answers.",
)


@listening_app.command()
def make(
    ours: Annotated[Path, typer.Argument(metavar="OURS", help="Folder of sounds named MATERIAL_anything.")],
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Folder of sounds of the same names.")],
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write.")] = Path("listening.html"),
    pairs: Annotated[int, typer.Option(min=1, help="Pairs that each listener hears.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Random seed for choosing and ordering pairs.")] = 0,
) -> None:
    """Write a page that plays pairs of sounds, such as ours and recordings, and asks which is more real.

    The page needs no server, and keeps the answers in the browser until they are saved as CSV. It plays the
    first 10 s of the loudest channel of each sound. Levels are matched; orders are random and balanced. The
    defaults are those of the paper, which had 10 listeners.
    """
    from objectfolder.base.io import write_text
    from objectfolder.benchmarks.listening import study_page

    write_text(page_to_write(out), study_page(ours, other, pairs, seed))
    count = plural(pairs, "pair")
    print_line(f"{out}: {count}; then `objectfolder listening score` the CSV files")


@listening_app.command()
def score(
    results: Annotated[list[Path], typer.Argument(metavar="CSV...", help="Answers that the page saved.")],
    study: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Page of the study: refuse answers to other pairs."),
    ] = None,
) -> None:
    """Show how often OURS was preferred, by material, with Wilson's 95 % intervals."""
    from objectfolder.benchmarks.listening import preferences
    from objectfolder.benchmarks.reporting.published import LISTENING

    scores = preferences(results, study)
    title = f"{scores.method} preferred by {plural(scores.listeners, 'listener')} "
    paper = f"the paper's simulation: {LISTENING.cells('simulation')[0]} %, {LISTENING.source}"
    table = Table(title=Text(f"{title}(chance: 50 %; {paper})"))
    for name in ("material", "answers", "preferred", "95 % interval"):
        table.add_column(name, justify="left" if name == "material" else "right")
    for material, one in (*scores.materials.items(), (None, scores.total)):
        if material is None:
            table.add_section()
        low, high = one.interval
        name = "all materials" if material is None else material
        table.add_row(Text(name), str(one.answers), f"{one.share:.0%}", f"{low:.0%} to {high:.0%}")
    console.print(table)
