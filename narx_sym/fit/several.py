"""Machines with several outputs: identified output by output, run and judged as one."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ..data.evidence.roles import OUTPUT
from ..data.record import Record
from ..data.units import in_units, listed
from ..engines.compile import compile
from ..errors import DataError, FitError, ModelError
from ..inversion.several import SystemLaw
from ..models.model import Model
from ..models.system import System
from .bases.choice import PRICE
from .evaluate import Errors, along, estimated, measure
from .freerun import FreeRun
from .identify import HELD_OUT, identify
from .simulate import Records, fitted, predict, segments

Array = np.ndarray
COUPLED = 2  # lags of the other outputs that a part may read


def outputs_of(record: Record) -> list[str]:
    """Return the names of the outputs of a record: its channels with that role, of which one is `record.y`.

    Raises
    ------
    DataError
        Where there are none, or none of them is `record.y`.
    """
    names = [n for n in record.channels if record.roles.get(n) == OUTPUT]
    if not any(np.array_equal(record.channels[n], record.y) for n in names):
        raise DataError(
            f"record {record.name!r}: which channels are outputs? Read them as y=['y1', 'y2'], or give each, the first "
            "one too, as a channel with the role 'output'."
        )
    return names


def part_of(record: Record, output: str) -> Record:
    """Return a record as the model of one output sees it: that is `y`, and the other outputs are channels."""
    if output not in outputs_of(record):
        raise DataError(f"record {record.name!r}: {output!r} is no output; there are {', '.join(outputs_of(record))}.")
    channels = {n: x for n, x in record.channels.items() if n != output}
    units = {n: label for n, label in record.units.items() if n not in ("y", output)}
    units |= {"y": record.units[output]} if output in record.units else {}
    roles = {n: role for n, role in record.roles.items() if n != output}
    return replace(record, y=record.channels[output], channels=channels, units=units, roles=roles)


def identify_outputs(records: Records, base: str = "linear", **options: Any) -> System:
    """Identify a model with several outputs: one model for each output, from all inputs.

    An output is used as an input of another output's model if the free run of the whole system is then better.

    Parameters
    ----------
    records : Record or list of Record
        With several outputs: `ns.read(..., u=["u1", "u2"], y=["y1", "y2"])`, or channels with the roles "input" and
        "output".
    base : str
        As in `identify`, for every output.
    options
        Further arguments of `identify`, for every output.

    Returns
    -------
    System

    Raises
    ------
    DataError
        If a record does not say which channels are outputs.
    FitError
        As in `identify`.

    Examples
    --------
    >>> import narx_sym as ns
    >>> u = ns.plants.filtered_noise(N=500, Ts=0.1, cutoff=1.0, peak=1.0, seed=1)
    >>> first = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.8, 0.5]).simulate(u, y0=0.0, u0=0.0)
    >>> second = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.9, 0.2]).simulate(first, y0=0.0, u0=0.0)
    >>> both, roles = {"y1": first, "y2": second}, {"y1": "output", "y2": "output"}
    >>> record = ns.Record.from_arrays(u, first, Ts=0.1, channels=both, roles=roles)
    >>> ns.identify_outputs(record).outputs
    ('y1', 'y2')
    """
    every = listed(records)
    names = outputs_of(every[0])
    choices: list[list[Model]] = []
    for name in names:
        parts = [part_of(r, name) for r in every]
        others = {n: range(1, COUPLED + 1) for n in names if n != name}
        choices.append([])
        for lags in ({}, others)[: 1 + bool(others)]:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of channels that take no part
                try:
                    choices[-1].append(
                        identify(parts, base=base, **{**options, "lags": {**lags, **options.get("lags", {})}})
                    )
                except FitError as error:
                    problem = error
        if not choices[-1]:
            raise problem
    held = [r.split(1 - HELD_OUT)[1] for r in every]
    systems = [System(dict(zip(names, some, strict=True))) for some in product(*choices)]

    def cost(system: System) -> float:
        errors = (measure(target, run)[0] for target, run in _whole_runs(system, held).values())
        return sum(2 * np.log(max(e, 1e-12)) for e in errors) + PRICE * len(system.symbols)

    return min(systems, key=cost) if len(systems) > 1 else systems[0]


def simulate_system(
    system: System, inputs: Mapping[str, Any], y0: Mapping[str, Any] | None = None, engine: str = "native"
) -> dict[str, Array]:
    """Simulate all outputs of a system (free run) from given first outputs.

    Parameters
    ----------
    inputs : mapping from the names of the inputs to (N,) arrays
    y0 : mapping from the names of outputs (and states) to a number or (depth,) array; 0 by default

    Returns
    -------
    dict from the names of the outputs to (N,) arrays

    Raises
    ------
    ModelError
        For a missing input, and a system without values.
    Diverged
        Where a run leaves the finite numbers.
    """
    if system.numbers is None:
        raise ModelError("The system has no parameter values: fit it or give theta.")
    begin: dict[str, Any] = dict.fromkeys((base.name for base in system.recursion.states), 0.0)
    if stray := [n for n in y0 or {} if str(n) not in begin]:
        raise ModelError(f"There is no output {str(stray[0])!r} to start; there are {', '.join(begin)}.")
    begin |= {str(n): v for n, v in (y0 or {}).items()}
    run = compile(system.recursion, engine)(inputs, list(system.numbers), begin)
    return {name: run[name] for name in system.outputs}


def free_run_system(system: System, record: Record) -> dict[str, Array]:
    """Simulate a system along a record, from start states that are estimated for each output.

    Gaps start anew; the first samples, as many as the largest lag, are the measured ones. A record in other
    units is converted to those of the system.

    Returns
    -------
    dict from the names of the outputs to (N,) arrays
    """
    pieces: dict[str, list[Array]] = {name: [] for name in system.outputs}
    for part in in_own_units(system, record).segments():
        begin: dict[str, Array] = {}
        depth = max(1, system.recursion.depth)
        for name, model in system.parts.items():
            fitted(model)
            own = part_of(part, name)
            problem = FreeRun(model, own, None)
            z, _ = estimated(problem, problem.start(model.theta))
            called = {base.name: new.name for base, new in system.names(name).items() if base not in model.symbols}
            run = problem.states(z, 0)
            begin |= {called[n]: np.asarray(x[:depth]) for n, x in run.items()}
        given = {n: x for n, x in part.signals.items() if n in system.inputs}
        runs = compile(system.recursion)(given, list(system.numbers or ()), begin, on_divergence="nan", start=depth)
        for name in system.outputs:
            runs[name][: system.recursion.depth] = part.channels[name][: system.recursion.depth]
            pieces[name].append(runs[name])
    return {name: np.concatenate(found) for name, found in pieces.items()}


def evaluate_system(system: System, records: Records) -> dict[str, Errors]:
    """Compute the errors of a system on measurements for each output: one step ahead, and in free run of all outputs.

    Returns
    -------
    dict from the names of the outputs to Errors
    """
    every, found = [in_own_units(system, r) for r in listed(records)], {}
    for name, (target, run) in _whole_runs(system, every).items():
        model, own = system.parts[name], segments([part_of(r, name) for r in every])
        ahead = measure(target, along(model, own, predict))
        free = measure(target, run)
        rms = float(np.sqrt(np.mean((target - run) ** 2))) if np.isfinite(run).all() else np.inf
        found[name] = Errors(ahead[0], free[0], ahead[1], free[1], rms)
    return found


def _whole_runs(system: System, every: Sequence[Record]) -> dict[str, tuple[Array, Array]]:
    """Return each measured output, and its free run beside those of the others, along all records."""
    runs = [free_run_system(system, r) for r in every]
    measured = {name: np.concatenate([r.channels[name] for r in every]) for name in system.outputs}
    return {name: (x, np.concatenate([one[name] for one in runs])) for name, x in measured.items()}


def in_own_units(system: System, record: Record) -> Record:
    """Return a record in the units of a system; its `y` is one of the outputs."""
    units = system.units
    first = next((n for n in outputs_of(record) if np.array_equal(record.channels[n], record.y)), "")
    if first in record.units:
        record = replace(record, units={**record.units, "y": record.units[first]})
    return in_units([record], units | ({"y": units[first]} if first in units else {}))[0]


def run_law(
    law: SystemLaw, references: Mapping[str, Any], start: Mapping[str, float] | None = None
) -> dict[str, Array]:
    """Return the inputs that make the outputs follow their references.

    Parameters
    ----------
    references : mapping from the names of outputs, and of what else is measured, to (N,) arrays
    start : mapping from the names of inputs to where they rest before; 0 by default

    Returns
    -------
    dict from the names of the inputs to (N,) arrays
    """
    system = law.system
    if missing := [name for name in system.outputs if name not in references]:
        raise ModelError(f"The reference of {missing[0]!r} is missing.")
    given = {f"r_{n}" if n in system.outputs else n: np.asarray(x, dtype=float) for n, x in references.items()}
    begin = {left.base.name: float((start or {}).get(left.base.name[2:], 0.0)) for left, _ in law.updates}
    run = compile(law.recursion)(given, list(system.numbers or ()), begin)
    return {name[2:]: run[name] for name in begin}
