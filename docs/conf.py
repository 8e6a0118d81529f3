"""How `make docs` builds the site: these Markdown pages, and an API reference from the docstrings."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

project = "objectfolder"
author = "the objectfolder authors"
version = release = installed_version("objectfolder")
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
    "sphinx_copybutton",
    "sphinxcontrib.typer",
]
exclude_patterns = ["reference/generated/objectfolder.cli*"]
templates_path = ["_templates"]

# Markdown: links to headings as on GitHub, tables, dollar signs as they are.
myst_heading_anchors = 4
myst_links_external_new_tab = False

# Docstrings: what stands in single backticks is a name, and has to exist.
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(numpy|np|torch|pathlib|collections|typing)\..*")]
autodoc_default_options = {"members": True, "member-order": "bysource", "show-inheritance": True}
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_mock_imports = ["bpy", "pyrender"]
autosummary_generate = True
autosummary_ignore_module_all = False
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
# A parameter that is documented exists (PR02), and a section is one that numpydoc knows (GL06, GL07).
numpydoc_validation_checks = {"PR02", "GL06", "GL07", "GL08"}
python_use_unqualified_type_names = True
maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"objectfolder {release}"
html_static_path = ["_static"]
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True
