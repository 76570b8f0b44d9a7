"""Go or no go: a compensation law over a reference, before it runs on the machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .options import (
    Column,
    DataFiles,
    Input,
    Limits,
    Missing,
    ModelFile,
    Output,
    Rate,
    Roles,
    Rows,
    Seed,
    Share,
    Time,
    Ts,
    Units,
    Validate,
    check_format,
    check_targets,
    records,
    save_figure,
    validating,
)
from .printing import console, working


def commission(
    model_file: ModelFile,
    data: DataFiles,
    reference: Annotated[Path, typer.Option("--reference", help="CSV with the wanted output.")],
    column: Column = None,
    limits: Limits = None,
    rate: Rate = None,
    share: Share = "auto",
    draws: Annotated[int, typer.Option(min=20, max=10_000, help="Parameter sets of the Monte Carlo.")] = 200,
    plot: Annotated[Path, typer.Option("--plot", help="Picture of input, output and error with their bands.")] = Path(
        "commission.png"
    ),
    json: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
    seed: Seed = 0,
    units: Units = "",
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    role: Roles = "",
    rows: Rows = None,
    validate: Validate = None,
    missing: Missing = "refuse",
) -> None:
    """Go or no go: what a law would reach on the machine, by Monte Carlo over what the records allow."""
    from ..data.record import read_signal
    from ..data.units import said_first
    from ..files.store import load
    from ..report.plots import plot_commissioning
    from ..tasks.base import check_pace
    from ..tasks.commission import commission as run
    from ..tasks.commission import write_commissioning

    check_format(plot)
    check_targets([plot, json], model_file, reference, *data, *(validate or []))
    model = load(model_file)
    measured = records(data, u, y, t, ts, "", rows, missing, units, model, roles=role)
    judging = validating(validate, measured, u, y, t, ts, "", missing, units, role)
    names = said_first(model.info.units, measured[0].units)
    goal, step, _ = read_signal(
        reference, column, t=t, option="--column", prefer="r", unit=names.get("y", ""), offers=()
    )
    check_pace(model, step, f"{reference}: the reference has")
    with working("Running the law and the models that the records allow"):
        part: Any = None if share == "none" else share
        law = model.compensator()
        found = run(law, goal, measured, limits=limits, rate=rate, share=part, draws=draws, seed=seed,
                    validation=judging)  # fmt: skip
    console().print(found.sentence(names), markup=False)
    if json:
        write_commissioning(found, json)
    save_figure(plot_commissioning(found, names), plot)
    console().print(f"Picture: {plot}")
