"""The honest battery: is the hidden effect named, and is nothing named where nothing is hidden?

    python tests/bench/battery.py [--seeds 1000:1015] [--null-seeds 1000:1015] [--groups in,off,null,removed,pair]
        [--kinds a,b] [--jobs 2] [--out battery.json] [--baselines] [--markdown FILE] [--list]

Every case of `truths.py` goes the way of a user: `identify(record, base="linear")`, then `diagnose`. Groups:

- in, off: one hidden effect, of a form that the catalogue has, or not.
- null: nothing is hidden. Every verdict but `nothing_detectable` is a false alarm.
- pair: two hidden effects, `max_effects=3`. Both are found where each was added and kept.
- removed: cases of `in` with the true effect taken out of the catalogue (its first two seeds, or `--removed-seeds`).
  `outside_library` and `helps_but_incomplete` are right, `named` and `confused` are wrong.

*Visible*: the held-out error of the refitted base exceeds the noise by at least half the noise, in squares. Shares of
in, off, removed and pair are of visible cases. A case that raises an exception counts as visible and wrong there. The
error after adding is that of the first step's model; the oracle is told the effect and fits it the same way.

`--out` gets one JSON line per case as it is done. What is in it already is not run again: delete it to start anew.
`--golden tests/bench/golden.jsonl --seeds 8302:8303 --null-seeds 8302:8303` lists the cases that are told otherwise than
in that file. `--baselines` ranks the effects of in and off with other toolkits too (see `baselines.py`), from the same fitted base.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

import common
import numpy as np
import truths
from common import ROOT, asked, publish, seeds_of

import narx_sym as ns
from narx_sym.diagnosis.progress import BASE, ROUND, Course
from narx_sym.diagnosis.settings import TEMPERATURE
from narx_sym.diagnosis.steps import Step
from narx_sym.diagnosis.table.rounds import Table as Hypotheses
from narx_sym.diagnosis.table.verdict import cheapest, weighed
from narx_sym.errors import FitError
from narx_sym.models.effects import EFFECTS, Catalogue

HERE = Path(__file__).resolve().parent
GROUPS = ("in", "off", "null", "removed", "pair")
MOST = 3  # effects added to a pair
REMOVED = 2  # seeds of the group `removed`
SHOWN = 8  # candidates kept per case
Row = dict[str, Any]


# ---- one case -------------------------------------------------------------------------------------------------------


def lacking(ids: Iterable[str]) -> Catalogue:
    """Return the catalogue without some effects; that of one channel goes with those of all channels."""
    return EFFECTS.without(*(name.partition(":")[0] for name in ids))


def oracle(step: Step, model: ns.Model, record: ns.Record, right: frozenset[str], seed: int = 0) -> float | None:
    """Return the held-out rms error where the true effect is told, but not its parameters [unit of y]."""
    fits = []
    for one in step.candidates:
        if one.effect in right:
            with suppress(FitError):
                fits.append(one.fitted)
    if not fits:
        only = Catalogue({n: EFFECTS[n] for n in sorted({name.partition(":")[0] for name in right})})
        channels = sorted({name.partition(":")[2] for name in right} - {""})
        table = Hypotheses(model, [record], channels, only, seed, Course(lambda what: None, [BASE, *ROUND]))
        table.singles(table.base)
        fits = [table.own(row) for row in cheapest(table.rows) if row.count and table.holds(row)][:1]
    return float(np.sqrt(min(f.mean_square(step.base.split.held) for f in fits))) if fits else None


def judge(task: str, spec: Row, compare: bool) -> Row:
    """Run one case and say what came out; errors are rms on held-out samples [unit of y]."""
    case = truths.case(**spec)
    record = common.record_of(case)
    right = frozenset().union(*case.accept)
    begin = perf_counter()
    model = ns.identify(record, base="linear")
    between = perf_counter()
    options: Row = {"catalogue": lacking(right)} if task == "removed" else {}
    found = ns.diagnose(model, record, max_effects=MOST if task == "pair" else 1, **options)
    seconds = [between - begin, perf_counter() - between]
    step = found.steps[0]
    held = step.base.split.held
    mask = np.concatenate(held)  # the pieces of an axis that integrates make up the record
    floor2 = float(np.mean((case.y - case.clean)[mask] ** 2))
    before2 = step.base.mean_square(held)
    kept = {one.effect for one in found.model.effects}
    last = found.last or step.base
    row: Row = {
        "name": case.name, "noise": case.noise, "excitation": case.excitation,
        "accept": [sorted(ids) for ids in case.accept], "left": case.info["left"],
        "visible": bool(before2 - floor2 >= 0.5 * floor2),
        "verdict": step.verdict, "p_value": step.p_value,
        "top": [f"{c.effect}@{c.where}" for c in step.candidates[:SHOWN]],
        "share": [c.share for c in step.candidates[:SHOWN]],
        "set": step.confusion_set,
        "rivals": [list(rival) for rival in step.pair.rivals] if step.pair else [],
        "steps": [
            [
                s.verdict, s.candidates[0].effect if s.candidates else None,
                [name for name in s.added if name in kept],
            ]
            for s in found.steps
        ],
        "floor": floor2**0.5, "estimated_floor": step.floor, "before": before2**0.5,
        "after": float(np.sqrt((step.chosen or step.base).mean_square(held))),
        "last": float(np.sqrt(last.mean_square(held))),
        "prices": [[list(r.ids), r.price, int(r.blocks.size)] for r in cheapest(found.hypotheses)[:SHOWN] if r.blocks.size],
        "repeated": ns.evaluate(found.model, record).free_run_nrmse == found.ladder[-1]["train"],
        "refused": step.refused is not None,
        "seconds": [round(s, 3) for s in seconds],
    }  # fmt: skip
    if task in ("in", "off") and row["visible"]:
        row["oracle"] = oracle(step, model, record, right)
        if compare:
            import baselines

            named = baselines.ranked(baselines.pool_of(step.base, record))
            row["baselines"] = {method: ids[:SHOWN] for method, ids in named.items()}
    return row


def run(task: str, spec: Row, compare: bool) -> Row:
    """Judge one case; an exception becomes its result."""
    # Taken where and when the package was loaded: a worker may start late, after files were edited.
    code = os.environ.setdefault("NARX_SYM_BATTERY_CODE", fingerprint())
    row: Row = {"task": task, "spec": spec, "code": code, "compared": compare}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return row | judge(task, spec, compare)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            last = traceback.format_exc().strip().splitlines()[-8:]
            return row | {"failed": text, "trace": last, "noise": spec["noise"], "visible": True}


# ---- all cases ------------------------------------------------------------------------------------------------------


def tasks(
    groups: Iterable[str], seeds: range, null: range, removed: range, kinds: set[str]
) -> Iterator[tuple[str, Row]]:
    """Name every case that is asked for, in a fixed order."""
    for task in groups:
        chosen = {"null": null, "removed": removed}.get(task, seeds)
        for spec in truths.battery("in" if task == "removed" else task, chosen):
            if not kinds or spec["kind"] in kinds:
                yield task, spec


def key(task: str, spec: Row) -> str:
    """Return what tells two cases apart."""
    return json.dumps([task, spec], sort_keys=True)


def done(path: Path) -> dict[str, Row]:
    """Return the cases of an earlier run; a line that was cut off is dropped."""
    found = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[key(row["task"], row["spec"])] = row
    return found


def fingerprint() -> str:
    """Return a checksum of the package and the truths: results of other code are not of this version."""
    files = sorted([*(ROOT / "narx_sym").rglob("*.py"), HERE / "truths.py", HERE / "battery.py"])
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:12]


def run_all(wanted: Sequence[tuple[str, Row]], path: Path, compare: bool, jobs: int) -> list[Row]:
    """Run the cases that are not in the file yet, each written as soon as it is done; return all in order."""
    from joblib import Parallel, delayed
    from rich.console import Console
    from rich.progress import track

    code, rows = fingerprint(), done(path)

    def there(task: str, spec: Row) -> bool:
        row = rows.get(key(task, spec))
        # Only these tasks are compared with other methods.
        return row is not None and (not compare or row["compared"] or task not in ("in", "off"))

    todo = [(task, spec) for task, spec in wanted if not there(task, spec)]
    console = Console(file=sys.stderr)
    if len(todo) < len(wanted):
        console.print(f"{len(wanted) - len(todo)} of {len(wanted)} cases are in {path} already")
    results = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(run)(task, spec, compare) for task, spec in todo
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    cut_off = path.exists() and not path.read_text().endswith("\n") and path.stat().st_size > 0
    with path.open("a") as file:
        file.write("\n" if cut_off else "")
        for row in track(results, "Judging", total=len(todo), console=console) if todo else ():
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows[key(row["task"], row["spec"])] = row
    listed = [rows[key(task, spec)] for task, spec in wanted]
    other = sum(row["code"] != code for row in listed)
    if other:
        console.print(f"Warning: {other} of {len(listed)} results in {path} are from another version of the code.")
    return listed


# ---- figures --------------------------------------------------------------------------------------------------------


def wilson(hits: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    if not n:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return float((middle - half) / (1 + z * z / n)), float((middle + half) / (1 + z * z / n))


def ids(row: Row, n: int) -> set[str]:
    """Return the ids of the first n candidates."""
    return {name.partition("@")[0] for name in row.get("top", [])[:n]}


def truth(row: Row) -> set[str]:
    """Return all ids that are right."""
    return set().union(*row.get("accept", []))


def both(row: Row) -> bool:
    """Whether every hidden effect of a case is the top candidate of a step that was added."""
    added = {name for _, _, names in row.get("steps", []) for name in names}
    return bool(row.get("accept")) and all(added & set(accept) for accept in row["accept"])


def both_or_rivals(row: Row) -> bool:
    """Whether every hidden effect is found, or is one of two that are told to explain as much as those."""
    rivals = [set(rival) for rival in row.get("rivals", [])]
    return both(row) or any(all(rival & set(accept) for accept in row["accept"]) for rival in rivals)


class Table:
    """Figures by group, with their intervals and targets."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, ...]] = []

    def add(self, group: str, what: str, value: str, interval: str = "", target: str = "") -> None:
        self.rows.append((group, what, value, interval, target))

    def share(self, group: str, what: str, hits: Sequence[bool], least: float = 0.0, most: float = 1.0) -> None:
        """Add a share of cases, and whether it meets its target."""
        k, n = sum(map(bool, hits)), len(hits)
        if not n:
            self.add(group, what, "no case")
            return
        low, high = wilson(k, n)
        target = f">= {100 * least:.0f} %" if least else f"<= {100 * most:.0f} %" if most < 1 else ""
        met = ("met" if least <= k / n <= most else "missed") if target else ""
        interval = f"{100 * low:.0f} ... {100 * high:.0f} %"
        self.add(group, what, f"{100 * k / n:.1f} % ({k}/{n})", interval, f"{target} {met}")

    def number(
        self, group: str, what: str, values: Sequence[float | None], of: Any = np.median, most: float = 0.0
    ) -> None:
        """Add a median or a mean."""
        kept = [v for v in values if v is not None and np.isfinite(v)]
        value = float(of(kept)) if kept else float("nan")
        target = f"<= {most:g} {'met' if value <= most else 'missed'}" if most else ""
        self.add(group, what, f"{value:.3g}" if kept else "no case", "", target)

    def seconds(self, group: str, rows: Sequence[Row]) -> None:
        """Add the time per case."""
        timed = np.array([r["seconds"] for r in rows if "seconds" in r]).reshape(-1, 2)
        if len(timed):
            a, b = np.median(timed, axis=0)
            self.add(group, "seconds per case: identify, diagnose (median)", f"{a:.1f}, {b:.1f}")

    def counts(self, group: str, what: str, names: Iterable[str]) -> None:
        """Add how often each name occurs."""
        self.add(group, what, ", ".join(f"{name} {n}" for name, n in sorted(Counter(names).items())))

    def text(self) -> str:
        """Return the table as Markdown."""
        lines = ["| Group | Figure | Result | 95 % interval | Target |", "|---|---|---|---|---|"]
        last = ""
        for group, *rest in self.rows:
            lines.append(f"| {group if group != last else ''} | " + " | ".join(map(str.strip, rest)) + " |")
            last = group
        return "\n".join(lines) + "\n"


