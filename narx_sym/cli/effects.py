"""The commands about effects: add one to a model, list what is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options as opt
from .printing import console, print_equations, print_errors, working


@opt.reads()
def add(
    model_file: opt.ModelFile,
    effect: Annotated[
        str, typer.Argument(metavar="EFFECT", help="Name of the effect, as listed by `narx-sym effects`.")
    ],
    data: opt.DataFiles,
    out: Annotated[Path, typer.Option("--out", help="Where to write the model with the effect.")],
    where: Annotated[
        str | None,
        typer.Option(
            help="Where the effect acts: input, force, inside, motion, friction, output or sensor (default: "
            "the best fit)."
        ),
    ] = None,
    seed: opt.Seed = 0,
    effects: opt.EffectFiles = None,
    *,
    how: opt.Reading,
) -> None:
    """Add an effect to a model, fit them together in free run, and compare the errors before and after."""
    from ..diagnosis.add import Addition
    from ..files.store import save
    from ..models.effects import PLACES
    from ..tasks import add as task
    from ..tasks.base import read_base

    opt.check_targets([out], model_file, *data, *(effects or []))
    model = read_base(model_file)
    addition = Addition(model, effect, where, opt.with_own(effects or []))
    measured = how.records(data, model, [*model.channels, *filter(None, [addition.channel])])
    with working(f"Adding {effect}") as progress:
        made = task.add(addition, measured, seed, progress)
    save(made.model, out)
    for one in made.model.effects[-1:]:
        driven = f", driven by {one.driver}" if one.driver in ("u", "y") else ""
        form = f" ({one.form})" if one.form else ""
        console().print(f"[bold]{one.effect}[/bold]{form} {PLACES[one.where]}{driven}")
    print_errors(made.errors)
    print_equations(made.model)
    console().print(f"Model written to {out}")


def effects(effects: opt.EffectFiles = None) -> None:
    """List all effects that `diagnose` knows: their equations, places, units and sources."""
    from ..models.effects import DETECTED

    say = console().print
    catalogue = opt.with_own(effects or [])
    say(
        "Every effect has a coefficient c; with c = 0 the model is unchanged. x is the signal that drives the effect.\n"
    )
    for name, forms in catalogue.items():
        needs = any("channel" in f.arguments for f in forms)
        say(f"[bold]{name}{':<name>' if needs else ''}[/bold]  {forms[0].sentence}")
        for one in forms:
            say(f"    {f'{one.form}: ' if one.form else ''}{one.written}", markup=False)
            say(f"        {one.acts}{f'; {one.source}' if one.source else ''}", markup=False)
    say("\nFound in the record itself, without a model: " + ", ".join(DETECTED) + ".")
