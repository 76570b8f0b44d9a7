"""References that share no code with the package: exact rationals, complex steps, and the NIST data sets.

The files in `strd/` hold the linear sets of the NIST Statistical Reference Datasets with their certified values.
"""

import cmath
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import sympy as sp
from hypothesis import strategies as st

from narx_sym.data.record import Record
from narx_sym.models.model import NARX
from narx_sym.symbolic.signals import k, lag, phi1, phi2, samples, u, y

FOLDER = Path(__file__).parent / "strd"
NAMES = sorted(f.stem for f in FOLDER.glob("*.txt"))
CERTIFIED_DIGITS = 15


# -- NIST StRD -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Strd:
    """A data set: texts as they are certified, so that rationals see the exact decimals."""

    level: str
    terms: list[str]
    theta: list[str]
    std: list[str]
    data: dict[str, list[str]]

    @property
    def floats(self):
        return {name: np.array(column, dtype=float) for name, column in self.data.items()}

    @property
    def fit_problem(self):
        """A static model with the set's regressors, and the data as a record: the first regressor is u."""
        first, *others = [name for name in self.data if name != "y"]
        columns = self.floats
        texts = [
            t if t == "1" else re.sub(r"^\w+", lambda n: f"{'u' if n[0] == first else n[0]}[k]", t) for t in self.terms
        ]
        record = Record.from_arrays(columns[first], columns["y"], Ts=1.0, channels={n: columns[n] for n in others})
        return NARX.from_terms(texts, channels=others), record

    def design(self, number):
        """Regressors as lists, in any kind of number."""
        columns = {name: [number(v) for v in column] for name, column in self.data.items()}
        parts = [t.partition("**") for t in self.terms]
        one = [number(1)] * len(columns["y"])
        design = [one if b == "1" else [v ** int(e or 1) for v in columns[b]] for b, _, e in parts]
        return design, columns["y"]


