"""Sphinx: the API reference from the docstrings. `./run docs/api/build` makes results/api/index.html."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

project = "dolfinx_mortar_al"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_build"]
html_theme = "furo"  # light or dark as the reader's system is
html_title = "API reference"
html_show_copyright = html_show_sphinx = False
nitpicky = False
autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("Array", "Index", "Bool", "Decisions", "Snapshot")}  # of NumPy arrays
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar, napoleon_use_rtype = True, False
default_role = "code"  # `name` is code, as in Markdown

BARS = re.compile(r"\|(?=\S)")  # |λ| is a norm, not a reST substitution


def escape(app, what, name, obj, options, lines):
    """What means something else to reST than in the docstrings."""
    lines[:] = [BARS.sub(r"\\|", line) for line in lines]


def setup(app):
    """Hooks."""
    app.connect("autodoc-process-docstring", escape, priority=400)
