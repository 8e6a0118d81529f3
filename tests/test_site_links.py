"""The check of the documentation's links finds what is broken."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from links import LONGEST, broken_references, main, wide_lines


@pytest.fixture
def site(tmp_path):
    (tmp_path / "deep").mkdir()
    (tmp_path / "a picture.png").write_bytes(b"")
    (tmp_path / "index.html").write_text(
        '<h1 id="start">x</h1><a href="deep/page.html#part">y</a><img src="a%20picture.png">'
        '<a href="https://example.org/none">z</a><a href="#start">s</a><a href="deep/">d</a>'
    )
    (tmp_path / "deep" / "page.html").write_text('<p id="part"></p><a href="../index.html#start">back</a>')
    (tmp_path / "deep" / "index.html").write_text("<p></p>")
    return tmp_path


def test_a_whole_site_has_no_broken_references(site):
    assert broken_references(site) == []


def test_lines_of_code_that_are_too_long_are_found(site, capsys):
    page, fits, wide = site / "deep" / "page.html", "x" * LONGEST, "<b>y</b>" * (LONGEST + 1)
    page.write_text(f"{page.read_text()}{wide}<pre>{fits}\n{fits}</pre>{wide}")
    assert wide_lines(site) == []
    page.write_text(f"{page.read_text()}<pre>{fits}\n{wide}\n</pre>")
    assert wide_lines(site) == [f"deep/page.html: {'y' * (LONGEST + 1)}"]
    with pytest.raises(SystemExit, match="True"):
        main(site)
    assert "1 lines of code" in capsys.readouterr().out


BROKEN = ('href="none.html"', 'href="deep/page.html#none"', 'src="none.png"', 'href="#none"')


@pytest.mark.parametrize("reference", [*BROKEN, 'href="../outside.html"'])
def test_what_is_missing_is_found(site, reference, capsys):
    (site.parent / "outside.html").write_text("")
    name = reference.split('"')[1]
    page = site / "index.html"
    page.write_text(page.read_text() + f"<a {reference}>")
    assert broken_references(site) == [f"index.html: {name}"]
    with pytest.raises(SystemExit, match="True"):
        main(site)
    assert name in capsys.readouterr().out
