"""How the book reads a percent-format script: its cells, after a hidden one that typesets what they print as LaTeX."""

from typing import Any

import jupytext
from nbformat.v4 import new_code_cell

# Runs in the kernel. A figure without a window shows its picture; text is printed as it is.
SETUP = r"""import builtins
import re
import warnings
from IPython import get_ipython
from IPython.core.pylabtools import select_figure_formats
from IPython.display import Math, display

select_figure_formats(get_ipython(), {"retina"}, bbox_inches=None)
warnings.showwarning = lambda message, *where, **more: builtins.print("warning:", message)


def print(*parts, **options):
    if not any(re.search(r"\\[a-z]{2}", str(part)) for part in parts):
        builtins.print(*parts, **options)
        return
    texts = [str(part) if "\\" in str(part) else r"\text{%s }" % part for part in parts]
    open_line = ""
    for piece in " ".join(texts).split(r" \\ "):  # the lines, but not those of a block
        open_line = open_line + r" \\ " + piece if open_line else piece
        if open_line.count(r"\begin") == open_line.count(r"\end"):
            display(Math(open_line))
            open_line = ""
"""


def read(text: str) -> Any:
    """Return the notebook of a script."""
    notebook = jupytext.reads(text, fmt="py:percent")
    notebook.cells.insert(1, new_code_cell(SETUP, metadata={"tags": ["remove-cell"]}))
    return notebook
