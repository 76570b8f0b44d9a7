"""Official benchmarks of nonlinearbenchmark.org: the linear base, what `diagnose` adds to it by itself, and published figures.

    python tests/bench/benchmarks.py [--only emps tanks] [--effects 1 3] [--out FILE.md]

Fitted on the official estimation data only, with default settings throughout; nothing was chosen by the test data. What is
added is judged by the model that `narx-sym diagnose` saves, which is the base where nothing better was found. The figure is
the RMSE of the free run on the official test data after the benchmark's own initialisation window, in which measured
outputs may be used: there each model predicts one step ahead, so that what its effects remember is known at the end of the
window. A test that is one period of a steady state is run twice, and the second period counts.

Silverbox, coupled drives and Wiener-Hammerstein are loaded by `nonlinear_benchmarks` where its cache holds them; nothing
is downloaded. About ten minutes for the three sets beside this project.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from common import asked, publish
from places import SHARED

import narx_sym as ns
from narx_sym.diagnosis.procedure import Diagnosis
from narx_sym.engines.compile import compile
from narx_sym.errors import Diverged, NarxError
from narx_sym.fit.simulate import arrays, fitted, initial_values

Array = np.ndarray
CACHE = Path.home() / ".nonlinear_benchmarks"  # where the loader keeps what it has downloaded
EFFECTS = (1, 3)  # the default, and several


@dataclass(frozen=True)
class Test:
    """Official test data.

    Attributes
    ----------
    window : int
        How many first samples may be used to find the state; they do not count.
    steady : bool
        Whether it is one period of a steady state.
    """

    name: str
    record: ns.Record
    window: int = 0
    steady: bool = False


Loaded = tuple[list[ns.Record], list[Test]]
Loader = Callable[[], Loaded | None]


@dataclass(frozen=True)
class Benchmark:
    """Estimation data, tests, and what is known.

    Attributes
    ----------
    load : function without arguments that returns the records to fit and the tests, None where they are not at hand
    unit, scale
        Of the figures; how many of them are one unit of y.
    missing : what its source says that a linear model lacks
    published : method with source, and its figure on each test, "" where none is known; best first
    tests : names of the tests, in the order of the loader
    own : equations that a user who knows the machine would write, without what is missing; "" for none
    added : an effect and its place, which such a user would add to them
    """

    title: str
    load: Loader
    unit: str
    scale: float
    missing: str
    published: Sequence[tuple[str, ...]]
    tests: Sequence[str]
    own: str = ""
    added: tuple[str, str] = ("", "")


# -- data ----------------------------------------------------------------------------------------------------------------


def here(folder: str, train: str, *tests: tuple[str, str, int, bool]) -> Loader:
    """Load files beside the project: (name, file, window, steady) of each test."""

    def load() -> Loaded | None:
        place = SHARED / folder
        if not place.is_dir():
            return None
        return [ns.read(place / train)], [Test(name, ns.read(place / f), n, steady) for name, f, n, steady in tests]

    return load


def cached(name: str, folder: str) -> Loader:
    """Load with `nonlinear_benchmarks` what its cache holds."""

    def load() -> Loaded | None:
        if not any((CACHE / folder).glob("*.*")):
            return None
        try:
            import nonlinear_benchmarks
        except ImportError:
            return None
        train, tests = getattr(nonlinear_benchmarks, name)(always_return_tuples_of_datasets=True)

        def record(data) -> ns.Record:
            return ns.Record.from_arrays(data.u, data.y, float(data.sampling_time), name=str(data.name))

        return [record(d) for d in train], [
            Test(str(d.name), record(d), int(d.state_initialization_window_length or 0)) for d in tests
        ]

    return load


CHAMPNEYS = "Champneys et al. 2024"
BENCHMARKS = {
    "boucwen": Benchmark(
        "Bouc-Wen",
        here(
            "boucwen", "train_multisine.csv",
            ("multisine", "test_multisine.csv", 0, True), ("sine sweep", "test_sinesweep.csv", 0, False),
        ),
        "1e-5 m", 1e5, "a Bouc-Wen hysteresis",
        [
            ("polynomial state space, quoted by Forgione and Piga 2021", "1.87", ""),
            ("dynoNet, Forgione and Piga 2021", "4.52", ""),
            ("nonlinear FIR, quoted by Forgione and Piga 2021", "16.3", ""),
        ],
        ("multisine", "sine sweep"),
        # The input is not held: a mass and a spring that are driven by straight lines between its samples.
        "y[k] = a1*y[k-1] + a2*y[k-2] + b0*u[k] + b1*u[k-1] + b2*u[k-2]\n"
        "a1 ~ 1.8\na2 ~ -0.9\nb0 ~ 0\nb1 ~ 1e-6\nb2 ~ 0",
        ("hysteresis", "inside"),
    ),
    "emps": Benchmark(
        "Positioning system EMPS", here("emps", "train.csv", ("test with pulses", "test_pulses.csv", 20, False)),
        "mm", 1e3, "Coulomb friction and an offset, on an integrating axis in closed loop",
        [
            ("dynoNet, Forgione and Piga 2021, as noted with the data", "2.6"),
            (f"polynomial NARX, {CHAMPNEYS}", "5.17"),
            (f"linear state space, {CHAMPNEYS}", "5.53"),
            (f"linear ARX, {CHAMPNEYS}", "12.6"),
        ],
        ("test with pulses",),
        "x'' = (35.15*u - d*x' + o)/m\ny = x\nm ~ 90 in 10 ... 500\nd ~ 200 in 1 ... 2000\no ~ 0",
        ("coulomb_friction", "force"),
    ),
    "tanks": Benchmark(
        "Cascaded tanks", here("cascaded_tanks", "train.csv", ("test", "test.csv", 50, False)), "V", 1.0,
        "outflows by the root of the level, an upper tank that flows over",
        [
            (f"grey box with overflow, Worden et al. 2018, quoted by {CHAMPNEYS}", "0.191"),
            (f"GRU, {CHAMPNEYS}", "0.396"),
            (f"polynomial NARX, {CHAMPNEYS}", "0.413"),
            (f"linear state space, {CHAMPNEYS}", "0.588"),
            (f"linear ARX, {CHAMPNEYS}", "0.685"),
        ],
        ("test",),
        "q = b*sign(h1)*sqrt(Abs(h1))\nh1' = a*u - q\nh2' = q - e*sign(h2)*sqrt(Abs(h2))\ny = h2\nh1(0) = y\n"
        "a ~ 0.05 in 0.01 ... 0.5\nb ~ 0.05 in 0.01 ... 0.5\ne ~ 0.05 in 0.01 ... 0.5",
        ("end_stop", "motion"),
    ),
    "silverbox": Benchmark(
        "Silverbox", cached("Silverbox", "Silverbox"), "mV", 1e3, "a cubic spring",
        [(f"Gaussian-process NARX, {CHAMPNEYS}", "0.301", "0.60", "0.259"), (f"linear ARX, {CHAMPNEYS}", "6.95", "14.2", "6.59")],
        ("multisine", "arrow", "arrow, no extrapolation"),
    ),
    "drives": Benchmark(
        "Coupled drives", cached("CED", "CED"), "ticks/s", 1.0, "a sensor without sign",
        [
            (f"continuous-time SUBNET, Beintema et al. 2023, quoted by {CHAMPNEYS}", "0.115", "0.074"),
            (f"linear ARX, {CHAMPNEYS}", "0.291", "0.331"),
        ],
        ("low amplitude", "high amplitude"),
    ),
    "wiener_hammerstein": Benchmark(
        "Wiener-Hammerstein", cached("WienerHammerBenchMark", "WienerHammerBenchMark"), "mV", 1e3,
        "a saturation between two filters",
        [
            (f"SUBNET, Beintema et al. 2021, quoted by {CHAMPNEYS}", "0.241"),
            (f"linear ARX, {CHAMPNEYS}", "43.4"),
        ],
        ("test",),
    ),
}  # fmt: skip


# -- runs ----------------------------------------------------------------------------------------------------------------


def error(model: ns.Model, test: Test) -> float:
    """Return the RMSE of the free run after the window [unit of y]; infinite where it diverges."""
    depth, record = max(1, model.recursion.depth), test.record
    if test.steady:
        record = ns.Record.from_arrays(np.tile(record.u, 2), np.tile(record.y, 2), record.Ts)
    window = len(test.record) if test.steady else test.window
    short = max(0, depth - (0 if test.steady else window))  # at rest before, where a model looks further back
    given = ns.Record.from_arrays(*(np.r_[np.full(short, x[0]), x] for x in (record.u, record.y)), record.Ts)
    start = depth if test.steady else short + window
    data, output = arrays(model, given), str(model.output.label)
    known = {n: x[:start] for n, x in data.items()}
    initial = initial_values(model, known, depth)
    if model.states and start > depth:
        initial |= compile(model.predictor)(known, fitted(model), initial)
    initial[output] = known[output]
    try:
        run = compile(model.recursion)(data, fitted(model), initial, start=start)[output][short:]
    except Diverged:
        return float("inf")
    return float(np.sqrt(np.mean((run - record.y)[window:] ** 2)))


@dataclass(frozen=True)
class Row:
    """What one model does: its name, number of parameters, seconds to find it, and the errors on all tests.

    `estimated`: those of `ns.evaluate`, from start states, and the load of an axis, estimated on the test record.
    """

    name: str
    parameters: int
    seconds: float
    errors: tuple[float, ...]
    estimated: tuple[float, ...] = ()


def rows(loaded: Loaded, benchmark: Benchmark, effects: Sequence[int]) -> Iterator[Row]:
    """Yield the base, and what is added where so many effects are allowed; the same from a user's own equations."""
    (records, tests), scale = loaded, benchmark.scale

    def row(name: str, model: ns.Model, begin: float) -> Row:
        seconds = perf_counter() - begin
        free = len(model.symbols) - len(model.constraints)
        judged = (scale * ns.evaluate(model, t.record).free_run_rms for t in tests)
        return Row(name, free, seconds, tuple(scale * error(model, t) for t in tests), tuple(judged))

    begin = perf_counter()
    base = ns.identify(records, base="linear")
    yield row("linear base", base, begin)
    for most in effects:
        begin = perf_counter()
        try:
            found = ns.diagnose(base, records, max_effects=most)
        except NarxError as refused:
            yield Row(f"up to {most}: refused ({refused})", 0, perf_counter() - begin, (float("nan"),) * len(tests))
            continue
        yield row(f"up to {most}: {verdict(found, found.model)}", found.model, begin)
    if not benchmark.own:
        return
    begin = perf_counter()
    own = ns.from_equations(benchmark.own, records[0].Ts).fit(records, method="free_run")
    yield row("own equations", own, begin)
    begin = perf_counter()
    found = ns.diagnose(own, records)
    yield row(f"own equations, {verdict(found, found.model)}", found.model, begin)
    begin = perf_counter()
    effect, place = benchmark.added
    yield row(f"own equations, {effect} added", own.add(effect, place).fit(records), begin)


