"""What the page shows, without a page: data, columns, base, diagnosis, steps, compensator, downloads."""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..data.examples import PLAY, STAGE_UNITS, stage
from ..data.readers import load as load_table
from ..data.record import Record, read
from ..data.tables import Table
from ..data.units import said_first
from ..errors import DataError, ModelError, NarxError
from ..files.atomic import write_csv
from ..models.extend import find
from ..models.model import Model
from ..symbolic.signals import plain_name
from ..tasks.base import check_kind, read_base, what_to_know
from ..tasks.compensate import Law
from ..tasks.revise import Revision, begin, with_effect
from .browser.preview import Ran, signals_svg
from .choice import (
    Choice,
    Said,
    Wanted,
    check_size,
    dropped,
    guessed,
    in_the_page,
    kept,
    kept_data,
    limits_of,
    measured,
    shortened,
    suits,
)  # fmt: skip
from .downloads import offered
from .jobs import followed, revision
from .story import Shown
from .worker import Worker

LIMIT = 50_000_000  # bytes of an upload
BUSY = "A computation is running: wait for it, or cancel it."
MOST = 30  # states that are kept: each has the pictures of its diagnosis


@dataclass(frozen=True, eq=False)
class State:
    """What the page shows after a step.

    Attributes
    ----------
    revisions : the models so far, with their diagnoses; the last one is shown
    base, base_name : the base that was chosen
    law, run : of the last model, where they were asked for
    notes : what was said of it
    """

    revisions: tuple[Shown, ...] = ()
    base: str | Model = "linear"
    base_name: str = ""
    law: Law | None = None
    run: Ran | None = None
    notes: tuple[str, ...] = ()


