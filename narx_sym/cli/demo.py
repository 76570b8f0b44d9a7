"""The main job end to end, on simulated machines: identify, derive, compensate, compare; then find a missing effect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..data import plants
from ..data.examples import ACTUATOR_UNITS, PLAY, STAGE_UNITS, actuator, stage
from ..data.metrics import mape, nsavi
from ..data.record import Record
from ..diagnosis.bases import words
from ..diagnosis.procedure import diagnose
from ..engines.compile import compile
from ..files.atomic import write_csv, write_text
from ..files.store import save
from ..fit.evaluate import evaluate
from ..fit.identify import identify, identify_inverse
from ..inversion.analyses import document
from ..models import analysis
from ..models.model import Model
from ..report.parameters import effect_parameters, shape_units
from ..report.plots import plot_comparison, plot_compensation, plot_quasi_static
from ..symbolic.printing import text
from ..tasks.result_file import write_json
from .options import save_figure
from .printing import console, print_equations, print_found, print_model, print_tables, table, working

PAPER = {"model": 0.398, "inverse": 0.413, "none": 6.536, "law": 0.322, "inverse law": 0.425}


def run(out: Path) -> None:
    """Write everything into a folder and print the story."""
    out.mkdir(exist_ok=True)
    with working("Simulating a piezo actuator with Bouc-Wen hysteresis"):
        training, validation = actuator()
    for record in (training, validation):
        write_csv(out / f"{record.name}.csv", {"t": record.t, "u": record.u, "y": record.y})
    model, inverse = identify_both(out, training)
    derive(out, model)
    inputs, outputs = compensate(out, model, inverse, validation)
    compare(model, inverse, validation, inputs, outputs)
    draw(out, model, validation, inputs, outputs)
    find_missing(out)
    say(f"Written to {out}/: " + ", ".join(sorted(p.name for p in out.iterdir())), markup=False)


def say(what: str, **options: Any) -> None:
    """Print one line of the story."""
    console().print(what, **options)


def identify_both(out: Path, training: Record) -> tuple[Model, Model]:
    """Identify the model and the inverse model."""
    say("[bold]1. Identify[/bold]: a piezo actuator, 50 s at 1 kHz, u in V, y in um")
    with working("Selecting the structure and fitting in free run"):
        model = identify(training, for_compensation=True)
        inverse = identify_inverse(training, lead=2)
    save(model, out / "model.json")
    save(inverse, out / "inverse.json")
    say("  The model, selected by ERR from the paper's pool")
    print_model(model)
    return model, inverse


def derive(out: Path, model: Model) -> None:
    """Derive what section 3 of the paper says of the model."""
    say("[bold]2. Derive[/bold]: everything below is derived from the equation by algebra")
    sets = model.quasi_static()
    verdict = analysis.property_1(model)
    say(f"  Sigma_y = {model.sigma_y} = {model.theta[0]:g}; {verdict.reason}", markup=False)
    say(f"  loading:   ytilde = {sets.loading}", markup=False)
    say(f"  attracts where {sets.attracting}", markup=False)
    write_text(out / "derivation.tex", document(model))


def compensate(out: Path, model: Model, inverse: Model, validation: Record) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run both laws on the actuator: inputs and outputs by name."""
    say("[bold]3. Compensate[/bold]: the law in closed form")
    law, inverse_law = model.compensator(), inverse.compensator()
    say(f"  m[k] = {text(law.law)}", markup=False)
    say(f"  substituted into the model, it gives r[k+1] with residual {law.residual()}", markup=False)
    write_text(out / "law.tex", f"\\[\n{law.latex(numbers=True)}\n\\]\n")
    write_text(out / "law.c", law.export("c"))
    with working("Running the laws on the actuator"):
        r = validation.u
        inputs = {"without": r, "law": law.run(r), "inverse law": inverse_law.run(r)}
        outputs = {name: plants.bouc_wen(m) for name, m in inputs.items()}
    write_csv(out / "compensated.csv", {"t": validation.t, "r": r, "m": inputs["law"], "y": outputs["law"]})
    return inputs, outputs


