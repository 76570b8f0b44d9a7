"""One signal as an array of finite numbers, whatever it was given as."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engines.numbers import floats
from ..errors import NarxError

Vector = NDArray[np.float64]


def vector(x: Any, where: str, error: type[NarxError], advice: str) -> Vector:
    """Return a finite array (N,); (N, 1) and (1, N) are flattened.

    Parameters
    ----------
    where, advice : what the signal is called in an error, and what to do about values that are not finite
    error : what is raised for anything else
    """
    try:
        if np.asarray(x).dtype.kind in "mM":  # dates are no seconds
            raise TypeError
        out = floats(x)
    except (TypeError, ValueError):
        raise error(f"{where} is not an array of real numbers") from None
    if out.ndim == 2 and 1 in out.shape:
        out = out.ravel()
    if out.ndim != 1:
        raise error(f"{where} has shape {out.shape}; one signal of shape (N,) is needed")
    bad = np.flatnonzero(~np.isfinite(out))
    if bad.size:
        raise error(f"{where} has {bad.size} missing or infinite value(s), the first at index {bad[0]}; {advice}")
    return out
