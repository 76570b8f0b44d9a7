"""A model's free run and a compensation law, each written for another place; the arguments are those of `export`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

from ..errors import ModelError
from ..inversion.compensator import Compensator
from ..models.model import Model
from ..models.rewrite import called
from ..models.system import System
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, m, r, y
from .export import written

Limits = Sequence[float] | Literal["known"] | None
DRAWN = ("js", "casadi")  # what pages draw and programs analyse: no machine runs it


def export_model(
    model: Model, to: str, name: str = "model", single: bool = False, units: Mapping[str, str] | None = None
) -> Any:
    """Export the free run of a model as source code or as an object of another library.

    Parameters
    ----------
    to : str
        "c", C99: state in a struct, init and step, no heap, a self-test. "st", one function block (IEC 61131-3) that
        starts from rest; "plcopen", that block in a project, with a program that tests it. "js", a constant with
        `simulate` over whole arrays, that takes the parameters. "casadi", a `Function` (state, inputs) -> (next,
        output): the state is `recursion.past`, which `rest_state` gives at rest, the inputs are `recursion.given`.
        "fmu", "fmu2", bytes of an FMU for co-simulation (FMI 3.0, 2.0) with its source, and a binary for this machine
        where a C compiler is found: the parameters are tunable, the communication step is a multiple of Ts; a step
        takes the inputs at its beginning, u[k], and ends with y[k+1], or with y[k] where the model reads u[k] itself.
        Further targets register in `narx_sym.codegen.registry`.
    single : bool
        Single precision.
    units : mapping such as {"u": "V", "y": "um"}
        Where a target has a place for them; by default those of the records that the model was fitted to.

    Raises
    ------
    ModelError
        For values or a sampling time that a target needs, and for what `narx_sym.codegen.export.written` refuses.
    """
    labels = {**model.info.units, **(units or {})}
    return written(
        to, model.recursion, model.values, name, single, model.output, model.starts, model.usual, model.Ts,
        _rest(model), labels, partial(model.units_told, units=labels),
    )  # fmt: skip


def export_system(
    system: System, to: str, name: str = "system", single: bool = False, units: Mapping[str, str] | None = None
) -> Any:
    """Export the free run of all outputs of a system, as `export_model` does for one.

    Parameters
    ----------
    to : str
        "c": a step returns the first output, the others are in the struct, such as `past->y2[0]`. "casadi": a
        `Function` (state, inputs) -> (next, output) with all outputs in order.

    Raises
    ------
    ModelError
        For another target, and as in `export_model`.
    """
    if to not in ("c", "casadi"):
        raise ModelError(f"A system is exported to c and casadi; for {to} export each of its parts.")
    initial: dict[Any, Any] = {}
    for output, part in system.parts.items():
        names = system.names(output)
        initial |= {names.get(b, b): called(e, names) for b, e in part.starts.items()}
    return written(
        to, system.recursion, system.values, name, single, system.outputs, initial, Ts=system.Ts,
        units={**system.units, **(units or {})},
    )  # fmt: skip


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
    """Export the law as source code or as an object of another library; `to` as in `export_model`.

    By default its input stays within the known range of the model; `limits` are others, None is without any. It starts
    from the rest of the first reference, where the model knows its records. Where the reference cannot be reached it
    comes as near as it can, and goes on from what the model beside it gives. A law that rings is damped. Both are so
    where it runs; `share` is as in `Compensator.run`.

    A step of an FMU takes the reference at the end of the preview, such as r[k+1], and ends with m[k], one sample late:
    to have m in time give r one sample earlier. Its parameters are those of the model.

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
    held = [f"{m.label} is limited to {limits[0]:.6g} ... {limits[1]:.6g}."] if limits is not None else []
    if law.model.output not in recursion.states:
        return held
    given = f"{law.model.output.label} is the output of the model for {m.label}"
    return [
        *held,
        f"If no input reaches the reference, the law comes as close as it can and continues from there: {given}.",
        *["If several inputs solve a sample, it takes one at once; law.run may later return to another one."]
        * bool(law.open_stages()),
    ]


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
