"""Every module has its place in the reference."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from conf import ROOT, modules


def test_every_module_is_on_a_page_of_the_reference():
    pages = "\n".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.rst"))
    listed = set(re.findall(r"automodule:: (\S+)", pages))
    for package, skipped in re.findall(r"package:: (\S+)(?:\n +:skip: (.*))?", pages):
        elsewhere = tuple(f"{package}.{name}." for name in skipped.split())
        listed |= {name for name in modules(package) if not f"{name}.".startswith(elsewhere)}
    assert set(modules("objectfolder")) - listed == set()
