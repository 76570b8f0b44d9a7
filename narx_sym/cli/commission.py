"""Go or no go: a compensation law over a reference, before it runs on the machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from . import options as opt
from .printing import console, working


@opt.reads("channels")
def commission(
    model_file: opt.ModelFile,
    data: opt.DataFiles,
    reference: Annotated[Path, typer.Option("--reference", help="CSV with the reference (the desired output).")],
    column: opt.Column = None,
    limits: opt.Limits = None,
    rate: opt.Rate = None,
    share: opt.Share = "auto",
    draws: Annotated[
        int, typer.Option(min=20, max=10_000, help="Number of parameter sets in the Monte Carlo simulation.")
    ] = 200,
    plot: Annotated[
        Path, typer.Option("--plot", help="Picture of input, output and error with their 95 % bands.")
    ] = Path("commission.png"),
    json: Annotated[Path | None, typer.Option("--json", help="Write the results as JSON.")] = None,
    seed: opt.Seed = 0,
    validate: opt.Validate = None,
    *,
    how: opt.Reading,
) -> None:
    """Predict the tracking error of a law on the machine (Monte Carlo over models that fit the data): go or no go."""
    from ..data.record import read_signal
    from ..data.units import said_first
    from ..files.store import load_model
    from ..report.plots import plot_commissioning
    from ..tasks.base import check_pace
    from ..tasks.commission import commission as run
    from ..tasks.commission import write_commissioning

    opt.check_format(plot)
    opt.check_targets([plot, json], model_file, reference, *data, *(validate or []))
    model = load_model(model_file)
    measured = how.records(data, model)
    judging = how.validating(validate, measured)
    names = said_first(model.info.units, measured[0].units)
    goal, step, _ = read_signal(
        reference, column, t=how.t, option="--column", prefer="r", unit=names.get("y", ""), offers=()
    )
    check_pace(model, step, f"{reference}: the reference has")
    with working("Running the law on many models that fit the records"):
        part: Any = None if share == "none" else share
        law = model.compensator()
        found = run(law, goal, measured, limits=limits, rate=rate, share=part, draws=draws, seed=seed,
                    validation=judging)  # fmt: skip
    console().print(found.sentence(names), markup=False)
    if json:
        write_commissioning(found, json)
    opt.save_figure(plot_commissioning(found, names), plot)
    console().print(f"Picture: {plot}")
