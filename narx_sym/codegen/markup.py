"""XML as nested calls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as Xml


def element(tag: str, attributes: Mapping[str, str] | None = None, *inside: Any) -> Any:
    """Return an element with attributes, and what is inside: a text, or elements."""
    made = Xml.Element(tag, dict(attributes or {}))
    for one in inside:
        if isinstance(one, str):
            made.text = one
        else:
            made.append(one)
    return made


def document(root: Any) -> str:
    """Return the text of a file."""
    Xml.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{Xml.tostring(root, encoding="unicode")}\n'
