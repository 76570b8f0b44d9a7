"""The sign of a step as a smooth function: the paper's future work (section 7), as a symbolic substitution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sympy as sp

from ..errors import ModelError
from .signals import breve_phi1, breve_phi2, differences, phi1, phi2, samples

# Odd, from -1 to 1, of a step measured in widths.
FORMS: dict[str, Callable[[Any], Any]] = {
    "tanh": sp.tanh,
    "root": lambda x: x / sp.sqrt(1 + x**2),
    "atan": lambda x: 2 / sp.pi * sp.atan(sp.pi * x / 2),
}
# Of the record's median step. Wider smooths the hysteresis away, narrower leaves the jumps (derivations/B2).
DEFAULT = 0.3


def smoothed(expr: Any, eps: Mapping[Any, float], form: str | Callable[[Any], Any] = "tanh") -> Any:
    """Put form(step/eps) in the place of sign(step), and step*form(step/eps) in the place of its absolute value.

    Parameters
    ----------
    expr : expression
    eps : mapping from a sequence to a width [its unit]
        A step is a difference in time of one of these sequences, or phi1 of it. A sign of anything else stays.
    form : "tanh", "root" (x/sqrt(1 + x^2)), "atan", or a function of a SymPy expression

    Raises
    ------
    ModelError
        For an unknown form.
    """
    if not callable(form) and form not in FORMS:
        raise ModelError(f"Unknown smooth form {form!r}; there are {', '.join(FORMS)}.")
    shape = form if callable(form) else FORMS[form]
    exact = {base: sp.Rational(str(width)) for base, width in eps.items()}

    def soft(step: Any) -> Any:
        base = _driver(step, exact)
        return sp.sign(step) if base is None else shape(step / exact[base])

    named = {s: soft(first[s.indices[0]]) for first, second in _PHI for s in samples(expr, second)}
    written = sp.sympify(expr).xreplace({s: found for s, found in named.items() if not isinstance(found, sp.sign)})
    steps = written.replace(lambda e: isinstance(e, sp.Abs) and _driver(e.args[0], exact) is not None,
                            lambda e: e.args[0] * soft(e.args[0]))  # fmt: skip
    return steps.replace(sp.sign, soft)


_PHI = ((phi1, phi2), (breve_phi1, breve_phi2))


def _driver(step: Any, bases: Mapping[Any, Any]) -> Any:
    """Return the sequence whose step an expression is."""
    read = samples(step)
    for base in bases:
        if len(read) == 1 and read[0].base == differences(base)[0] and sp.expand(step / read[0]).is_number:
            return base
        level = sp.Dummy()
        if len(read) > 1 and all(s.base == base for s in read):
            if sp.expand(step.xreplace(dict.fromkeys(read, level))) == 0:
                return base
    return None


def widths(eps: Any, sequences: Mapping[Any, str], steps: Mapping[str, float]) -> dict[Any, float]:
    """Return eps for each sequence: as given, or from the steps of the record that a model was fitted on.

    Parameters
    ----------
    eps : None, a number, or a mapping from "u" and "y" to numbers
    sequences : mapping from each sequence to "u" or "y", the measured signal that it stands for
    steps : mapping from "u" and "y" to the median steps of that record

    Raises
    ------
    ModelError
        For a width that is not positive, or where none is given and the record's steps are not known.
    """
    if eps is None:
        if not steps:
            raise ModelError("Give eps: the model was not fitted to data, so the size of a step is not known.")
        found = {name: float(f"{DEFAULT * step:.2g}") for name, step in steps.items()}
    elif isinstance(eps, Mapping):
        found = {str(getattr(b, "label", b)): width for b, width in eps.items()}
    else:
        found = dict.fromkeys(sequences.values(), eps)
    for name, width in found.items():
        if not isinstance(width, (int, float)) or not 0 < width < float("inf"):
            raise ModelError(f"The width eps of {name} must be a positive number, not {width!r}.")
    return {base: float(found[name]) for base, name in sequences.items() if name in found}