def verdict(found: Diagnosis, model: ns.Model) -> str:
    """Say what was named, and what of it the saved model has."""
    named = [name for step in found.steps for name in step.added]
    kept = [one.effect for one in model.effects]
    if not named:
        return f"nothing named (`{found.verdict}`), fitted again"
    gone = [name for name in named if name not in kept]
    return f"named {' + '.join(named)}" + (f"; saved without {' + '.join(gone)}" if gone else "")


# -- page ----------------------------------------------------------------------------------------------------------------

HEAD = """# Official benchmarks

`python tests/bench/benchmarks.py`: the official splits of nonlinearbenchmark.org. The linear base (`identify(base="linear")`),
then what `diagnose` adds to it by itself where one effect is allowed (its default) or up to three. Fitted on the estimation
data only, default settings throughout, nothing chosen by the test data. What is added is judged by the model that
`narx-sym diagnose` saves. *Own equations* are those of a user who knows the machine, without what is missing from them.
Figures: RMSE of the free run on the test data after the benchmark's own initialisation window; *by `evaluate`*: over the whole
test record, from start states (of an axis that integrates, with its constant load) that are estimated on it.
*Parameters*: all that were fitted, beside the operating point. Seconds on two busy cores.

Published figures are as quoted, from Champneys, Beintema, Toth, Schoukens and Rogers, *Baseline results for selected
nonlinear system identification benchmarks*, 2024 (arXiv:2405.10779), read in a transcription of its tables, and Forgione and
Piga, *dynoNet*, 2021, as noted beside the data. Nothing of them was repeated here.
"""


