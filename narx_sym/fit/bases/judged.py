"""What an identified base is worth: said as warnings."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from ...data.evidence.several import moving
from ...data.record import Record
from ...errors import Diverged
from ...models.info import USELESS
from ...models.model import Model
from ..evaluate import free_run_nrmse
from ..least_squares import described, free_run_error
from ..simulate import simulate

CYCLES = 10  # of a loop over the whole range of the input
LITTLE = 0.5  # NRMSE of a free run that explains little of the output


def judged(model: Model, records: Sequence[Record]) -> Model:
    """Warn where a model explains little, where its law is unstable, or where its free run is not bounded."""
    error = free_run_error(model)
    if model.info.useless:
        warnings.warn(
            f"The free run is no better than a constant (NRMSE {error:.3g}): do not use this model. Try another "
            "base, delay or input column. For an inverse model, noise on its input can be the cause.",
            stacklevel=3,
        )
    elif error >= LITTLE:
        warnings.warn(f"The free run explains little of the output (NRMSE {error:.3g}).", stacklevel=3)
    several = len(records) > 1 and not model.info.useless  # offsets between them may hide it
    for record in moving(records, model.output.name) if several else ():
        if (own := free_run_nrmse(model, record)) >= USELESS:
            said = f"no better than a constant (NRMSE {own:.3g})"
            warnings.warn(f"Along the record {record.name!r} the free run is {said}.", stacklevel=3)
    if model.info.selection.stable_law is False:
        warnings.warn("The compensation law of this model is unstable on these data: it may diverge.", stacklevel=3)
    growth = periodic_growth(model)
    if growth > 1:
        warnings.warn(
            f"Under a periodic input over the identified range the free run drifts away by {growth:.2g} ranges in "
            f"{CYCLES} periods: the model is not bounded.",
            stacklevel=3,
        )
    return described(model, records)


def periodic_growth(model: Model) -> float:
    """Return how far repeated loops over the identified input range move, in ranges of the output."""
    (low, high), (bottom, top) = (model.info.ranges[b.name] for b in (model.input, model.output))
    if model.channels or top <= bottom:
        return 0.0
    sine = (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * np.arange(400 * CYCLES) / 400)
    try:
        run = simulate(model, sine, warn=False)
    except Diverged:
        return float("inf")
    return float(np.abs(run[-1] - run[399]) / (top - bottom))
