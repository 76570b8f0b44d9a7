"""Long work in a process of its own, so that it can be stopped by ending the process."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..errors import NarxError

PATIENCE = 2.0  # seconds until a process that does not end is killed


@dataclass(frozen=True)
class Outcome:
    """What came of a piece of work: a result with notes, or one message why there is none."""

    result: Any = None
    error: str = ""
    notes: tuple[str, ...] = ()
    early: bool = False  # the work goes on


ENOUGH = (None, ())  # what is sent in the place of work, to end a search


class Worker:
    """One piece of work at a time, a function of a module with arguments that can be pickled.

    The function takes `progress` as its last argument: it is called with a text, or with an early result, and returns
    whether what was found is enough. The process stays for the next piece of work; `stop` ends it.
    """

    def __init__(self) -> None:
        self.progress = ""
        self.since = 0.0
        self.busy = False
        self._process: Any = None
        self._pipe: Any = None

    def warm(self) -> None:
        """Start the process, where there is none."""
        if self._process is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")  # a fork would copy the threads' locks
            self._pipe, other = context.Pipe()
            self._process = context.Process(target=_serve, args=(other,), daemon=True)
            with _deaf():
                self._process.start()
            other.close()

    def start(self, work: Callable[..., Any], *arguments: Any) -> None:
        """Begin a piece of work; one that is under way is stopped first."""
        if self.busy:
            self.stop()
        self.warm()
        self.progress, self.since, self.busy = "starting", time.monotonic(), True
        # A process that is still starting takes nothing yet: who waits for it is a thread, not the page.
        threading.Thread(target=_hand_over, args=(self._pipe, work, arguments), daemon=True).start()

    def poll(self) -> Outcome | None:
        """Take what the process has said: None while it works."""
        if not self.busy:
            return None
        try:
            while self._pipe.poll():
                kind, what = self._pipe.recv()
                if kind == "outcome":
                    self.busy = what.early
                    return what
                self.progress = what
        except (EOFError, OSError):
            self.stop()
            return Outcome(error="The process that did the work ended (out of memory?). Nothing was changed.")
        return None

    def enough(self) -> None:
        """Let the work end its search with what was found by now."""
        if self.busy:
            _hand_over(self._pipe, *ENOUGH)

    @property
    def seconds(self) -> float:
        """How long the work has taken so far [s]."""
        return time.monotonic() - self.since if self.busy else 0.0

    def stop(self) -> None:
        """End the process, whatever it does."""
        process, self._process, self.busy = self._process, None, False
        if process is None:
            return
        process.terminate()
        process.join(PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()
        self._pipe.close()


@contextmanager
def _deaf() -> Iterator[None]:
    """Let a process that is started here ignore Ctrl-C from its first moment; whoever started it ends it."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


def _hand_over(pipe: Any, work: Callable[..., Any] | None, arguments: Sequence[Any]) -> None:
    with suppress(OSError):  # the process was stopped meanwhile
        pipe.send((work, arguments))


def _told(pipe: Any, what: Any) -> bool:
    """Hand on a text or an early result; return whether what was found is enough."""
    pipe.send(("progress", what) if isinstance(what, str) else ("outcome", Outcome(what, early=True)))
    return bool(pipe.poll() and pipe.recv() == ENOUGH)


def _serve(pipe: Any) -> None:
    """Do one piece of work after the other."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from ..diagnosis import procedure as diagnosis  # noqa: F401 - loaded while the user still looks for a file

    while True:
        try:
            work, arguments = pipe.recv()
        except (EOFError, OSError):
            return
        if work is None:  # the search had ended already
            continue
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                outcome = Outcome(work(*arguments, progress=partial(_told, pipe)))
            except NarxError as error:
                outcome = Outcome(error=str(error))
            except Exception as error:  # one message in the page, whatever happens
                outcome = Outcome(error=f"Internal error, {type(error).__name__}: {error}. Please report it.")
        notes = tuple(dict.fromkeys(str(w.message) for w in said if w.category is UserWarning))
        pipe.send(("outcome", Outcome(outcome.result, outcome.error, notes)))