def digits(value: float) -> str:
    """Return three digits."""
    return f"{value:#.3g}".rstrip(".")


def table(benchmark: Benchmark, found: Sequence[Row], tests: Sequence[str]) -> str:
    """Return one benchmark as a table, after one sentence that says what came out."""
    lines = [
        f"| model | parameters | seconds | {' | '.join(f'{t} [{benchmark.unit}]' for t in tests)} | by `evaluate` |",
        "|---|---|---|" + "---|" * (len(tests) + 1),
    ]
    for row in found:
        shown = " | ".join([*map(digits, row.errors), ", ".join(map(digits, row.estimated))])
        lines.append(f"| {row.name} | {row.parameters or ''} | {row.seconds:.0f} | {shown} |")
    if not found:
        lines.append("| data not at hand | | |" + " |" * (len(tests) + 1))
    lines += [f"| *{name}* | | | {' | '.join(figures)} | |" for name, *figures in benchmark.published]
    said = f"Missing, by its source: {benchmark.missing}."
    if found:
        first, last = found[0], next(r for r in reversed(found) if not r.name.startswith("own"))
        pairs = zip(tests, first.errors, last.errors, strict=True)
        change = ", ".join(f"{digits(a)} -> {digits(b)} {benchmark.unit} ({name})" for name, a, b in pairs)
        said += f" **{last.name.partition(': ')[2].capitalize()}: {change}, with {last.parameters} parameters.**"
    return "\n".join([f"## {benchmark.title}", "", said, "", *lines, ""])


def main() -> None:
    """Run the benchmarks and write the page."""
    options = asked(__doc__, only=list(BENCHMARKS), effects=EFFECTS, out=Path)
    warnings.simplefilter("ignore")
    tables = []
    for name in options.only:
        benchmark, found = BENCHMARKS[name], []
        loaded = benchmark.load()
        for row in rows(loaded, benchmark, options.effects) if loaded else []:
            found.append(row)
            print(name, row, file=sys.stderr, flush=True)
        tables.append(table(benchmark, found, benchmark.tests))
    publish("\n".join([HEAD, *tables]), options.out)


if __name__ == "__main__":
    main()