def compare(model: Model, inverse: Model, validation: Record, inputs: dict[str, Any], outputs: dict[str, Any]) -> None:
    """Print the errors beside those of the paper."""
    say("[bold]4. Compare[/bold] with the paper (one noise realisation; the README shows twenty)")
    found = {name: mape(validation.u, y) for name, y in outputs.items()}
    table(
        "MAPE in % of the output's range",
        ["", "here", "paper"],
        [
            ["model, free run on a 40 V sine", evaluate(model, validation).free_run_mape, PAPER["model"]],
            ["identified inverse, free run", evaluate(inverse, validation).free_run_mape, PAPER["inverse"]],
            ["tracking without compensation", found["without"], PAPER["none"]],
            ["tracking with the law of the model", found["law"], PAPER["law"]],
            ["tracking with the law of the inverse", found["inverse law"], PAPER["inverse law"]],
            ["effort NSAVI, law of the model", nsavi(inputs["law"], validation.u), 1.13],
        ],
    )
    compiled = compile(model.recursion)
    say(f"  The model runs as {compiled.engine} code compiled from the equation.", markup=False)


def draw(out: Path, model: Model, validation: Record, inputs: dict[str, Any], outputs: dict[str, Any]) -> None:
    """Draw the model's free run, its quasi-static sets and the compensated run."""
    with working("Drawing"):
        save_figure(plot_comparison(model, validation[:2000], units=ACTUATOR_UNITS), out / "comparison.png")
        cycle = 70 * np.sin(2 * np.pi * np.arange(1000) / 1000)
        save_figure(plot_quasi_static(model, cycle, units=ACTUATOR_UNITS), out / "quasi_static.png")
        last = slice(-2000, None)
        shown = {"with the law": outputs["law"][last], "without": outputs["without"][last]}
        figure = plot_compensation(validation.t[last], validation.u[last], inputs["law"][last], shown, ACTUATOR_UNITS)
        save_figure(figure, out / "compensation.png")


def find_missing(out: Path) -> None:
    """Diagnose a machine with a hidden effect, add what is named, and diagnose one without it."""
    say("[bold]5. Diagnose[/bold]: a motor moves a stage; its gear has play, which no linear model contains")
    record = stage(PLAY)
    write_csv(out / "stage.csv", {"t": record.t, "u": record.u, "y": record.y})
    with working("Identifying a linear model of the stage"):
        base = identify(record, base="linear")
    with working("Diagnosing it: which effect is missing?") as progress:
        found = diagnose(base, record, report=progress)
    print_found(found, STAGE_UNITS, "")
    print_tables(found, STAGE_UNITS)
    write_json(found, out / "diagnosis.json", None)

    say("[bold]6. Add[/bold] what is missing, and watch the error fall")
    model = base
    if found.candidates:
        with working("Fitting the model with the effect"):
            model = base.add(found.best).fit(record)
        print_equations(model)
        added = model.effects[-1]
        sizes = effect_parameters(model, added, STAGE_UNITS, shape_units(found, STAGE_UNITS, model))
        say(f"  found: {words(added.effect)}, {sizes}; simulated: a play of half-width {PLAY:g} rad", markup=False)
    save(model, out / "model_with_effect.json")
    before, after = (evaluate(m, record).free_run_nrmse for m in (base, model))
    say(f"  free-run NRMSE: {before:.3g} before, {after:.3g} after", markup=False)
    with working("Writing the report"):
        found.report(out / "report.html", STAGE_UNITS, [out / "stage.csv"], {"base": "linear"})
    say(f"  All of it on one page: open {out / 'report.html'} in a browser", markup=False)

    say("[bold]7. Diagnose again[/bold]: the same stage with a new gear, without play")
    repaired = stage(0.0)
    with working("Identifying and diagnosing it"):
        healthy = diagnose(identify(repaired, base="linear"), repaired)
    say(f"  {healthy.sentence(STAGE_UNITS)}", markup=False)
    say(f"  The same on your own data: narx-sym diagnose {out / 'stage.csv'} --units rad,mm", markup=False)
