"""How the next output of a model moves with older outputs and with the input, along a run."""

from __future__ import annotations

import numpy as np
import sympy as sp

from ...data.record import Record
from ...engines.columns import Columns
from ...models.model import Model
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import expand_phi, k, samples

Array = np.ndarray


def slopes_along(model: Model, record: Record, simulated: Array) -> tuple[Array, Array]:
    """Return dF/dy[k-j] and dF/du[k-j] along a run, (N, n_y) and (N, lags of u); 0 where they are not known."""
    known = dict(zip(model.symbols, map(float, model.theta), strict=True))
    seen = {"u": record.u, "y": simulated, "x": simulated, "v": record.u, "t": record.t, **record.channels}
    lags = sorted({s for s in samples(model.core) if s.base.name in ("u", "v")}, key=str)

    def along(inner: object) -> Array:
        made = np.zeros(len(record))
        slope = sp.sympify(derivative(model.core, inner).xreplace(known))
        if not slope.atoms(sp.Indexed):
            return np.full(len(record), float(slope))
        columns = Columns([model.in_user_units(expand_phi(slope))])
        if all(s.base.name in seen for s in samples(columns.terms[0])):
            made[columns.depth :] = columns(seen)[:, 0]
        return made

    outputs = [along(model.inner[k - j - 1]) for j in range(model.n_y)]
    return tuple(np.array(x).reshape(-1, len(record)).T for x in (outputs, [along(s) for s in lags]))  # type: ignore