def single(table: Table, group: str, rows: Sequence[Row], top1: float, top3: float) -> None:
    """Figures of one hidden effect."""
    seen = [r for r in rows if r["visible"]]
    ours = [(bool(ids(r, 1) & truth(r)), bool(ids(r, 3) & truth(r))) for r in seen]
    table.share(group, "top-1", [first for first, _ in ours], least=top1)
    table.share(group, "top-3", [three for _, three in ours], least=top3)
    sets = [r for r in seen if r.get("set")]
    table.share(group, "confusion set holds the truth", [bool(set(r["set"]) & truth(r)) for r in sets], least=0.95)
    table.number(group, "size of the confusion set (mean)", [len(r["set"]) for r in sets], np.mean, most=1.6)
    wrong = [r.get("verdict") == "named" and not ids(r, 1) & truth(r) for r in seen]
    table.share(group, "confident and wrong", wrong, most=0.03)
    good = [r for r in seen if "failed" not in r]
    compared = [r["after"] / r["oracle"] for r in good if r.get("oracle")]
    table.number(group, "error after adding / oracle's (median)", compared, most=1.05)
    table.number(group, "error after adding / true floor (median)", [r["after"] / r["floor"] for r in good])
    table.number(group, "error of the base / true floor (median)", [r["before"] / r["floor"] for r in good])
    table.counts(group, "verdicts", [r["verdict"] for r in good])
    for method in dict.fromkeys(m for r in good for m in r.get("baselines", ())):
        compared = [(r["baselines"][method], truth(r)) for r in good if method in r.get("baselines", ())]
        for n in (1, 3):
            table.share(group, f"{method}: top-{n}", [bool(set(named[:n]) & right) for named, right in compared])


