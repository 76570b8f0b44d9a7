"""The part of a workbench that makes and runs a compensation law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..tasks.compensate import Law
from .browser.preview import Ran
from .choice import Said, Wanted, dropped, kept_text, limits_of
from .jobs import derived, followed


class Compensation:
    """The law of a workbench's last model, and a run of it; see `Workbench`."""

    law: Law | None
    run: Ran | None
    wanted: Wanted

    @property
    def of_law(self: Any) -> tuple[Any, ...]:
        """What there is to take away beside a model."""
        return self.law, self.run

    def open_law(self: Any, **wanted: Any) -> None:
        """Begin to derive the compensation law; `wanted` changes the fields of the same names.

        Limits of the input and of its change per sample go into the source.
        """
        with Said(self) as said:
            now, model = replace(self.wanted, **wanted), self._last.model
            self.wanted = now
            self._begin(self._show_law, derived, model, *limits_of(said, now.low, now.high, now.rate))

    def _show_law(self: Any, law: Law) -> None:
        self.law = law
        self._update(law=law)

    def upload_reference(self: Any, name: str, content: bytes) -> None:
        """Take a file with a reference."""
        with Said(self):
            path, shown = kept_text(self.folder, name, content, self.limit)
            dropped(self.folder, self.wanted.path)
            self.wanted = replace(self.wanted, kind="file", file=shown, path=path)

    def run_law(self: Any, **wanted: Any) -> None:
        """Begin to run the law over a reference; `wanted` changes the fields of the same names."""
        with Said(self) as said:
            now, model, record = replace(self.wanted, **wanted), self._last.model, self._measured
            self.wanted, limits = now, limits_of(said, now.low, now.high, now.rate)
            make = now.made(said, record, record.units.get("y", ""))
            self._begin(self._show_run, followed, model, make, *limits, record.units)

    def _show_run(self: Any, run: Ran) -> None:
        self.run = run
        self._update(run=run)
