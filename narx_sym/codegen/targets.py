"""A model's free run and a compensation law, each written for another place; the arguments are those of `export`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..errors import NotInvertible
from ..inversion.compensator import Compensator
from ..models.model import Model
from ..symbolic.recursion import Recursion
from ..symbolic.signals import m, y
from .export import transition, written


def export_model(model: Model, to: str, name: str = "model", single: bool = False) -> Any:
    """Return the free run for another place: `to` is "c", "st" or another target of `narx_sym.codegen.registry`."""
    values, starts = model.values, model.starts
    return written(to, model.recursion, values, name, single, model.output, starts, model.usual, model.Ts)


def model_to_c(model: Model, name: str = "model", single: bool = False) -> str:
    """Return the free run as C99 source; see `narx_sym.codegen.export.to_c`."""
    return str(export_model(model, "c", name, single))


def model_to_st(model: Model, name: str = "model", single: bool = False) -> str:
    """Return the free run as an IEC 61131-3 function block; see `narx_sym.codegen.export.to_st`."""
    return str(export_model(model, "st", name, single))


def model_to_casadi(model: Model, name: str = "model") -> Any:
    """Return one step as a CasADi `Function` (state, inputs) -> (next, output).

    state : `recursion.past`, such as y[k-1], y[k-2], u[k-1]; `rest_state` gives its values at rest
    inputs : `recursion.given`, such as u[k]; next is the state one sample later, output is y[k]
    """
    return transition(model.recursion, model.values, name, model.output)


def export_law(
    law: Compensator,
    to: str,
    name: str = "law",
    single: bool = False,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
) -> Any:
    """Return the law for another place, within limits where they are given; `to` as in `export_model`.

    Raises
    ------
    NotInvertible
        Where the law has no closed form.
    """
    recursion, usual = _exported(law, limits, rate), law.model.usual
    driven = "u" if law.model.input == y else str(law.model.input.label)
    usual = {**usual, **{own: usual[of] for own, of in (("m", driven), ("r", "y")) if of in usual}}
    return written(to, recursion, law.model.values, name, single, m, ranges=usual, Ts=law.model.Ts)


def law_to_c(
    law: Compensator,
    name: str = "law",
    single: bool = False,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
) -> str:
    """Return the law as C99 source; see `export_law` and `narx_sym.codegen.export.to_c`."""
    return str(export_law(law, "c", name, single, limits, rate))


def law_to_st(
    law: Compensator,
    name: str = "law",
    single: bool = False,
    limits: Sequence[float] | None = None,
    rate: float | None = None,
) -> str:
    """Return the law as an IEC 61131-3 function block; see `export_law`."""
    return str(export_law(law, "st", name, single, limits, rate))


def law_to_casadi(law: Compensator, name: str = "law") -> Any:
    """Return one step as a CasADi `Function` (state, inputs) -> (next, output).

    state : `recursion.past`, such as m[k-1], r[k]; `rest_state` gives its values at rest
    inputs : `recursion.given`, the reference at the end of the preview, such as r[k+1]; output is m[k]
    """
    return transition(_exported(law), law.model.values, name, m)


def _exported(law: Compensator, limits: Sequence[float] | None = None, rate: float | None = None) -> Recursion:
    if not law.closed_form:
        why = next(s.proof for s in law.staged.stages if not s.closed_form) if law.staged else ""
        raise NotInvertible(f"This law cannot be exported: {why}.")
    return law.recursion if limits is None and rate is None else law.limited(limits, rate)
