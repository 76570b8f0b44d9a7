"""An FMU as a black base: how far it is from measurements, and what is missing at its input or output.

An FMU is no recursion. Its run along a record becomes a channel f, and what it was driven by a channel w. The base is

    y[k] = f[k] + o + sum a_i (y[k-i] - f[k-i] - o) + sum b_j (u[k-j] - w[k-j]),

with a and b of a linear model of the FMU, identified from its own run. As u = w, nothing but f and o is left of it once
the start is forgotten, whatever a and b are. What an effect makes of u, or a force inside, goes through the linear
model, to first order; what is named at the input is then judged by another run of the FMU itself, along what the
effects let through. Where no linear model follows the FMU, only f and o are left: only its output is diagnosed.

**Running an FMU runs its native code**, with all rights of this process: only files that are named are run.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import sympy as sp

from ..data.evidence.roles import IGNORE
from ..data.record import Record
from ..diagnosis.procedure import Diagnosis
from ..errors import ModelError, NarxError
from ..fit.evaluate import evaluate, free_run_nrmse
from ..fit.freerun import FreeRun
from ..fit.identify import identify
from ..fit.simulate import fitted, segments
from ..models.model import Model
from ..symbolic.signals import k, lag, samples, signal, u, v

Array = np.ndarray
ENDING = ".fmu"
RUN, DRIVEN = signal("fmu"), signal("fmu_input")  # the FMU's output, and its input, as channels
FOLLOWS = 0.1  # NRMSE up to which a linear model stands for an FMU at its input
OFFSET = sp.Symbol("o", real=True)


@dataclass(frozen=True)
class BlackBox:
    """An FMU for co-simulation with one input and one output; see `from_fmu`."""

    path: Path
    u: str
    y: str

    def run(self, given: Array, Ts: float) -> Array:
        """Run the FMU's native code along an input (N,), which is held between samples; return its output (N,).

        Raises
        ------
        ModelError
            Where the FMU fails, or its output is not finite.
        """
        from fmpy import simulate_fmu

        times = Ts * np.arange(given.size)
        table = np.array(list(zip(times, given, strict=True)), dtype=[("time", float), (self.u, float)])
        try:
            found = simulate_fmu(
                str(self.path), start_time=0.0, stop_time=times[-1], output_interval=Ts, fmi_type="CoSimulation",
                input=table, output=[self.y],
            )[self.y]  # fmt: skip
        except Exception as error:
            raise ModelError(f"{self.path}: the FMU does not run along the record: {error}") from None
        if found.size != given.size or not np.all(np.isfinite(found)):
            raise ModelError(f"{self.path}: the output of the FMU is not finite, or it stops before the record ends.")
        return np.asarray(found, dtype=float)

    def beside(self, record: Record) -> Record:
        """Return a record with the FMU's run, and what drives it, as channels; after a gap the FMU starts anew."""
        edges = [0, *record.breaks, len(record)]
        run = np.concatenate([self.run(record.u[a:b], record.Ts) for a, b in pairwise(edges)])
        channels = {RUN.name: run, DRIVEN.name: record.u}
        return replace(
            record,
            channels={**record.channels, **channels},
            roles={**record.roles, **dict.fromkeys(channels, IGNORE)},
            units={**record.units, RUN.name: record.units.get("y", ""), DRIVEN.name: record.units.get("u", "")},
        )

    def model(self, records: Sequence[Record] = ()) -> Model:
        """Return the FMU as a model of records from `beside`, to be compared; with records also to be diagnosed."""
        if not records:
            return Model(RUN[k], (), Ts=None)
        own = [replace(r, y=r.channels[RUN.name], channels={}, roles={}, units={}) for r in records]
        F = RUN[k] + OFFSET
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a model that does not follow: it is not taken
            try:
                linear = identify(own, base="linear")
            except NarxError:  # nothing to identify, as where the FMU rests
                linear = None
        if linear and max(free_run_nrmse(linear, r) for r in own) <= FOLLOWS:
            right = linear.F.xreplace(linear.values)
            for s in samples(right):
                there = s.xreplace({s.base: DRIVEN}) if s.base == u else RUN[k - lag(s)] + OFFSET
                F += float(sp.diff(right, s)) * (s - there)
        return Model(F, (OFFSET,), [0.0], Ts=records[0].Ts)

    def again(self, found: Diagnosis, records: Sequence[Record]) -> float | None:
        """Return the NRMSE of the FMU itself, run along what the effects at the input let through; None without any.

        Effects elsewhere are left out. The offset is that of the diagnosis; start states are those of `evaluate`.
        """
        if all(e.where != "input" for e in found.model.effects):
            return None
        base = found.steps[0].base.model.replace(theta=[float(found.model.values[OFFSET])])
        parts = []
        for part in segments(list(records)):
            problem = FreeRun(found.model, part, None, loads=False)
            through = problem.states(problem.start(fitted(found.model)), 0)[v.name]
            parts.append(self.beside(replace(part, u=through)))
        return max(evaluate(base, part).free_run_nrmse for part in parts)


def from_fmu(path: str | Path, u: str = "", y: str = "") -> BlackBox:
    """Take an FMU for co-simulation (FMI 2.0 or 3.0) as a base that is only seen at its input and output.

    **An FMU holds native code, which runs with all your rights**: name only files that you trust. Nothing of it runs
    here; `beside` runs it along a record. It needs `pip install "narx-sym[fmu]"`.

    Parameters
    ----------
    path : str or Path
        The FMU. All inputs but one keep their start values.
    u, y : str, optional
        Names of its input and its output; they can be left out where it has one of each.

    Returns
    -------
    BlackBox
        `box.beside(record)` gives the record with the FMU's run, `box.model()` what `evaluate` and `compare` take,
        `box.model(records)` the base that `diagnose` takes, and `box.again(found, records)` the error of the FMU itself
        behind the effects that were named at its input.

    Raises
    ------
    ModelError
        Where fmpy is missing, the file is no such FMU, or the variables are not told.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import narx_sym as ns
    >>> path = pathlib.Path(tempfile.mkdtemp(), "plant.fmu")
    >>> _ = path.write_bytes(ns.from_equations("y[k] = 0.5*y[k-1] + b*u[k-1]" + chr(10) + "b ~ 2", 0.1).export("fmu"))
    >>> plant = ns.from_fmu(path)
    >>> plant.u, plant.y
    ('u', 'y')
    """
    try:
        from fmpy import read_model_description
    except ImportError:
        raise ModelError('fmpy is not installed: pip install "narx-sym[fmu]"') from None
    try:
        described = read_model_description(str(path))
    except Exception as error:
        raise ModelError(f"{path}: this cannot be read as an FMU: {error}") from None
    if described.coSimulation is None:
        raise ModelError(f"{path}: this FMU is not for co-simulation.")

    def one(causality: str, asked: str) -> str:
        there = [n.name for n in described.modelVariables if n.causality == causality]
        if asked not in there and len(there) != 1:
            raise ModelError(f"{path}: which {causality} is meant? It has {', '.join(there) or 'none'}.")
        return asked if asked in there else there[0]

    return BlackBox(Path(path), one("input", u), one("output", y))
