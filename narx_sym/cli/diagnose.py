"""The commands about effects: name the missing one, add it, list what is known."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ModelError, NarxError
from .options import (
    Channels,
    DataFiles,
    Input,
    Missing,
    ModelFile,
    Output,
    Rows,
    Time,
    Ts,
    Units,
    check_format,
    check_targets,
    console,
    note,
    print_equations,
    print_errors,
    print_fails,
    records,
    save_figure,
    table,
    unit_names,
    working,
)

if TYPE_CHECKING:
    from ..data.record import Record
    from ..diagnosis.misfit import Misfit
    from ..diagnosis.procedure import Diagnosis
    from ..models.effects import Catalogue
    from ..models.model import Model

EffectFiles = Annotated[
    list[Path] | None, typer.Option("--effects", help="Your own effects (TOML or JSON); may be repeated.")
]
FEW = 3  # effects shown from either end of the sizes that would have been seen
MARK = "*"


# -- diagnose --------------------------------------------------------------------------------------------------


def diagnose(
    data: DataFiles,
    base: Annotated[str, typer.Option(help="narx, linear, static, or a model file.")] = "linear",
    max_effects: Annotated[int, typer.Option("--max-effects", min=1, max=20, help="Most effects added.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn at random.")] = 0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write everything as JSON.")] = None,
    save: Annotated[Path | None, typer.Option("--save", help="Write the model with its effects.")] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Pictures: the diagnosis here, where it fails beside it (_where).")
    ] = None,
    experiment: Annotated[
        Path | None, typer.Option("--experiment", help="CSV for the next input (default: next.csv beside --json).")
    ] = None,
    report_file: Annotated[
        Path | None, typer.Option("--report", help="Write one HTML page that shows everything.")
    ] = None,
    effects: EffectFiles = None,
    units: Units = "",
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    channels: Channels = "",
    rows: Rows = None,
    missing: Missing = "refuse",
    resume: Annotated[
        Path | None, typer.Option("--resume", help="Keep results here; an interrupted run goes on from them.")
    ] = None,
) -> None:
    """Compare a model with measurements and name the physical effect that is missing.

    Without a model file the base is identified first. The same data and seed give the same JSON; only its last field,
    `seconds`, differs.
    """
    from dataclasses import replace

    from ..diagnosis.procedure import diagnose as run
    from ..files.journal import resuming

    effect_files = effects or []
    where = beside(plot)
    next_file = experiment or (json_file.parent / "next.csv" if json_file else None)
    targets = [json_file, save, plot, where, experiment, report_file, resume]
    check_targets(targets, *data, *effect_files, *([Path(base)] if is_file(base) else []))
    check_format(plot)
    catalogue = with_own(effect_files)
    start = loaded(base) if is_file(base) else None
    wanted = joined(channels, start.channels if start is not None else ())
    measured = records(data, u, y, t, ts, wanted, rows, missing)
    with resuming(resume) if resume else nullcontext() as journal:
        if start is None:
            start = identified(measured, base)
        elif start.Ts and abs(measured[0].Ts - start.Ts) > 1e-6 * start.Ts:
            note(f"the data have Ts = {measured[0].Ts:g} s, the model was identified at {start.Ts:g} s")
        with working("Diagnosing") as report:
            found = run(start, measured, max_effects=max_effects, catalogue=catalogue, seed=seed, report=report)
    if journal is not None and journal.found:
        note(f"{journal.found} results were in {resume} already")
    names = unit_names(units)
    step = found.steps[0]
    written = None
    if step.experiment is not None:
        if next_file is not None:
            step.experiment.save(next_file)
            written = next_file.name if json_file is None or same_folder(next_file, json_file) else str(next_file)
        step.experiment = replace(step.experiment, units=names, file=written or "")
    if json_file is not None:
        write_json(found, json_file, written)
    # All files are written before anything is printed: a closed pipe loses none.
    if plot is not None and where is not None:
        from ..report.plots import plot_diagnosis, where_it_fails

        save_figure(plot_diagnosis(found, units=names), plot)
        save_figure(where_it_fails(found.misfit, units=names), where)
    if report_file is not None:
        settings = {"base": base, "max_effects": max_effects, "channels": channels or "none", "rows": rows or "all"}
        with working("Writing the report"):
            found.report(report_file, names, data, settings)
    final = None if save is None else write_model(found, measured, save)
    show(found, names)
    if step.experiment is not None:
        print_next(written, next_file)
    if final is not None:
        print_errors(final[1])
        print_equations(final[0])
        console().print(f"Model written to {save}")
    if plot is not None:
        console().print(f"Pictures: {plot}, {where}")
    if report_file is not None:
        console().print(f"Report: {report_file}")
    if json_file is not None:
        console().print(f"JSON written to {json_file}")


def is_file(base: str) -> bool:
    """Whether --base names a model file and not a kind of base."""
    return base.lower().endswith(".json") or Path(base).is_file()


def loaded(base: str) -> Model:
    """Read a base from a model file."""
    from ..files.store import load
    from ..symbolic.signals import u

    model = load(base)
    if model.input != u:
        raise ModelError(f"{base}: this is an inverse model; diagnose needs one from u to y.")
    if model.theta is None:
        raise ModelError(f"{base}: the model has no parameter values; fit it first.")
    return model


def identified(measured: list[Record], base: str) -> Model:
    """Identify a base."""
    from ..fit.identify import BASES, identify, prepare

    if base not in BASES:
        raise ModelError(f"Unknown base {base!r}: use {', '.join(BASES)}, or a model file that ends in .json.")
    prepare(measured)  # what is wrong with the data is said at once
    with working(f"Identifying a base ({base}) from {sum(len(r) for r in measured)} samples"):
        return identify(measured, base=base)


def with_own(files: list[Path]) -> Catalogue:
    """Return the catalogue with the user's own effects."""
    from ..models.effects import EFFECTS, load_effects

    catalogue = EFFECTS.without()  # a copy
    for file in files:
        load_effects(file, catalogue)
    return catalogue


