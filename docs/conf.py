"""Sphinx configuration of `make docs`: these pages, and a reference from docstrings and `--help`."""

import re
import sys
import warnings
from contextlib import suppress
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from numpydoc.validate import validate
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

log = logging.getLogger(__name__)

project = "objectfolder"
release = installed_version("objectfolder")
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
    "sphinx_copybutton",
    "sphinxcontrib.typer",
]

myst_heading_anchors = 4

# Single backticks in a docstring mark names of this project, which must exist, as must its types.
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [
    ("py:(class|data|exc|obj)", r"(?!objectfolder\.)[\w.]+\.\w+"),
    ("py:class", r"\w+|objectfolder\..*\.(_\w+|Answer|Batch|Config|Model|Point|\w+Queries)"),
]
autodoc_default_options = {
    "members": True,
    "member-order": "bysource",
    "exclude-members": "model_config",
}
autodoc_mock_imports = ["bpy", "warp", "metaworld", "pyrender", "OpenGL"]
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 90
numpydoc_show_class_members = False
# Raised by docstrings of other packages, which the site does not show.
warnings.filterwarnings("ignore", r"potentially wrong underline length(.|\n)*site-packages", UserWarning)
viewcode_follow_imported_members = False

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"objectfolder {release}"
html_copy_source = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


class PackageDirective(SphinxDirective):
    """A section for each module of a package, except those in ``:skip:``, which are on other pages."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {"skip": directives.unchanged}

    def run(self) -> list[nodes.Node]:
        """Expand into automodule directives."""
        package = self.arguments[0]
        skipped = self.options.get("skip", "").split()
        lines: list[str] = []
        for module in modules(package):
            name = module.removeprefix(package).removeprefix(".")
            if name.partition(".")[0] not in skipped:
                lines += [name, "-" * len(name), "", f".. automodule:: {module}", ""]
        self.content = StringList(lines, self.get_source_info()[0])
        return self.parse_content_to_nodes(allow_section_headings=True)


def modules(package: str) -> list[str]:
    """Return the dotted names of all nonempty modules of a package, without the command line."""
    files = sorted(ROOT.joinpath(*package.split(".")).rglob("*.py"))
    parts = [file.relative_to(ROOT).with_suffix("").parts for file in files if file.stat().st_size]
    names = [".".join(part for part in path if part != "__init__") for path in parts]
    return [name for name in names if name != "objectfolder" and not name.startswith("objectfolder.cli")]


def resolve_short_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.Node | None:
    """Resolve a name without its module in a docstring, if it is unique."""
    if node.get("reftype") not in ("obj", "exc"):
        return None
    domain = env.domains.python_domain
    found = domain.find_obj(env, "", "", node["reftarget"], None, 1)
    found = [(name, entry) for name, entry in found if entry.objtype != "module"]
    if len(found) != 1:
        return None
    name, entry = found[0]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, content, name)


def keep_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, args: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """Run before numpydoc, which fails on objects without a signature; make defaults readable."""
    return args and args.replace("<factory>", "..."), result


def prepare_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Link pages by name; warn about parameters that do not exist and unknown sections."""
    lines[:] = [re.sub(r"\bdocs/([\w/]+)\.md\b", r":doc:`/\1`", line) for line in lines]
    if (getattr(obj, "__module__", None) or "").startswith("objectfolder."):
        errors = []
        # A class that a call has made has no line of its own; nor has what a mocked decorator returns.
        with suppress(StopIteration, ValueError):
            errors = validate(name)["errors"]
        for code, problem in errors:
            if code in ("PR02", "GL06", "GL07"):
                log.warning("docstring of %s: %s", name, problem)


def check_complete(app: Sphinx, env: BuildEnvironment) -> None:
    """Warn about modules that no page documents."""
    for name in sorted(set(modules("objectfolder")) - set(env.domains.python_domain.modules)):
        log.warning("module %s is on no page of docs/reference", name)


def setup(app: Sphinx) -> None:
    """Register the extensions."""
    app.add_directive("package", PackageDirective)
    app.connect("autodoc-process-signature", keep_signature, priority=1)
    app.connect("autodoc-process-docstring", prepare_docstring, priority=1)
    app.connect("missing-reference", resolve_short_name)
    app.connect("env-check-consistency", check_complete)
