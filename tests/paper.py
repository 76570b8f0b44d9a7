"""The paper's models, once: terms and values as printed, and the printed equations as expressions.

Each equation is transcribed by itself, not built from the terms: tests/whole/test_paper.py compares them. Row names are
those of the derivations: E1, E2 (examples), P3 to P8 (bench test), V1 (pneumatic valve).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

import narx_sym as ns
from narx_sym.symbolic.signals import breve_phi1, breve_phi2, k, m, phi1, phi2, r, u, y

theta_1, theta_2, theta_3, theta_4, theta_5, theta_6 = sp.symbols("theta_1:7", real=True)
sign = sp.sign
OF_INVERSE = {"input": "y", "output": "u", "lead": 2}  # tau_d = 1 and tau_s = 2: its y[k-1] is the measured y[k+1]


@dataclass(frozen=True)
class Printed:
    """A model of the paper: terms in the printed order, values as texts, so that rationals see the exact decimals."""

    terms: tuple[str, ...]
    equation: sp.Expr
    law: sp.Expr | None = None
    values: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def theta(self) -> list[float]:
        return [float(value) for value in self.values]

    @property
    def exact(self) -> dict[sp.Symbol, sp.Rational]:
        return dict(zip(self.model().symbols, map(sp.Rational, self.values), strict=True))

    def model(self, theta: Sequence[float] | None = None, **more: Any) -> ns.NARX:
        """Return it without values, or with other ones than the printed."""
        return ns.NARX.from_terms(self.terms, theta, **self.options, **more)

    def published(self, **more: Any) -> ns.NARX:
        return self.model(self.theta, **more)


# -- section 3 and 4: the examples ------------------------------------------------------------------------------

EXAMPLE_1 = Printed(  # Eq. (170919a)
    ("y[k-1]", "phi2[k-1]", "phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]", "phi1[k-1]"),
    theta_1 * y[k - 1] + theta_2 * phi2[k - 1] + theta_3 * phi1[k - 1] * u[k - 1]
    + theta_4 * phi2[k - 1] * phi1[k - 1] * y[k - 1] + theta_5 * phi1[k - 1],
)  # fmt: skip
_dm = m[k - 1] - m[k - 2]
EXAMPLE_2 = Printed(  # Eqs. (190919c), (200919g)
    ("y[k-1]", "phi2[k-2]", "phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]", "phi1[k-1]"),
    theta_1 * y[k - 1] + theta_2 * phi2[k - 2] + theta_3 * phi1[k - 2] * u[k - 2]
    + theta_4 * phi2[k - 2] * phi1[k - 2] * y[k - 1] + theta_5 * phi1[k - 1],
    (
        r[k + 1] - theta_1 * r[k] + theta_5 * m[k - 1]
        - theta_2 * sign(_dm) - theta_3 * _dm * m[k - 1] - theta_4 * sign(_dm) * _dm * r[k]
    ) / theta_5,
)  # fmt: skip

# -- section 5: the bench test -----------------------------------------------------------------------------------

BENCH = Printed(  # Eqs. (IdentifiedModel:Cms), (InputCompensation:Cms), Table 1
    (
        "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
        "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
    ),
    theta_1 * y[k - 1] + theta_2 * phi1[k - 1] + theta_3 * phi2[k - 2] * phi1[k - 2] * u[k - 2]
    + theta_4 * phi2[k - 2] * phi1[k - 2] * y[k - 1] + theta_5 * phi1[k - 2] * u[k - 2] ** 2
    + theta_6 * phi1[k - 2] * u[k - 2] * y[k - 1],
    (
        r[k + 1] - theta_1 * r[k] + theta_2 * m[k - 1]
        - (theta_3 * m[k - 1] + theta_4 * r[k]) * sign(_dm) * _dm
        - (theta_5 * m[k - 1] ** 2 + theta_6 * m[k - 1] * r[k]) * _dm
    ) / theta_2,
    ("1.00", "0.77", "1.44e-2", "-9.60e-3", "3.15e-4", "-2.47e-4"),
)  # fmt: skip
_dr = r[k + 1] - r[k]
BENCH_INVERSE = Printed(  # Eqs. (IdentifiedModel:Cci), (InputCompensation:Cci), Table 1: the breve forms of phi
    (
        "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
        "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
    ),
    theta_1 * u[k - 1] + theta_2 * breve_phi1[k - 1]
    + theta_3 * breve_phi2[k - 1] * breve_phi1[k - 1] * u[k - 1]
    + theta_4 * breve_phi2[k - 1] * breve_phi1[k - 1] * y[k - 1]
    + theta_5 * breve_phi2[k - 1] * y[k - 1] * u[k - 1] + theta_6 * breve_phi2[k - 1] * y[k - 1] ** 2,
    theta_1 * m[k - 1] + theta_2 * _dr
    + (theta_3 * m[k - 1] + theta_4 * r[k + 1]) * sign(_dr) * _dr
    + (theta_5 * r[k + 1] * m[k - 1] + theta_6 * r[k + 1] ** 2) * sign(_dr),
    ("1.00", "1.27", "-2.13e-2", "1.37e-2", "-1.07e-5", "7.99e-6"),
    OF_INVERSE,
)  # fmt: skip

# -- section 6: the pneumatic valve; its equations are printed with numbers ---------------------------------------

_a, _b, _c, _d = (sp.Rational(value) for value in ("19.76", "19.32", "9.44", "12.61"))
VALVE = Printed(  # Eqs. (IdentifiedModel:Cms), (InputCompensation:Cms)
    ("y[k-1]", "phi1[k-2]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"),
    y[k - 1] - _a * phi1[k - 2] + _b * phi1[k - 1] + _c * phi2[k - 2] * phi1[k - 2] * u[k - 2]
    - _d * phi2[k - 2] * phi1[k - 2] * y[k - 1],
    (r[k + 1] - r[k] + _b * m[k - 1] + _a * _dm - _c * sign(_dm) * _dm * m[k - 1] + _d * sign(_dm) * _dm * r[k]) / _b,
    ("1", "-19.76", "19.32", "9.44", "-12.61"),
)  # fmt: skip
_a, _b, _c, _d, _e = (sp.Rational(value) for value in ("86.67", "85.02", "0.98", "1.72", "1.13"))
_old = r[k] - r[k - 1]
VALVE_INVERSE = Printed(  # Eqs. (IdentifiedModel:Cci), (InputCompensation:Cci)
    (
        "u[k-1]", "phi1[k-1]", "phi1[k-2]", "phi1[k-1]*y[k-2]",
        "phi2[k-2]*phi1[k-2]*y[k-2]", "phi2[k-2]*phi1[k-2]*u[k-1]",
    ),
    u[k - 1] + _a * breve_phi1[k - 1] - _b * breve_phi1[k - 2] - _c * breve_phi1[k - 1] * y[k - 2]
    + _d * breve_phi2[k - 2] * breve_phi1[k - 2] * y[k - 2] - _e * breve_phi2[k - 2] * breve_phi1[k - 2] * u[k - 1],
    m[k - 1] + _a * _dr - _b * _old - _c * _dr * r[k] + _d * sign(_old) * _old * r[k] - _e * sign(_old) * _old * m[k - 1],
    ("1", "86.67", "-85.02", "-0.98", "1.72", "-1.13"),
    OF_INVERSE,
)  # fmt: skip

MODELS = {
    "E1": EXAMPLE_1, "E2": EXAMPLE_2, "bench": BENCH, "bench inverse": BENCH_INVERSE, "valve": VALVE,
    "valve inverse": VALVE_INVERSE,
}  # fmt: skip
