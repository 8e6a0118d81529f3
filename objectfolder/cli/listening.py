"""Commands of a listening study: make, score."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from objectfolder.base.errors import plural
from objectfolder.cli.console import Commands, console, print_line
from objectfolder.cli.files import bounded, page_to_write

listening_app = Commands(
    help="Ask people which sounds are more realistic: `make` a page, then `score` the answers.",
)


@listening_app.command()
def make(
    ours: Annotated[Path, typer.Argument(metavar="OURS", help="Folder of sounds named MATERIAL_ANYTHING.")],
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Folder of sounds with the same names.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Page to write, .html.")] = Path("listening.html"),
    pairs: Annotated[
        int, typer.Option(**bounded(1), help="Pairs that each listener hears, at least 1.")
    ] = 16,
    seed: Annotated[
        int, typer.Option(**bounded(0), help="Random seed for choosing and ordering pairs, 0 or more.")
    ] = 0,
) -> None:
    """Write a page that plays pairs of sounds, such as ours and recordings, and asks which is more realistic.

    The page opens from disk and keeps the answers in the browser until they are saved as CSV. It plays the
    first 10 s of the loudest channel of each sound, at matched levels, in random and balanced order. The
    defaults are the paper's; it had 10 listeners.
    """
    from objectfolder.base.io import write_text
    from objectfolder.benchmarks.listening import study_page

    write_text(page_to_write(out), study_page(ours, other, pairs, seed))
    count = plural(pairs, "pair")
    print_line(f"{out}: {count}; then `objectfolder listening score` the CSV files")


@listening_app.command()
def score(
    results: Annotated[list[Path], typer.Argument(metavar="CSV", help="Answers saved by the page.")],
    study: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Page of the study: answers about other pairs are refused."),
    ] = None,
) -> None:
    """Show how often OURS was preferred, by material, with 95 % intervals (Wilson)."""
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
