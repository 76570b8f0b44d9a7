"""The command `narx-sym app`."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from ..errors import NarxError

MEGABYTE = 1_000_000


def app(
    data: Annotated[Path | None, typer.Argument(metavar="[DATA]", help="A data file to begin with.")] = None,
    validate: Annotated[
        Path | None, typer.Option("--validate", help="A validation record: no model is fitted to it.")
    ] = None,
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, help="Port on 127.0.0.1; 0 chooses a free one.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open a browser.")] = False,
    most: Annotated[int, typer.Option("--max-mb", min=1, max=2000, help="Largest upload in MB.")] = 50,
) -> None:
    """Open a page in the browser: see where a model fails, add the missing effect, and compare the errors."""
    if find_spec("nicegui") is None:
        raise NarxError('The page needs further packages: pip install "narx-sym[app]"')
    from .server import Sessions, serve
    from .workbench import Workbench

    def begun() -> Workbench:
        made = Workbench(most * MEGABYTE, validate)
        if data is not None:
            made.open(data)
        return made

    sessions = Sessions(begun)
    try:
        _, first = sessions.new()
        if first.error:
            raise NarxError(first.error)
        serve(sessions, port, not no_browser)
    finally:
        sessions.close()
