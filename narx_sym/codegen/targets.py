"""A model's free run and a compensation law, each written for another place; the arguments are those of `export`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

from ..errors import ModelError
from ..files.atomic import PathLike, write_bytes
from ..inversion.compensator import Compensator
from ..models.model import Model
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, m, r, y
from .export import transition, written

Limits = Sequence[float] | Literal["known"] | None
DRAWN = ("js", "casadi")  # what pages draw and programs analyse: no machine runs it


def export_model(
    model: Model, to: str, name: str = "model", single: bool = False, units: Mapping[str, str] | None = None
) -> Any:
    """Return the free run for another place: `to` is "c", "st" or another target of `narx_sym.codegen.registry`.

    `units` such as {"u": "V", "y": "um"}, by default those of the records that the model was fitted to, stand where a
    target has a place for them.
    """
    labels = {**model.info.units, **(units or {})}
    return written(
        to, model.recursion, model.values, name, single, model.output, model.starts, model.usual, model.Ts,
        _rest(model), labels, partial(model.units_told, units=labels),
    )  # fmt: skip


def model_to_c(model: Model, name: str = "model", single: bool = False) -> str:
    """Return the free run as C99 source; see `narx_sym.codegen.export.to_c`."""
    return str(export_model(model, "c", name, single))


def model_to_st(model: Model, name: str = "model", single: bool = False) -> str:
    """Return the free run as an IEC 61131-3 function block; see `narx_sym.codegen.export.to_st`."""
    return str(export_model(model, "st", name, single))


def model_to_fmu(
    model: Model,
    path: PathLike,
    name: str = "model",
    fmi: str = "3.0",
    units: Mapping[str, str] | None = None,
) -> None:
    """Write the free run as an FMU for co-simulation; the file appears whole or not at all.

    Its C source is inside, and a binary for this machine where a C compiler is found. The parameters are tunable; the
    values before the start, such as u_rest and y_rest, are parameters too. The communication step is a multiple of Ts.
    A step takes the inputs at its beginning, u[k], and ends with y[k+1]; a model that reads u[k] itself ends it with
    y[k], which is one sample late.

    Parameters
    ----------
    fmi : "3.0" or "2.0"
    units : mapping such as {"u": "V", "y": "um"}

    Raises
    ------
    ModelError
        For a model without sampling time or values, and for what `narx_sym.codegen.export.to_c` refuses.
    """
    write_bytes(path, export_model(model, _fmu(fmi), name, units=units))


def model_to_js(model: Model, name: str = "model") -> str:
    """Return the free run as JavaScript that takes the parameters; see `narx_sym.codegen.export.to_js`."""
    return str(export_model(model, "js", name))


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
    limits: Limits = "known",
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    share: Any = "auto",
    force: bool = False,
) -> Any:
    """Return the law for another place; `to` as in `export_model`.

    By default its input stays within the known range of the model; `limits` are others, None is without any. It starts
    from the rest of the first reference, where the model knows its records. Where the reference cannot be reached it
    comes as near as it can, and goes on from what the model beside it gives. A law that rings is damped. Both are so
    where it runs; `share` is as in `Compensator.run`.

    Raises
    ------
    ModelError
        For a law that is unstable, unless it is asked for with `force` or only drawn (JavaScript, CasADi).
    NotInvertible
        Where the law has no closed form, and it is not proved that there is one root.
    """
    if not force and to not in DRAWN:
        law.refuse_unstable()
    driven = "u" if law.model.input == y else law.model.input.name
    limits = law.model.info.ranges.get(driven) if limits == "known" else limits
    recursion, rest = law.exported(limits, rate, share), law.rest_expression(limits)
    initial = law.starts
    if rest is not None:
        begun = {b: e for b, e in ((m, rest), (law.model.output, r[k])) if b in recursion.states}
        at_rest = {b[k]: e for b, e in begun.items()}
        initial = {b: e.xreplace(at_rest) for b, e in initial.items()} | begun

    def own(of: Mapping[str, Any]) -> dict[str, Any]:
        return {**of, **{a: of[b] for a, b in (("m", driven), ("r", "y")) if b in of}}

    labels = {**law.model.info.units, **(units or {})}
    return written(
        to, recursion, law.model.values, name, single, m, initial, own(law.model.usual), law.model.Ts,
        own(_rest(law.model)), own(labels), partial(law.model.units_told, units=labels),
        [str(law.stability()), *law_notes(law, recursion, limits)],
    )  # fmt: skip


def law_notes(law: Compensator, recursion: Recursion, limits: Sequence[float] | None = None) -> list[str]:
    """Return what the comment on top says of limits, and of a law with the model beside it."""
    held = [f"{m.label} is held from {limits[0]:.6g} to {limits[1]:.6g}."] if limits is not None else []
    if law.model.output not in recursion.states:
        return held
    given = f"{law.model.output.label} is what the model gives of {m.label}"
    return [
        *held,
        f"Where no input gives the reference, the law comes as near as it can and goes on from there: {given}.",
        *["Of several inputs that are right for a sample it takes one at once; law.run may go back to another."]
        * bool(law.open_stages()),
    ]


def law_to_c(
    law: Compensator,
    name: str = "law",
    single: bool = False,
    limits: Limits = "known",
    rate: float | None = None,
    share: Any = "auto",
    force: bool = False,
) -> str:
    """Return the law as C99 source; see `export_law` and `narx_sym.codegen.export.to_c`."""
    return str(export_law(law, "c", name, single, limits, rate, share=share, force=force))


def law_to_st(
    law: Compensator,
    name: str = "law",
    single: bool = False,
    limits: Limits = "known",
    rate: float | None = None,
    share: Any = "auto",
    force: bool = False,
) -> str:
    """Return the law as an IEC 61131-3 function block; see `export_law`."""
    return str(export_law(law, "st", name, single, limits, rate, share=share, force=force))


def law_to_fmu(
    law: Compensator,
    path: PathLike,
    name: str = "law",
    fmi: str = "3.0",
    limits: Limits = "known",
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    share: Any = "auto",
    force: bool = False,
) -> None:
    """Write the law as an FMU for co-simulation; see `export_law` and `model_to_fmu`.

    A step takes the reference at the end of the preview, such as r[k+1], and ends with m[k], one sample late: to have m
    in time give r one sample earlier. The parameters are those of the model.
    """
    write_bytes(path, export_law(law, _fmu(fmi), name, limits=limits, rate=rate, units=units, share=share, force=force))


def law_to_js(
    law: Compensator,
    name: str = "law",
    limits: Limits = "known",
    rate: float | None = None,
    share: Any = "auto",
    force: bool = False,
) -> str:
    """Return the law as JavaScript that takes the parameters; see `export_law` and `narx_sym.codegen.export.to_js`."""
    return str(export_law(law, "js", name, False, limits, rate, share=share, force=force))


def law_to_casadi(law: Compensator, name: str = "law", share: Any = "auto") -> Any:
    """Return one step of `law.exported()` as a CasADi `Function` (state, inputs) -> (next, output).

    state : `law.exported().past`, such as m[k-1], r[k]; `rest_state` gives its values at rest
    inputs : `law.exported().given`, the reference at the end of the preview, such as r[k+1]; output is m[k]
    """
    return transition(law.exported(share=share), law.model.values, name, m)


def _fmu(fmi: str) -> str:
    """Return the target for a version of the standard."""
    known = {"3.0": "fmu", "2.0": "fmu2"}
    if fmi not in known:
        raise ModelError(f"There are FMUs of FMI {' and '.join(known)}, not of {fmi!r}.")
    return known[fmi]


def _rest(model: Model) -> dict[str, float]:
    """Return where a model rests unless something else is said.

    The operating point; else 0 where the records have it inside, the middle of their range where not; the output on
    the line through the records.
    """
    inside = {name: 0.0 if low <= 0 <= high else (low + high) / 2 for name, (low, high) in model.info.ranges.items()}
    found = inside | {b.name: value for b, value in model.operating_point.items()}
    if model.info.line is not None and not model.operating_point:
        offset, slope = model.info.line
        found[model.output.name] = offset + slope * found.get(model.input.name, 0.0)
    return found
