"""Matplotlib figures as SVG that stands inside a page: it follows the page's colours, and has a text alternative."""

from __future__ import annotations

import io
import re
from html import escape
from typing import Any

from .figures.describe import COLOURS

_NAMES = {light.lower(): name for name, (light, _, _) in COLOURS.items() if name != "ink"}
_OPTIONS: dict[str, Any] = {"svg.fonttype": "none", "path.simplify": True, "path.simplify_threshold": 0.3}
_UNDATED = {"Date": None, "Creator": None, "Format": None, "Type": None}


def svg(figure: Any, name: str, alt: str) -> str:
    """Return a figure as an `<svg>` element for a page.

    Colours become CSS variables such as `var(--blue, #0072b2)`, black becomes `currentColor`, ids are unique to `name`.

    Parameters
    ----------
    figure : matplotlib Figure
    name : str
        A name that no other picture of the page has; letters, digits, "-" and "_".
    alt : str
        The text alternative.
    """
    import matplotlib as mpl

    out = io.StringIO()
    options: Any = {**_OPTIONS, "svg.hashsalt": name}
    with mpl.rc_context(options):
        figure.savefig(out, format="svg", transparent=True, metadata=_UNDATED)
    return in_page(out.getvalue(), name, alt)


def in_page(text: str, name: str, alt: str) -> str:
    """Turn an SVG document of matplotlib's into an element of a page."""
    head, body = re.split(r"(?<=>)", text[text.index("<svg") :], maxsplit=1)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    # A style element in here would hold for the whole page.
    body = re.sub(r"<style.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r'(?<=\sid=")(?=[^"])|(?<=href="#)|(?<=url\(#)', f"{name}-", body)
    body = re.sub(r'(style|fill|stroke)="([^"]*)"', lambda found: f'{found[1]}="{_restyled(found[2])}"', body)
    body = re.sub(r"\s*\n\s*", "\n", body).replace(' transform="rotate(-0 ', ' transform="rotate(0 ')
    body = re.sub(r' transform="rotate\(0 [^"]*\)"', "", body)
    body = re.sub(r' (?:d|x|y|width|height|transform)="[^"]*"', _shortened, body)
    box = re.search(r'viewBox="([^"]*)"', head)
    assert box is not None
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="{box[1]}" '
        f'class="drawn" role="img" aria-label="{escape(alt)}"><title>{escape(alt)}</title>{body.lstrip()}'
    )


def _shortened(found: re.Match[str]) -> str:
    """Cut numbers after a hundredth of a point."""
    return re.sub(r"(\d\.\d\d)\d+", r"\1", found[0])


def _restyled(style: str) -> str:
    style = re.sub(r"font-family: [^;]*(; )?", "", style)
    style = style.replace("#000000", "currentColor")
    return re.sub(r"#[0-9a-f]{6}", lambda found: _variable(found[0]), style)


def _variable(colour: str) -> str:
    return f"var(--{_NAMES[colour]}, {colour})" if colour in _NAMES else colour
