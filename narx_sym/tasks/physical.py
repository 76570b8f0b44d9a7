"""A diagnosis in physical units: what its last model is as a differential equation, with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..diagnosis.procedure import Diagnosis
from ..errors import ModelError, NarxError
from ..fit.continuous import continuous
from ..models.continuous_time import Continuous, linear_part


def physical(
    found: Diagnosis, units: Mapping[str, str] | None = None, scale: Mapping[str, Any] | str | None = None
) -> Continuous | str:
    """Return the last model of a diagnosis in physical units, with 95 % intervals, or why there is no such form.

    The intervals are those of the samples that it was fitted to.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "m"}, optional
    scale : see `Model.continuous`

    Raises
    ------
    ModelError
        For a scale that cannot be read, or is per another unit than that of the input.
    """
    model, split = found.model, found.steps[0].trial.split
    try:
        if model.info.useless:
            raise ModelError("The free run of the model is no better than a constant.")
        if not linear_part(model).linear:
            raise ModelError("The model is nonlinear: `derive --continuous` gives its linearisation.")
    except NarxError as error:
        return str(error)
    parts = [r[: int(np.count_nonzero(m))] for r, m in zip(split.records, split.train, strict=True)]
    try:
        return continuous(model, scale, [p for p in parts if len(p)], units)
    except NarxError:  # the values are known, their intervals are not
        return continuous(model, scale, units=units)


def plain_rows(found: Continuous | str) -> list[dict[str, Any]]:
    """Return the quantities as plain data; none where there is no such form."""
    return [] if isinstance(found, str) else [q.to_dict() for q in found.quantities]