def figures(rows: Sequence[Row]) -> Table:
    """Return the figures of all groups."""
    table = Table()
    for group in GROUPS:
        own = [r for r in rows if r["task"] == group]
        if not own:
            continue
        seen = [r for r in own if r["visible"]]
        failed = [r for r in own if "failed" in r]
        table.add(group, "cases", f"{len(own)}, {len(seen)} visible" if group != "null" else str(len(own)))
        if failed:
            table.add(group, "exceptions", str(len(failed)))
        if group == "in":
            single(table, group, own, 0.92, 0.98)
        elif group == "off":
            single(table, group, own, 0.85, 0.95)
        elif group == "null":
            good = [r for r in own if "failed" not in r]
            for noise in truths.NOISES:
                alarms = [r["verdict"] != "nothing_detectable" for r in good if r["noise"] == noise]
                table.share(group, f"false alarms, {noise}", alarms, most=0.05 if noise == "white" else 0.10)
            table.share(group, "false alarms, all colours", [r["verdict"] != "nothing_detectable" for r in good])
            table.share(group, "confident and wrong", [r["verdict"] == "named" for r in good])
        elif group == "removed":
            verdicts = [r.get("verdict", "exception") for r in seen]
            wrong = [v in ("named", "confused", "exception") for v in verdicts]
            table.share(group, "named or confused (or an exception)", wrong)
            right = [v in ("outside_library", "helps_but_incomplete") for v in verdicts]
            table.share(group, "outside_library or helps_but_incomplete", right)
            table.share(group, "nothing_detectable", [v == "nothing_detectable" for v in verdicts])
            table.counts(group, "verdicts", verdicts)
        else:
            table.share(group, "both found", [both(r) for r in seen])
            table.share(group, "both found, or told to explain as much", [both_or_rivals(r) for r in seen])
            table.share(group, "top-1 of the first step", [bool(ids(r, 1) & truth(r)) for r in seen])
            good = [r for r in seen if "failed" not in r]
            false = [any(name not in truth(r) for _, _, names in r["steps"] for name in names) for r in good]
            table.share(group, "something else added", false)
            table.number(group, "error after adding / true floor (median)", [r["last"] / r["floor"] for r in good])
        table.share(
            group, "the number shown is that of evaluate, to the digit", [r.get("repeated", False) for r in own]
        )
        table.share(group, "not added: validation data did not confirm it", [r["refused"] for r in own])
        table.seconds(group, own)
    return table