def joined(channels: str, more: Any) -> str:
    """Add the names of further columns."""
    return channels if channels == "all" else ",".join(dict.fromkeys(filter(None, [*channels.split(","), *more])))


def same_folder(one: Path, other: Path) -> bool:
    """Whether two files stand side by side."""
    return one.resolve().parent == other.resolve().parent


def beside(plot: Path | None) -> Path | None:
    """Return the name of the picture of where it fails."""
    return plot and plot.with_stem(f"{plot.stem}_where")


def write_json(found: Diagnosis, path: Path, experiment: str | None) -> None:
    """Write a diagnosis in the published schema: sorted keys, no NaN, `seconds` last."""
    from ..files.atomic import write_text

    plain = finite(found.to_dict(experiment))
    seconds = plain.pop("seconds")
    text = json.dumps(plain, indent=1, sort_keys=True, allow_nan=False)
    write_text(path, f'{text[:-2]},\n "seconds": {json.dumps(seconds)}\n}}\n')


def finite(value: Any) -> Any:
    """Replace what JSON cannot say, NaN and infinity, by null."""
    if isinstance(value, dict):
        return {str(n): finite(v) for n, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def show(found: Diagnosis, units: dict[str, str]) -> None:
    """Print what was found."""
    step = found.steps[0]
    console().print(f"[bold]{found.verdict}[/bold]")
    console().print(found.sentence(units), markup=False)
    before = step.nrmse(step.base)["validation"]
    rows = [
        [
            f"{row['effect']}{' ' + MARK if row['in_confusion_set'] else ''}", row["where"],
            f"{100 * row['share']:.0f} %", f"{100 * row['low']:.0f} to {100 * row['high']:.0f} %", before,
            row["nrmse"], row["parameters"],
        ]
        for row in found.table()
    ]  # fmt: skip
    if rows:
        table(
            f"Candidates (share of the removable error, with its 95 % interval; {MARK} these data cannot tell apart)",
            ["effect", "where", "share", "interval", "free-run NRMSE before", "after", "parameters"],
            rows,
        )
    floor = found.floor / step.base.problem.spread
    ladder = [[name, r["train"], r["validation"]] for name, r in zip(found.rungs, found.ladder, strict=True)]
    ladder.append([f"noise floor ({step.floor_kind})", "", floor])
    table("Errors, step by step (free-run NRMSE)", ["model", "training", "held out"], ladder)
    for i, later in enumerate(found.steps[1:], 2):
        console().print(f"Step {i}: {later.sentence(units)}", markup=False)
    print_fails(found.misfit, units)
    print_detectable(step, units)


def print_detectable(step: Any, units: dict[str, str]) -> None:
    """Print which effects these data would have shown, and which a refit hides."""
    seen = {n: v for n, v in step.smallest_detectable.items() if n not in step.absorbed}
    sizes = sorted(seen.items(), key=lambda p: (p[1], p[0]))
    shown = sizes if len(sizes) <= 2 * FEW else [*sizes[:FEW], ("...", None), *sizes[-FEW:]]
    spread, unit = step.base.problem.spread, f" [{units['y']}]" if units.get("y") else ""
    rows = [[n, "" if v is None else v, "" if v is None else f"{100 * v / spread:.2g} %"] for n, v in shown]
    if rows:
        table(
            "What could not have been seen: an effect that moves the output by less",
            ["effect", f"rms{unit}", "of the output's standard deviation"],
            rows,
        )
    if step.absorbed:
        console().print(f"A refit of the base absorbs: {', '.join(step.absorbed)}.", markup=False)


def print_next(written: str | None, path: Path | None) -> None:
    """Say where the input of the next experiment is."""
    if written:
        console().print(f"The input of the next experiment: {path}")
    else:
        console().print("To write the input of the next experiment: --experiment next.csv")


def write_model(found: Diagnosis, measured: list[Record], path: Path) -> tuple[Model, list[tuple[str, Any]]]:
    """Fit the last model again, on all samples, and write it; return it with the errors on the way there."""
    from ..files.store import save
    from ..fit.simulate import evaluate

    names = found.rungs
    rows = [("base", evaluate(found.steps[0].base.model, measured))] if len(names) > 1 else []
    what = " ".join(names)
    rows.append((f"{what}, fitted on the training blocks", evaluate(found.model, measured)))
    with working("Fitting on all samples"):
        model = refitted(found.model, measured)
    rows.append((f"{what}, fitted on all samples", evaluate(model, measured)))
    save(model, path)
    if len(names) == 1:
        note("nothing was added: the model written is the base")
    return model, rows


def refitted(model: Model, measured: list[Record]) -> Model:
    """Return the model fitted in free run on all samples; where that fails, as it is."""
    from ..errors import FitError
    from ..fit.least_squares import describe, fit

    try:
        return fit(model.copy(), measured, method="free_run")
    except FitError as error:
        note(f"the fit on all samples failed ({error}); the one on the training blocks is kept")
        kept = model.copy()
        describe(kept, measured, "free_run", True)
        return kept


# -- add -------------------------------------------------------------------------------------------------------


def add(
    model_file: ModelFile,
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="Id, as `narx-sym effects` lists it.")],
    data: DataFiles,
    out: Annotated[Path, typer.Option("--out", help="Where to write the model with the effect.")],
    where: Annotated[str | None, typer.Option(help="input, inside or output (default: what fits best).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn at random.")] = 0,
    effects: EffectFiles = None,
    u: Input = "u",
    y: Output = "y",
    t: Time = "t",
    ts: Ts = None,
    channels: Channels = "",
    rows: Rows = None,
    missing: Missing = "refuse",
) -> None:
    """Add an effect to a model, fit both together in free run, and compare the errors before and after."""
    from ..diagnosis.add import Addition
    from ..files.store import save
    from ..fit.identify import prepare
    from ..fit.simulate import evaluate

    check_targets([out], model_file, *data, *(effects or []))
    model = loaded(str(model_file))
    addition = Addition(model, effect, where, with_own(effects or []))
    wanted = joined(channels, [*model.channels, *([addition.channel] if addition.channel else [])])
    measured = records(data, u, y, t, ts, wanted, rows, missing)
    prepare(measured)
    with working(f"Adding {effect}") as report:
        before = evaluate(model, measured)
        without = refitted(model, measured)
        made = addition.fit(measured, seed, report)
        pairs = [
            ("before", before), ("before, fitted to these data", evaluate(without, measured)),
            (f"with {effect}", evaluate(made, measured)),
        ]  # fmt: skip
    save(made, out)
    for one in made.info["effects"][-1:]:
        driven = f", driven by {one['driver']}" if one["driver"] in ("u", "y") else ""
        form = f" ({one['form']})" if one["form"] else ""
        place = "inside" if one["where"] == "inside" else f"at the {one['where']}"
        console().print(f"[bold]{one['effect']}[/bold]{form} {place}{driven}")
    print_errors(pairs)
    print_equations(made)
    console().print(f"Model written to {out}")


