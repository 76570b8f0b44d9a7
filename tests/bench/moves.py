"""What is each move of the search worth? Every row is marked with the move that made it, and the table is read without it.

    python tests/bench/moves.py [--groups in,off,null,pair,measured] [--seeds 8200:8201] --out FILE.jsonl

One diagnosis of each case serves for all moves: the table that was filled is read again without the rows of one move. It
is the first reading of each step, before models are held at the records' own rate. What a move takes is its own CPU
time, without that of the moves it asks for. Cases that the file has already are not run again.
"""

from __future__ import annotations

import json
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import truths
from common import asked, diagnosed, record_of, seeds_of
from sensitivity import RECORDS, records_of

from narx_sym.diagnosis import steps
from narx_sym.diagnosis.steps import won
from narx_sym.diagnosis.table.rounds import Table
from narx_sym.diagnosis.table.search import Search

MOVES = {
    steps: ("jointly", "closer", "exchanged", "instead", "prune"),
    Table: ("singles", "pairs", "_instead", "complete", "screened", "checked"),
    Search: ("bases",),
}
GROUPS = ("in", "off", "null", "pair", "measured")
Row = dict[str, Any]


class Watch:
    """Which move is under way, what each took, which rows it made, and the tables that were read."""

    def begin(self) -> None:
        """Forget the case before."""
        self.under_way, self.cpu, self.at = ["rest"], Counter[str](), time.process_time()
        self.made: dict[int, tuple[Any, str]] = {}  # rows are kept: an id is theirs alone
        self.tables: list[tuple[Any, list[Any]]] = []

    def lap(self) -> None:
        """Book the time since the last lap to what is under way."""
        now = time.process_time()
        self.cpu[self.under_way[-1]] += now - self.at
        self.at = now

    def move(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that is a move."""

        def run(*args: Any, **kwargs: Any) -> Any:
            self.lap()
            self.under_way.append(name)
            try:
                return function(*args, **kwargs)
            finally:
                self.lap()
                self.under_way.pop()

        return run

    def rows(self) -> list[Any]:
        """Return a list that marks what comes into it."""
        watch = self

        class Marked(list[Any]):
            def append(self, row: Any) -> None:
                watch.made.setdefault(id(row), (row, watch.under_way[-1]))
                super().append(row)

            def extend(self, rows: Any) -> None:
                for row in rows:
                    self.append(row)

            def __iadd__(self, rows: Any) -> Any:
                self.extend(rows)
                return self

        return Marked()


def patch(watch: Watch) -> None:
    """Watch every search of this process."""
    for owner, names in MOVES.items():
        for name in names:
            setattr(owner, name, watch.move(name.strip("_"), getattr(owner, name)))
    begin, filled = Search.__init__, steps._filled

    def made(search: Any, *args: Any, **kwargs: Any) -> None:
        begin(search, *args, **kwargs)
        search.rows = watch.rows()

    def read(table: Any, known: Any) -> Any:
        found = filled(table, known)
        watch.tables.append((known, list(table.rows)))
        return found

    Search.__init__, steps._filled = made, read  # type: ignore[method-assign]


def names(rows: list[Any], known: Any) -> list[str]:
    """Return what a table names."""
    at, best = won([r for r in rows if set(known.ids) <= set(r.ids)], known)
    return [] if best is None else [v.id for v in best.beyond(at)]


def cases(groups: list[str], seeds: range) -> Iterator[tuple[str, str, Any, list[list[str]]]]:
    """Give group, name, record and what is right."""
    for group in groups:
        if group == "measured":
            for name, record in records_of("").items():
                yield group, name, record, [sorted(RECORDS[name][2])]
            continue
        for spec in truths.battery(group, seeds):
            one = truths.case(**spec)
            yield group, one.name, record_of(one), [sorted(ids) for ids in one.accept]


def right(told: list[str], accept: list[list[str]]) -> bool:
    """Whether every hidden effect is told, and nothing else."""
    return all(set(told) & set(a) for a in accept) and all(any(t in a for a in accept) for t in told)


def judged(watch: Watch, group: str, name: str, record: Any, accept: list[list[str]]) -> Row:
    """Diagnose one case, and read its tables without each move."""
    watch.begin()
    found = diagnosed(record, max_effects=3 if group == "pair" else 1)
    watch.lap()
    read = []
    for known, rows in watch.tables:
        moves = {move for _, move in watch.made.values()} - {"bases", "rest", "singles"}
        less = {m: names([r for r in rows if watch.made.get(id(r), (r, ""))[1] != m], known) for m in sorted(moves)}
        read.append({"all": names(rows, known), "without": less})
    return {"group": group, "name": name, "accept": accept, "verdict": found.verdict, "cpu": watch.cpu, "read": read}


def table(rows: list[Row]) -> Iterator[str]:
    """Give the table of the book: of each move its share of the time, and how often it makes a first reading right."""
    took = sum((Counter(r["cpu"]) for r in rows), Counter())
    yield "| move | CPU | made it right | made it wrong | another name |"
    yield "|---|---|---|---|---|"
    for move, seconds in took.most_common():
        other = [
            (right(r["read"][0]["all"], r["accept"]), right(r["read"][0]["without"][move], r["accept"]))
            for r in rows
            if r["read"] and r["read"][0]["without"].get(move, r["read"][0]["all"]) != r["read"][0]["all"]
        ]
        counts = Counter(other)
        same = counts[True, True] + counts[False, False]
        yield f"| {move} | {seconds / took.total():.1%} | {counts[True, False]} | {counts[False, True]} | {same} |"


def main() -> None:
    """Run what the file lacks, and print the table."""
    args = asked(__doc__, groups=",".join(GROUPS), seeds="8200:8201", out=Path)
    watch = Watch()
    patch(watch)
    rows = [json.loads(line) for line in args.out.read_text().splitlines()] if args.out.exists() else []
    had = {(r["group"], r["name"]) for r in rows}
    for group, name, *case in cases(args.groups.split(","), seeds_of(args.seeds)):
        if (group, name) not in had:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                rows.append(judged(watch, group, name, *case))
            with args.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print(f"{len(rows)} cases\n", *table(rows), sep="\n")


if __name__ == "__main__":
    main()
