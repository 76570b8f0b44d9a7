"""What a model carries beside its equations: how it was fitted, why it has these terms, what its records showed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import ModelError
from ..symbolic.signals import u, y


def around(point: Any) -> dict[Any, float]:
    """Return an operating point by sequence; without those that are zero.

    Parameters
    ----------
    point : mapping of u and y, or of their names, to numbers; None for zero
    """
    known = {base.name: base for base in (u, y)}
    if not isinstance(point or {}, Mapping):
        raise ModelError('The operating point must be a mapping, such as {"u": 1.0, "y": 2.0}.')
    found: dict[Any, float] = {}
    for given, value in (point or {}).items():
        name = str(getattr(given, "label", given))
        if name not in known:
            raise ModelError(f"The operating point says where u and y are measured from; {name!r} is neither.")
        try:
            found[known[name]] = float(value) if not isinstance(value, str) else math.nan
        except (TypeError, ValueError):
            raise ModelError(f"The operating point of {name} must be a number.") from None
        if not abs(found[known[name]]) < float("inf"):
            raise ModelError(f"The operating point of {name} is not a finite number.")
    return {base: value for base, value in found.items() if value}


def whole(**given: Any) -> None:
    """Refuse what is no whole number, by name; None is left to whoever asked."""
    for name, value in given.items():
        if value is not None and (isinstance(value, str) or not hasattr(value, "__int__") or int(value) != value):
            raise ModelError(f"{name} must be a whole number, not {value!r}.")


USELESS = 0.95  # NRMSE of a free run that is no better than a constant


@dataclass(frozen=True)
class Nrmse:
    """One-step and free-run error over the standard deviation of the output; infinite where a run diverges."""

    one_step: float
    free_run: float


@dataclass(frozen=True)
class Selection:
    """Why a model has the terms that it has.

    Attributes
    ----------
    base : "linear" or "static" where one of these was identified, else ""
    candidates : how many terms, or models, there were to choose from
    chosen : how many picks were taken from a pool
    err : error reduction ratio of each pick
    stable_law : whether its law forgets its own errors on the data; None where nobody asked
    """

    base: str = ""
    candidates: int = 0
    chosen: int = 0
    reason: str = ""
    err: tuple[float, ...] = ()
    stable_law: bool | None = None


@dataclass(frozen=True)
class Info:
    """How a model was fitted and what its records showed; empty before a fit.

    Attributes
    ----------
    method : "one_step", "free_run", or what fitted the model elsewhere
    converged : None before a fit
    samples : of all records
    nrmse : on these records
    ranges : lowest and highest value of each signal, by name [its unit]
    rates, frequencies : largest change of each signal [unit/s], and where 99 % of its power ends [Hz]
    steps : median size of the steps of each signal [its unit]
    line : offset and slope of the output over the input
    band : largest distance from that line [unit of the output]
    start : the first recorded input and output
    units : of the signals, by name, where they are known
    digits : significant digits that its printed parameters need; 0 where that is not known
    roles : of the channels, by name: setpoint, input, disturbance, derivative-of-y, ...
    machine : what was measured, one of `effects.MACHINES`, or "none", where the user said so
    """

    method: str = ""
    converged: bool | None = None
    samples: int = 0
    nrmse: Nrmse | None = None
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    frequencies: Mapping[str, float] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)
    line: tuple[float, float] | None = None
    band: float | None = None
    selection: Selection = field(default_factory=Selection)
    start: tuple[float, float] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    digits: int = 0
    roles: Mapping[str, str] = field(default_factory=dict)
    machine: str = ""

    @property
    def useless(self) -> bool:
        """Whether the free run is no better than a constant."""
        return self.nrmse is not None and not self.nrmse.free_run < USELESS

    @property
    def of_records(self) -> Info:
        """What stays true when the equation changes: what the records showed."""
        return Info(
            ranges=self.ranges, rates=self.rates, frequencies=self.frequencies, steps=self.steps, line=self.line,
            band=self.band, start=self.start, units=self.units,
            roles=self.roles, machine=self.machine,
        )  # fmt: skip


def acts(delay: int, Ts: float | None) -> str:
    """Say after how many samples, and seconds, an input acts."""
    if delay == 0:
        return "In the model the input acts at once."
    seconds = f" ({delay * Ts:.4g} s)" if Ts else ""
    return f"In the model the input acts after {delay} sample{'s' * (delay > 1)}{seconds}."