# -- effects ---------------------------------------------------------------------------------------------------


def effects(effects: EffectFiles = None) -> None:
    """List the catalogue: what each effect is, its equations, where it may act, units and sources."""
    from ..models.effects import DETECTED

    say = console().print
    catalogue = with_own(effects or [])
    say("Every effect multiplies a coefficient c: at c = 0 the model is as before. x is what drives it.\n")
    for name, forms in catalogue.items():
        needs = any("channel" in f.arguments for f in forms)
        say(f"[bold]{name}{':<name>' if needs else ''}[/bold]  {forms[0].sentence}")
        for one in forms:
            say(f"    {f'{one.form}: ' if one.form else ''}{one.written}", markup=False)
            say(f"        {one.acts}{f'; {one.source}' if one.source else ''}", markup=False)
    say("\nSeen in the record itself, without a model: " + ", ".join(DETECTED) + ".")


# -- compare ---------------------------------------------------------------------------------------------------


def fails(model: Model, measured: list[Record]) -> Misfit | None:
    """Where a model as it is fails along the longest segment; None where that cannot be said."""
    from ..diagnosis.misfit import misfit_of
    from ..diagnosis.refit import period_noise
    from ..fit.simulate import free_run
    from ..symbolic.signals import u

    if model.input != u:
        note("where it fails is shown for models from u to y, not for inverse ones")
        return None
    record = max((s for r in measured for s in r.segments()), key=len)
    try:
        error = record.y - free_run(model, record)
        noise = [x for part in period_noise([record]) for x in part.tolist()]
        floor = math.sqrt(math.fsum(x * x for x in noise) / len(noise)) if noise else None
        return misfit_of(model, record, error, floor)
    except NarxError as error:
        note(f"where it fails cannot be said: {error}")
        return None
