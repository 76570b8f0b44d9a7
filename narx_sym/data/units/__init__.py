"""Units of signals and of the numbers in equations: labels, what follows by dimension, and how it is told."""

from .derived import Coefficients, by_unit, coefficient_units, coefficients, coefficients_latex, units_told
from .labels import converted, headed, in_header, in_units, listed, said_first, shown, unit

__all__ = [
    "Coefficients", "by_unit", "coefficient_units", "coefficients", "coefficients_latex", "converted", "headed",
    "in_header", "in_units", "listed", "said_first", "shown", "unit", "units_told",
]  # fmt: skip
