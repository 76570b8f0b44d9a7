"""The main job on the paper's bench test, end to end: identify, derive, compensate, draw."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from . import analysis, plants
from .compile import compile
from .data import Record
from .derive import document
from .files import write_csv, write_text
from .identification import identify, identify_inverse
from .metrics import mape, nsavi
from .plots import plot_comparison, plot_compensation, plot_quasi_static
from .printing import text
from .simulation import evaluate
from .store import save

UNITS = {"u": "V", "y": "um", "r": "um", "m": "V"}
PAPER = {"model": 0.398, "inverse": 0.413, "none": 6.536, "law": 0.322, "inverse law": 0.425}
PEAK, SEED = 75.0, 0


def bench(seed: int = SEED, peak: float = PEAK) -> tuple[Record, Record]:
    """Return identification and validation records of the piezo actuator (section 5 of the paper)."""
    u = plants.filtered_noise(peak=peak, seed=seed)
    t = np.arange(u.size) * 1e-3
    sine = 40 * np.sin(2 * np.pi * t)
    return (
        Record.from_arrays(u, plants.bouc_wen(u), Ts=1e-3, name="identification"),
        Record.from_arrays(sine, plants.bouc_wen(sine), Ts=1e-3, name="validation"),
    )


def run(
    out: Path,
    working: Callable[[str], Any],
    table: Callable[..., None],
    console: Any,
    save_figure: Callable[[Any, Path], None],
) -> None:
    """Write everything into a folder and print the story."""
    out.mkdir(exist_ok=True)
    say = console.print
    with working("Simulating a piezo actuator with Bouc-Wen hysteresis"):
        training, validation = bench()
    write_csv(out / "identification.csv", {"t": training.t, "u": training.u, "y": training.y})
    write_csv(out / "validation.csv", {"t": validation.t, "u": validation.u, "y": validation.y})

    say("[bold]1. Identify[/bold]: a piezo actuator, 50 s at 1 kHz, u in V, y in um")
    with working("Selecting the structure and fitting in free run"):
        model = identify(training, for_compensation=True)
        inverse = identify_inverse(training, lead=2)
    save(model, out / "model.json")
    save(inverse, out / "inverse.json")
    rows = [[r["symbol"], r["term"], f"{r['theta']:.5g}", f"{r['std']:.1g}"] for r in model.table()]
    table(
        "The model, selected by ERR from the paper's pool",
        ["parameter", "term", "value", "standard error"],
        rows,
    )

    say("[bold]2. Derive[/bold]: everything below follows from the equation by algebra")
    sets = model.quasi_static()
    verdict = analysis.property_1(model)
    say(f"  Sigma_y = {model.sigma_y} = {model.theta[0]:g}; {verdict.reason}", markup=False)
    say(f"  loading:   ytilde = {sets.loading}", markup=False)
    say(f"  attracts where {sets.attracting}", markup=False)
    write_text(out / "derivation.tex", document(model))

    say("[bold]3. Compensate[/bold]: the law in closed form")
    law, inverse_law = model.compensator(), inverse.compensator()
    say(f"  m[k] = {text(law.law)}", markup=False)
    say(f"  put back into the model it gives r[k+1] with residual {law.residual()}", markup=False)
    write_text(out / "law.tex", f"\\[\n{law.latex(numbers=True)}\n\\]\n")
    write_text(out / "law.c", law.to_c())
    with working("Running the laws on the actuator"):
        r = validation.u
        inputs = {"without": r, "law": law.run(r), "inverse law": inverse_law.run(r)}
        outputs = {name: plants.bouc_wen(m) for name, m in inputs.items()}
    write_csv(out / "compensated.csv", {"t": validation.t, "r": r, "m": inputs["law"], "y": outputs["law"]})

    say("[bold]4. Compare[/bold] with the paper (one noise realisation; the README shows twenty)")
    found = {name: mape(r, y) for name, y in outputs.items()}
    table(
        "MAPE in % of the output's range",
        ["", "here", "paper"],
        [
            ["model, free run on a 40 V sine", evaluate(model, validation).free_run_mape, PAPER["model"]],
            ["identified inverse, free run", evaluate(inverse, validation).free_run_mape, PAPER["inverse"]],
            ["tracking without compensation", found["without"], PAPER["none"]],
            ["tracking with the law of the model", found["law"], PAPER["law"]],
            ["tracking with the law of the inverse", found["inverse law"], PAPER["inverse law"]],
            ["effort NSAVI, law of the model", nsavi(inputs["law"], r), 1.13],
        ],
    )
    compiled = compile(model.recursion)
    say(f"  The model runs as {compiled.engine} code compiled from the equation.", markup=False)

    with working("Drawing"):
        window = validation[:2000]
        save_figure(plot_comparison(model, window, units=UNITS), out / "comparison.png")
        save_figure(
            plot_quasi_static(model, 70 * np.sin(2 * np.pi * np.arange(1000) / 1000), units=UNITS),
            out / "quasi_static.png",
        )
        last = slice(-2000, None)
        shown = {"with the law": outputs["law"][last], "without": outputs["without"][last]}
        figure = plot_compensation(validation.t[last], r[last], inputs["law"][last], shown, UNITS)
        save_figure(figure, out / "compensation.png")
    say(f"Written to {out}/: " + ", ".join(sorted(p.name for p in out.iterdir())), markup=False)
