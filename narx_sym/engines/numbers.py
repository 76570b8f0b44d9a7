"""Numbers are data: machine code is made from equations, and is given the numbers in them beside the parameters.

So the equations of one effect are compiled once for all records, whatever their sampling time and operating point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp

from ..symbolic.recursion import Recursion
from ..symbolic.signals import rewritten


def floats(x: Any) -> np.ndarray:
    """Return what is given as numbers; a masked one (`numpy.ma`) is missing, NaN.

    Raises
    ------
    TypeError, ValueError
        For what is no array of real numbers.
    """
    if np.iscomplexobj(x):
        raise TypeError("complex numbers are not allowed")
    if isinstance(x, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(x), np.nan, np.asarray(x.data, dtype=np.float64))
    return np.asarray(x, dtype=np.float64)


def lifted(recursion: Recursion) -> tuple[Recursion, np.ndarray]:
    """Return a recursion with a further parameter for each decimal number in it, and these numbers, (n,).

    Whole numbers and fractions stay, and so does every exponent: they are part of the form.
    """
    found: dict[float, sp.Symbol] = {}

    def lift(part: Any) -> Any:
        if part.is_Float:
            # No name of a model has a blank.
            return found.setdefault(float(part), sp.Symbol(f"number {len(found)}", real=True))
        if part.is_Pow:
            base = rewritten(part.base, lift)
            return part if base is part.base else base**part.exp
        return None

    updates = tuple((left, rewritten(right, lift)) for left, right in recursion.updates)
    return Recursion(updates, (*recursion.parameters, *found.values())), np.array(list(found), dtype=float)