def strd(name):
    lines = (FOLDER / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    level = next(line.split()[-1] for line in lines if line.startswith("# level"))
    terms, theta, std = zip(*(line[2:].split() for line in lines if line.startswith("#: ")), strict=True)
    names, *rows = [line.split() for line in lines if not line.startswith("#")]
    data = dict(zip(names, zip(*rows, strict=True), strict=True))
    return Strd(level, list(terms), list(theta), list(std), {n: list(c) for n, c in data.items()})


def solve_exactly(matrix, *rights):
    """Gauss-Jordan elimination in fractions: one solution per right-hand side."""
    n = len(matrix)
    rows = [[*row, *values] for row, *values in zip(matrix, *rights, strict=True)]
    for i in range(n):
        pivot = next(j for j in range(i, n) if rows[j][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in range(n):
            if j != i and rows[j][i]:
                rows[j] = [a - rows[j][i] * b for a, b in zip(rows[j], rows[i], strict=True)]
    return [[row[n + c] for row in rows] for c in range(len(rights))]


def exact_least_squares(design, target):
    """Estimates and the squares of their standard deviations, in fractions."""
    gram = [[sum(a * b for a, b in zip(p, q, strict=True)) for q in design] for p in design]
    right = [sum(a * b for a, b in zip(p, target, strict=True)) for p in design]
    p = len(design)
    theta, *inverse = solve_exactly(gram, right, *([Fraction(i == j) for j in range(p)] for i in range(p)))
    rss = sum(v * v for v in target) - sum(a * b for a, b in zip(theta, right, strict=True))
    return theta, [rss / (len(target) - p) * inverse[i][i] for i in range(p)]


def digits(found, certified):
    """The smallest number of correct digits (log relative error); absolute where the certified value is 0."""
    pairs = [(float(a), float(b)) for a, b in zip(found, certified, strict=True)]
    errors = [abs(a - b) / (abs(b) or 1.0) for a, b in pairs]
    return min(CERTIFIED_DIGITS, *(-np.log10(e) if e else CERTIFIED_DIGITS for e in errors))


# -- constrained least squares in rationals ----------------------------------------------------------------------


def exact_constrained(Psi, target, S, c):
    """Minimise |y - Psi theta| under S theta = c in rational arithmetic, by a null space and exact normal equations."""
    rational = lambda x: sp.Matrix([[sp.Rational(float(v)) for v in row] for row in np.atleast_2d(x)])  # noqa: E731
    A, b, S, c = rational(Psi), rational(target[:, None]), sp.Matrix(S), sp.Matrix(c)
    free = sp.symbols(f"w:{S.cols}")
    (solution,) = sp.linsolve((S, c), *free)
    t0 = sp.Matrix([e.subs(dict.fromkeys(free, 0)) for e in solution])
    if S.rank() == S.cols:
        return np.array(t0, dtype=float).ravel()
    Z = sp.Matrix.hstack(*S.nullspace())
    reduced = A * Z
    w = (reduced.T * reduced).LUsolve(reduced.T * (b - A * t0))
    return np.array(t0 + Z * w, dtype=float).ravel()


# -- derivatives by a complex step -------------------------------------------------------------------------------

FUNCTIONS = {"sin": cmath.sin, "cos": cmath.cos, "tanh": cmath.tanh, "exp": cmath.exp, "sign": np.sign}
STEP = 1e-100


def complex_step(right, parameters, inputs, theta, start):
    """The run y[k] = right and its derivatives: by each parameter, and last by a common shift of the start.

    The derivative is Im y(theta + i h) / h: no difference is taken, so no digit is lost (Squire & Trapp 1998).
    """
    used = samples(right)
    f = sp.lambdify([*used, *parameters], right, [FUNCTIONS, "math"])
    n = len(inputs["u"])
    columns = []
    for at in range(len(theta) + 1):
        values = [t + 1j * STEP * (i == at) for i, t in enumerate(theta)]
        out = [s + 1j * STEP * (at == len(theta)) for s in start]
        for i in range(len(start), n):
            past = [out[i - lag(s)] if s.base == y else inputs[str(s.base.label)][i - lag(s)] for s in used]
            out.append(f(*past, *values))
        columns.append(np.array(out, dtype=complex))
    return columns[0].real, [c.imag / STEP for c in columns]


@st.composite
def smooth_models(draw):
    """Contracting models that are differentiable in y and theta; the input may switch them."""
    count = draw(st.integers(1, 4))
    parameters = sp.symbols(f"a:{count}", real=True)

    def past():
        return y[k - draw(st.integers(1, 3))]

    def given_input():
        return u[k - draw(st.integers(0, 3))]

    def term(p):
        s, other, v = past(), past(), given_input()
        kind = draw(st.integers(0, 8))
        return (
            p * s, p * v, p * s * v, sp.tanh(p * s + v), sp.sin(p * v) * s, p**2 * s * other, phi2[k - 1] * p * s,
            phi1[k - 2] * sp.exp(-(p**2)) * other, sp.cos(p * s) * p,
        )[kind]  # fmt: skip

    right = sum((term(p) / (2 * count) for p in parameters), start=draw(st.sampled_from((0, y[k - 1] / 4, u[k]))))
    theta = [draw(st.sampled_from((-1, 1))) * draw(st.floats(0.1, 1)) for _ in parameters]
    return right, parameters, theta, draw(st.integers(0, 999))


def triangle(Psi, target):
    return np.linalg.qr(np.column_stack([Psi, target]), mode="r")


def random_problem(seed, n=300, width=12):
    """Correlated candidates and a sparse truth with noise."""
    random = np.random.default_rng(seed)
    Psi = random.standard_normal((n, width)) @ (np.eye(width) + 0.6 * random.standard_normal((width, width)))
    Psi *= 10.0 ** random.integers(-6, 6, width)
    truth = np.where(random.random(width) < 0.4, random.standard_normal(width), 0) / np.linalg.norm(Psi, axis=0)
    return Psi, Psi @ truth + 0.05 * random.standard_normal(n) / np.sqrt(n)


def classical(Psi, target, steps):
    """Forward orthogonal least squares from its definition (Chen, Billings & Luo 1989), in long double, on all rows."""
    W, d = Psi.astype(np.longdouble), target.astype(np.longdouble)
    energy, order, shares, basis, gaps = d @ d, [], [], [], []
    for _ in range(steps):
        ratios = {}
        for j in set(range(W.shape[1])) - set(order):
            w = W[:, j].copy()
            for _ in range(2):
                for b in basis:
                    w -= (b @ w) / (b @ b) * b
            ratios[j] = ((w @ d) ** 2 / ((w @ w) * energy), w)
        pick = max(ratios, key=lambda j: ratios[j][0])
        ranked = sorted((float(x) for x, _ in ratios.values()), reverse=True)
        gaps.append(1 - ranked[1] / ranked[0] if len(ranked) > 1 else 1.0)
        order.append(pick)
        shares.append(float(ratios[pick][0]))
        basis.append(ratios[pick][1])
    return order, np.array(shares), min(gaps)
