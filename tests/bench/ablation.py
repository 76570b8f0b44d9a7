"""What is each part of the procedure worth? Real records, diagnosed with one part taken out at a time.

    python tests/bench/ablation.py [--only emps,tanks] [--parts "as it is,no pairs"] [--markdown FILE]

The records, and which names are right, are those of `sensitivity.py`. *Error*: held-out, of what is named.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from common import asked, diagnosed, publish
from sensitivity import RECORDS, read, records_of

from narx_sym.diagnosis.steps import won
from narx_sym.diagnosis.table import rounds, verdict
from narx_sym.diagnosis.table.frame import Frame
from narx_sym.diagnosis.table.rounds import Table
from narx_sym.diagnosis.table.search import Search


def _first(method: Callable[..., Any]) -> Callable[..., Any]:
    """Fit effects beside one core alone: the one that is cheapest without them."""
    return lambda self, bases, *rest: method(self, [min(bases, key=lambda r: r.price)], *rest)


def _measured(spanned: Callable[..., Any]) -> Callable[..., Any]:
    """Leave every start where it was measured."""

    def made(self: Frame, core: Any) -> Any:
        t0, T = spanned(self, core)
        return t0, T * (np.arange(T.shape[1]) < T.shape[1] - self.problem.shifts)

    return made


def _every(records: Any) -> Any:
    return [part for r in records for part in r.segments()], 1


PARTS: dict[str, list[Any]] = {
    "as it is": [],
    "orders chosen before the effect": [
        patch.object(Search, "look", _first(Search.look)),
        patch.object(Search, "one_more", _first(Search.one_more)),
    ],
    "no price: the smallest held-out error": [
        patch.object(verdict, "PER_PARAMETER", 0.0),
        patch.object(verdict, "PER_EFFECT", 0.0),
        patch.object(rounds, "PER_EFFECT", 0.0),
    ],
    "no pairs": [patch.object(Table, "pairs", lambda self, base: None)],
    "starts as measured": [patch.object(Frame, "_spanned", _measured(Frame._spanned))],
    "every sample, no working rate": [patch.object(rounds, "working", _every)],
}


@contextmanager
def without(part: str) -> Iterator[None]:
    """Take one part out."""
    with ExitStack() as stack:
        for change in PARTS[part]:
            stack.enter_context(change)
        yield


def outcome(record: Any, accept: set[str]) -> tuple[Any, float, float]:
    """Diagnose a record: what is read off its table, the held-out NRMSE of it, and CPU seconds."""
    begin = time.process_time()
    found = diagnosed(record)
    rows = [r for r in found.hypotheses if r.blocks.size]
    known, best = won(rows, min((r for r in rows if not r.ids), key=lambda r: (r.more, r.price)))
    return read(rows, accept), float(np.sqrt((best or known).held)), time.process_time() - begin


def main() -> None:
    options = asked(__doc__, only="", parts="", markdown=Path)
    warnings.simplefilter("ignore")
    chosen = [p for p in PARTS if not options.parts or p in options.parts.split(",")]
    records = records_of(options.only)
    lines = ["| without | " + " | ".join(records) + " | right | in the set | median error | CPU s |"]
    lines.append("|---" * (len(records) + 5) + "|")
    for part in chosen:
        with without(part):
            told = [outcome(record, RECORDS[name][2]) for name, record in records.items()]
        said = [r for r, _, _ in told]
        error, seconds = np.median([e for _, e, _ in told]), sum(s for _, _, s in told)
        cells = [f"{r.named}, {e:.3g}" for r, e, _ in told]
        counts = f"{sum(r.right for r in said)} | {sum(r.in_set for r in said)} | {error:.3g} | {seconds:.0f}"
        lines.append(f"| {part} | " + " | ".join(cells) + f" | {counts} |")
        print(lines[-1], flush=True)
    publish("\n".join(lines), options.markdown)


if __name__ == "__main__":
    main()
