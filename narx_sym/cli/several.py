"""The commands for a model with several outputs: each output with its own model, run together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DataError, NarxError
from .printing import console, print_errors, print_model, say_written, working

# Heavy modules are imported inside the functions: `narx-sym --help` answers at once.
if TYPE_CHECKING:
    from ..data.record import Record
    from ..models.system import System
    from .options import Reading


def refuse(what: str, options: Mapping[str, Any]) -> None:
    """Refuse options that a command has for one output only."""
    if given := [name for name, value in options.items() if value]:
        raise DataError(f"{given[0]} needs a model with one output: leave it out with {what.rstrip(',')}.")


def fit_system(measured: Sequence[Record], judging: Sequence[Record], out: Path | None, **options: Any) -> None:
    """Identify all outputs, write the model, print it, its LaTeX and its errors."""
    from ..files.store import save
    from ..fit.several import identify_outputs

    with working(f"Identifying from {sum(len(r) for r in measured)} samples"):
        system = identify_outputs(list(measured), **options)
        pairs = _errors(system, measured) + _errors(system, judging, " (validation)")
    if out:
        save(system, out)
    for output, part in system.parts.items():
        console().print(f"[bold]{output}[/bold]")
        print_model(part)
    console().print("[bold]LaTeX[/bold]")
    console().print(system.latex(numbers=True), markup=False, soft_wrap=True)
    print_errors(pairs)
    say_written(("Model written to", out))


def derive_system(system: System, latex: Path | None) -> None:
    """Print equations, steady states and the law of all outputs."""
    from ..files.atomic import write_text
    from ..symbolic.printing import document_of, shown
    from ..symbolic.printing import latex as in_latex

    documents = [("Model", [system.latex(), *[system.latex(numbers=True)] * bool(system.values)])]
    told = [("Model", [f"{shown(e.lhs)} = {shown(e.rhs.xreplace(system.values))}" for e in system.equations])]
    try:
        found = system.equilibria()
        told.append(("Steady state", [f"{s} = {shown(e)}" for one in found for s, e in one.items()]))
        documents.append(("Steady state", [f"{in_latex(s)} = {in_latex(e)}" for one in found for s, e in one.items()]))
    except NarxError as error:
        told.append(("Steady state", [str(error)]))
    try:
        law = system.compensator()
        told.append(("Compensation law", [str(law.stability()), *law.lines(numbers=True)]))
        documents.append(("Compensation law", [law.latex()]))
    except NarxError as error:
        told.append(("Compensation law", [str(error)]))
    for heading, lines in told:
        console().print(f"[bold]{heading}[/bold]")
        for line in lines:
            console().print("  " + line, markup=False, soft_wrap=True)
    if latex:
        write_text(latex, document_of(documents))
    say_written(("LaTeX written to", latex))


def compare_system(
    system: System, how: Reading, data: list[Path], validate: list[Path] | None, json: Path | None
) -> None:
    """Print the errors of all outputs, one step ahead and in free run of all."""
    from ..tasks.compare import Compared, write_errors

    names = (",".join(system.inputs) if how.u == "u" else how.u, ",".join(system.outputs) if how.y == "y" else how.y)
    how = replace(how, u=names[0], y=names[1])
    measured = how.records(data)
    with working("Simulating"):
        pairs = _errors(system, measured)
        pairs += _errors(system, how.validating(validate, measured), " (validation)")
    print_errors(pairs)
    if json:
        write_errors(Compared(pairs, None, []), json)


def _errors(system: System, records: Sequence[Record], more: str = "") -> list[tuple[str, Any]]:
    """Return the errors of each output along each record."""
    from ..tasks.base import check_pace

    for record in records:
        check_pace(system, record.Ts, f"{record.name}: the record has")
    return [(f"{r.name}: {n}{more}", e) for r in records for n, e in system.evaluate(r).items()]
