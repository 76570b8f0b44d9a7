"""What only tells how work goes on, and never ends it: errors of progress and pictures, and a stderr that is lost."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

LOG = logging.getLogger("narx_sym")


@contextmanager
def fenced(what: str) -> Iterator[None]:
    """Keep an error in what only tells from ending what it tells of; the logger "narx_sym" hears of it at DEBUG."""
    try:
        yield
    except Exception:
        LOG.debug("%s failed; the computation continues", what, exc_info=True)


class Stderr:
    """Standard error; what it cannot take (a full disk, a closed pipe, a sign it does not know) is lost."""

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)

    def write(self, text: str) -> int:
        """Write what can be written."""
        with suppress(OSError, ValueError, AttributeError):  # of a closed file, of signs, of none at all
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        """Hand it on."""
        with suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()