def believed(row: Row, temperature: float) -> list[tuple[float, bool]]:
    """Return the probability of each explanation by one effect or none, and whether it is right, the likeliest first."""
    listed = [(names, price, blocks) for names, price, blocks in row.get("prices", []) if len(names) < 2]
    found = weighed([price for _, price, _ in listed], [blocks for *_, blocks in listed], temperature)
    rights = [not names if row["task"] == "null" else set(names) <= truth(row) and bool(names) for names, *_ in listed]
    return sorted(zip(found.tolist(), rights, strict=True), reverse=True)


def reliability(rows: Sequence[Row]) -> str:
    """Return how often what is said with some probability is right (DeGroot & Fienberg 1983), as Markdown.

    Below it, the temperature that would suit half of the seeds best, and what it does on the other half.
    """
    judged = [r for r in rows if r["task"] == "null" or (r["task"] in ("in", "off") and r["visible"])]
    judged = [r for r in judged if believed(r, TEMPERATURE)]
    if not judged:
        return ""
    lines = ["| said | cases | said on average | right |", "|---|---|---|---|"]
    first = [believed(r, TEMPERATURE)[0] for r in judged]
    error = 0.0
    for low, high in pairwise((0.0, 0.5, 0.7, 0.9, 0.99, 1.0)):
        inside = [(p, ok) for p, ok in first if low < p <= high]
        if inside:
            said, hits = np.mean(inside, axis=0)
            error += len(inside) / len(first) * abs(said - hits)
            lines.append(f"| {low:g} ... {high:g} | {len(inside)} | {said:.2f} | {hits:.2f} |")
    lines.append(
        f"\nExpected calibration error {error:.3f}; more than 0.8 and wrong: {sum(p > 0.8 and not ok for p, ok in first)}."
    )

    def surprise(half: Sequence[Row], temperature: float) -> float:
        kept = (sum(p for p, ok in believed(r, temperature) if ok) for r in half)
        return float(np.mean([-np.log(max(p, 1e-6)) for p in kept]))

    for kept in (0, 1):
        halves = [[r for r in judged if r["spec"]["seed"] % 2 == side] for side in (kept, 1 - kept)]
        if all(halves):
            best = min(np.geomspace(0.25, 4, 33), key=lambda t: surprise(halves[0], t))
            there, here = surprise(halves[1], best), surprise(halves[1], TEMPERATURE)
            lines.append(
                f"Temperature {best:.2f} suits {'even' if kept == 0 else 'odd'} seeds; log loss on the others {there:.3f} ({here:.3f} at {TEMPERATURE:g})."
            )
    return "\n".join(lines) + "\n"


