"""Ctrl-C is not lost: what swallows it, or turns it into another error, is asked again until the command ends."""

from __future__ import annotations

import signal
from typing import Any

AGAIN = 1.0  # s until it is asked again; long enough to remove a half-written file
TIMED = hasattr(signal, "setitimer")  # not on Windows

pressed = False


def arm() -> None:
    """Let Ctrl-C raise KeyboardInterrupt, and again each second until `disarm`.

    Python delivers it once. Module code under `except Exception`, callbacks of C libraries and `__del__` drop it there.
    """
    global pressed
    pressed = False
    signal.signal(signal.SIGINT, _interrupt)
    if TIMED:
        signal.signal(signal.SIGALRM, _interrupt)


def disarm() -> None:
    """Ask no more, and leave Ctrl-C to whom it belongs."""
    _ask_in(0.0)
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupt(number: int, frame: Any) -> None:
    global pressed
    pressed = True
    _ask_in(AGAIN)
    raise KeyboardInterrupt


def _ask_in(seconds: float) -> None:
    """Ask again then; never for 0."""
    if TIMED:
        signal.setitimer(signal.ITIMER_REAL, seconds)