class Workbench:
    """Every state that the page shows, and what may be done in it. Nothing here knows of a browser.

    Long work goes to a process: `poll` takes over what it made, `cancel` ends it. Whatever fails
    leaves one sentence in `error`, and everything else as it was.

    Attributes
    ----------
    file, table : name and columns of the data file, or None
    validation : a file with the same columns that models are judged by, or None
    choice : Choice
    record : Record or None
        What was read with this choice.
    base : str or Model
        "static", "linear", "narx", or a model from a file, called `base_name`.
    states, at : list of State, int
        Every state since the data were chosen, for undo and redo, and which of them is shown.
    early : str
        The page on the base, while effects are searched.
    wanted : Wanted
        What a law shall follow, and within which limits.
    faults : mapping from fields to messages
        What is wrong, each at the field that was refused, else at "".
    notes : what was changed in silence
    shown : lock
        Held while what the page shows changes: a page that holds it sees all of a change or nothing.
    """

    def __init__(self, limit: int = LIMIT, validation: Path | None = None) -> None:
        self.limit, self.validation = limit, validation
        self.worker = Worker()
        self.folder = Path(tempfile.mkdtemp(prefix="narx_sym_app_"))  # mode 0700
        self.faults: dict[str, str] = {}
        self.shown = threading.RLock()
        self._reading = threading.Lock()  # data are read in threads, one after the other
        self.notes: tuple[str, ...] = ()
        self.base: str | Model = "linear"
        self.base_name = ""
        self._done: Callable[[Any], None] = lambda made: None
        self._forget()

    def _forget(self) -> None:
        self.file = ""
        self.path: Path | None = None
        self.table: Table | None = None
        self.choice = Choice()
        self.record: Record | None = None
        self.preview = ""
        self.states: list[State] = []
        self.at, self.early = -1, ""
        self.wanted = Wanted()
        self.faults = {}

    @property
    def state(self) -> State:
        """The state that is shown."""
        return self.states[self.at] if self.states else State()

    @property
    def current(self) -> Shown | None:
        """The model that is shown."""
        return self.state.revisions[-1] if self.state.revisions else None

    @property
    def error(self) -> str:
        """The last message, at whatever field it stands."""
        return next(reversed(self.faults.values()), "")

    # -- data --------------------------------------------------------------------------------------------------

    def upload(self, name: str, content: bytes) -> None:
        """Take a data file; its name is only shown, never used as a path."""
        with self._reading, Said(self) as said:
            self._open(said, *kept_data(self.folder, name, content, self.limit))

    def open(self, path: Path) -> None:
        """Take a data file that the user of this machine named."""
        with self._reading, Said(self) as said:
            self._open(said, path, shortened(path.name))

    def _open(self, said: Said, path: Path, shown: str, units: Mapping[str, str] | None = None) -> None:
        try:
            table = load_table(path)
        except NarxError as error:
            dropped(self.folder, path)
            raise DataError(str(error).replace(str(path), shown)) from None
        table.path = shown
        choice = guessed([n for n in table.columns if n])
        choice.units |= units or {}
        made, refused = None, None
        try:
            if choice.t:  # all is clear: no click is needed
                made = self._read(said, path, shown, table, choice)
        except NarxError as error:
            refused = error
        with self.shown:
            self.cancel()
            dropped(self.folder, self.path)
            dropped(self.folder, self.wanted.path)
            self._forget()
            self.file, self.path, self.table, self.choice = shown, path, table, choice
            if made is not None:
                self._take(*made)
        if refused is not None:
            raise refused

    def choose(self, **changed: Any) -> None:
        """Change the choice of columns, rows and units, and read the record."""
        with self._reading, Said(self) as said:
            for name, value in changed.items():
                setattr(self.choice, name, value)
            if self.path is None or self.table is None:
                raise DataError("Drop a data file first.")
            try:
                made = self._read(said, self.path, self.file, self.table, self.choice)
            except NarxError:
                self._take(None)
                raise
            self._take(*made)

    def _read(self, said: Said, path: Path, shown: str, table: Table, choice: Choice) -> tuple[Record, str]:
        record = measured(said, path, shown, table, choice)
        return record, signals_svg(record, said_first(record.units, choice.units))

    def _take(self, record: Record | None, preview: str = "") -> None:
        """Take over what was read; all that was made of other data goes."""
        with self.shown:
            self.cancel()
            self.states, self.at = [], -1
            self.record, self.preview = record, preview
            if record is not None:
                self.wanted = Wanted.of(record, self.wanted)
            self.notes = tuple(what_to_know([record])) if record is not None else ()

    def example(self) -> None:
        """Take simulated measurements of a stage behind a gear with play."""
        with self._reading, Said(self) as said:
            record = stage(PLAY)
            path = kept(self.folder, "simulated_stage.csv", ".csv", b"")
            write_csv(path, {"t": record.t, "u": record.u, "y": record.y})
            self._open(said, path, path.name, STAGE_UNITS)

    # -- base --------------------------------------------------------------------------------------------------

    def choose_base(self, base: str) -> None:
        """Choose a kind of base."""
        with Said(self):
            self.base, self.base_name = check_kind(base), ""

    def upload_model(self, name: str, content: bytes) -> None:
        """Take a model file as the base."""
        shown = shortened(name)
        with Said(self):
            check_size(self.limit, len(content), shown)
            path = kept(self.folder, shown, ".json", content)
            try:
                self.base, self.base_name = read_base(path, shown), shown
            finally:
                dropped(self.folder, path)

    # -- steps -------------------------------------------------------------------------------------------------

    def diagnose(self) -> None:
        """Begin to identify the base and to diagnose it; what was added before goes when that is done."""
        with Said(self) as said:
            base, name = self.base, self.base_name
            if isinstance(base, Model):
                suits(said, base, self._measured)
            self._revise((), base, name, begin, base)

    def add(self, effect: str) -> None:
        """Begin to add an effect to the model, or two that only together explain the error."""
        with Said(self) as said:
            with said.field("effect"):
                for one in effect.split(" + "):  # of two that are found together
                    find(one)
            said.stop()
            of = self.state
            self._revise(of.revisions, of.base, of.base_name, with_effect, self._last.bare(), effect)

    def _revise(
        self, before: tuple[Shown, ...], base: str | Model, name: str, make: Callable[..., Revision], *what: Any
    ) -> None:
        record, bare = self._measured, tuple(r.bare() for r in before)
        work = partial(revision, validation=self._judging(), machine=self.choice.machine)
        self._begin(
            lambda made: self._put(State((*before, made), base, name, notes=made.notes)), work, make, what, bare,
            (record,), record.units,
        )  # fmt: skip

    def _judging(self) -> list[Record]:
        """Read the validation record, with the same columns."""
        c = self.choice
        if self.validation is None:
            return []
        Ts = float(c.Ts) if c.Ts.strip() else None
        kept: dict[str, Any] = {"channels": c.channels, "missing": c.missing}
        kept["units"] = {n: v for n, v in c.units.items() if v}
        return [read(self.validation, u=c.u, y=c.y, t=c.t or None, Ts=Ts, **kept)]

    @property
    def _last(self) -> Shown:
        if self.current is None:
            raise ModelError("Diagnose a base first.")
        return self.current

    @property
    def _measured(self) -> Record:
        if self.record is None:
            raise DataError("Choose the data first.")
        return replace(self.record, units=said_first(self.record.units, self.choice.units))

    def _put(self, state: State) -> None:
        """Take a new state; what was undone before is forgotten, and the first where there are too many."""
        self.states = [*self.states[: self.at + 1], state][-MOST:]
        self.at, self.notes, self.faults = len(self.states) - 1, state.notes, {}  # their fields are made anew

    def undo(self) -> None:
        """Go back to the state before; nothing is computed anew."""
        self.go(self.at - 1)

    def redo(self) -> None:
        """Go again to the state that was left by `undo`."""
        self.go(self.at + 1)

    def go(self, index: int) -> None:
        """Show a state of the history as it was."""
        with Said(self):
            if not 0 <= index < len(self.states):
                raise ModelError(f"There is nothing to {'undo' if index < 0 else 'redo'}.")
            if self.worker.busy:
                raise NarxError(BUSY)
            self.at, state = index, self.states[index]
            self.base, self.base_name = state.base, state.base_name
            self.notes, self.faults = state.notes, {}

    # -- the law -----------------------------------------------------------------------------------------------

    def upload_reference(self, name: str, content: bytes) -> None:
        """Take a file with a reference."""
        with Said(self):
            path, shown = kept_data(self.folder, name, content, self.limit)
            dropped(self.folder, self.wanted.path)
            self.wanted = replace(self.wanted, kind="file", file=shown, path=path)

    def run_law(self, **wanted: Any) -> None:
        """Begin to derive the compensation law and to run it; `wanted` changes the fields of the same names.

        Limits of the input and of its change per sample go into the source of the law too.
        """
        with Said(self) as said:
            self.wanted = now = replace(self.wanted, **wanted)
            model, record = self._last.model, self._measured
            limits = limits_of(said, now.low, now.high, now.rate)
            make = now.made(said, record, record.units.get("y", ""))
            self._begin(lambda made: self._show_run(*made), followed, model, make, *limits, record.units)

    def _show_run(self, law: Law, run: Ran | None) -> None:
        self.states[self.at] = replace(self.state, law=law, run=run)

    @property
    def known(self) -> dict[str, str]:
        """The units of input and output, in words where they are not known."""
        return {name: self._measured.units.get(name) or f"unit of {name}" for name in "uy"}

    # -- the process -------------------------------------------------------------------------------------------

    def _begin(self, take: Callable[[Any], None], work: Callable[..., Any], *arguments: Any) -> None:
        if self.worker.busy:
            raise NarxError(BUSY)
        self._done = take
        self.worker.start(work, *arguments)

    @property
    def busy(self) -> bool:
        """Whether something is under way."""
        return self.worker.busy

    def poll(self) -> None:
        """Take over what the process has done since the last look."""
        outcome = self.worker.poll()
        if outcome is None:
            return
        if outcome.early:
            self.early = outcome.result.decode()
            return
        self.early = ""
        self.understood()
        if outcome.error:
            self.faults = {**self.faults, "": in_the_page(outcome.error)}
        else:
            self._done(outcome.result)
            self.notes = (*self.notes, *outcome.notes)

    def cancel(self) -> None:
        """End what is under way; everything stays as it was before."""
        if self.worker.busy:
            self.early = ""
            self.worker.stop()
            self.worker.warm()  # for what comes next

    def enough(self) -> None:
        """Let a search end with what was found by now."""
        self.worker.enough()

    def close(self) -> None:
        """End the process and remove what was uploaded."""
        self.worker.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def refuse(self, message: str) -> None:
        """Say what the page refused before it came here."""
        with Said(self):
            raise DataError(message)

    def understood(self) -> None:
        """Take the message of no field away."""
        self.faults = {name: text for name, text in self.faults.items() if name}

    def download(self, kind: str) -> tuple[str, str | bytes]:
        """Return name and content of a file; see `downloads.offered`."""
        made = offered(self, self._last.model)
        if kind not in made:
            raise ModelError(f"There is no {kind[:40]!r}; there are {', '.join(made)}.")
        return f"{plain_name(Path(self.file).stem)}_{kind}", made[kind][1]()