def right(row: Row) -> bool:
    """Whether a case came out as it should."""
    if "failed" in row:
        return False
    if row["task"] == "null":
        return bool(row["verdict"] == "nothing_detectable")
    if row["task"] == "removed":
        return row["verdict"] not in ("named", "confused")
    return both(row) if row["task"] == "pair" else bool(ids(row, 1) & truth(row))


def summary(row: Row) -> tuple[str, list[Any]]:
    """Return the name of a case and what was said of it: verdict, first effect with its place, and the set."""
    return row["name"], [row["verdict"], *row["top"][:1], *sorted(row["set"])]


def line(row: Row) -> str:
    """Return one case in one line."""
    if "failed" in row:
        return f"{row['task']:8}{row['spec']['kind']}/s{row['spec']['seed']}: {row['failed']}"
    mark = "   " if right(row) else "XX " if row["visible"] else "x  "
    ratios = f"{row['before'] / row['floor']:6.2f} ->{row['last'] / row['floor']:5.2f} floors"
    steps = " + ".join(f"{' & '.join(added) or effect or '-'} ({verdict})" for verdict, effect, added in row["steps"])
    return f"{mark}{row['task']:8}{row['name']:52}{ratios}  {steps}; {', '.join(row['top'][:4])}"


# ---- command --------------------------------------------------------------------------------------------------------


def main() -> None:
    judged = f"{truths.JUDGE.start}:{truths.JUDGE.stop}"
    options = asked(
        __doc__, seeds=judged, null_seeds=judged, removed_seeds="", groups=",".join(GROUPS), kinds="", jobs=2,
        out=Path("battery.json"), baselines=False, markdown=Path, list=False, golden=Path,
    )  # fmt: skip
    groups = options.groups.split(",")
    unknown = [g for g in groups if g not in GROUPS]
    if unknown:
        raise SystemExit(f"there is no group {unknown[0]!r}; there are {', '.join(GROUPS)}")
    seeds = seeds_of(options.seeds)
    removed = seeds_of(options.removed_seeds) if options.removed_seeds else seeds[:REMOVED]
    kinds = set(filter(None, options.kinds.split(",")))
    wanted = list(tasks(groups, seeds, seeds_of(options.null_seeds), removed, kinds))
    if not wanted:
        raise SystemExit("no case of these groups has these kinds and seeds")
    warnings.simplefilter("ignore")  # of joblib, when it restarts a worker that has grown
    rows = run_all(wanted, options.out, options.baselines, options.jobs)
    publish(figures(rows).text() + "\n" + reliability(rows), options.markdown)
    for row in rows:
        if "failed" in row or (options.list and not right(row)):
            print(line(row))
    if options.golden is not None:
        known = [json.loads(text) for text in options.golden.read_text(encoding="utf-8").splitlines()]
        now = {name: said for name, said in map(summary, rows)}
        differ = [(name, said, now[name]) for name, said in known if name in now and now[name] != said]
        print(f"{len(differ)} of {len(known)} cases are told otherwise than in {options.golden}")
        for name, *said in differ:
            print(f"  {name}: " + " -> ".join(map(str, said)))


if __name__ == "__main__":
    main()
