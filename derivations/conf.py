"""The book: `python -m sphinx -W derivations derivations/_build` runs every script and draws every picture."""

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent / "figures")]  # cells.py, gallery.py

project = "narx_sym"
author = copyright = "The narx_sym authors"
version = release = installed("narx-sym")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "conf.py", "cells.py", "figures/*.py", "_templates"]
html_theme = "furo"
html_title = "narx_sym"
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_show_sourcelink = html_show_copyright = False

# Scripts are pages. Two that run at the same time share the two cores of a small machine: -j 2.
nb_custom_formats = {".py": ["cells.read", {}]}
nb_execution_mode = "cache"  # what did not change is not run again
nb_execution_cache_path = str(Path(__file__).parent / "_build" / "jupyter_cache")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

templates_path = ["_templates"]
autosummary_generate = True
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints = "description"
napoleon_google_docstring = False
suppress_warnings = ["ref.python"]  # words of a type, such as "units", are no names that must be found
default_role = "code"  # the docstrings write `name`


def plain(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Take |x| and y* in a docstring as they are written: no substitution, no emphasis."""
    del app, what, name, thing, options
    pieces = re.split("(``?[^`]+``?)", "\n".join(lines))
    lines[:] = "".join(p if p.startswith("`") else re.sub(r"[|*]", r"\\\g<0>", p) for p in pieces).split("\n")


def mathml(self: Any, node: Any) -> None:
    """Write a formula as MathML: a browser shows it without scripts, and without network."""
    block = isinstance(node, nodes.math_block)
    text = node.astext().strip("$").strip().removeprefix(r"\displaystyle ")
    text = text.replace("{aligned}", "{align*}").replace("[6pt]", "")  # what the converter knows
    formula = convert(text, display="block" if block else "inline")
    formula = re.sub(r'columnalign="(\w+)"', r'style="text-align: \1"', formula)  # what browsers know
    self.body.append(f'<div class="formula">{formula}</div>' if block else formula)
    raise nodes.SkipNode  # its text is written


html_math_renderer = "mathml"


def setup(app: Any) -> None:
    """Connect what is above."""
    import gallery

    app.connect("builder-inited", gallery.write)
    app.connect("autodoc-process-docstring", plain)
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))
