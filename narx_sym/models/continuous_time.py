r"""The differential equation behind a sampled model, in physical units.

A held input (zero-order hold) makes of a differential equation with poles s_i a recursion with poles p_i = exp(s_i Ts);
back it goes by the logarithm of each pole, s_i = ln(p_i) / Ts, and the residues R_i = r_i s_i / (p_i - 1): the matrix
logarithm of the companion form, written out in partial fractions. Of the steady state nothing is lost: forces of
effects inside are referred to the input by B(1), the sum of its coefficients.

Every quantity is a SymPy expression in the parameters of the model and its poles, so that its standard error follows
from their covariance: d p / d a_i = p^(n-i) / A'(p).

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems, 1998, chapter 6; Astrom, Hagander & Sternby,
Zeros of sampled systems, Automatica 20, 1984 (why a sampled mass has a zero of its own).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import sympy as sp
from mpmath.libmp.libhyper import NoConvergence

from ..errors import ModelError
from ..symbolic.numbers import number, prefixed
from ..symbolic.printing import InLatex, latex
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import expand_phi, held, lag, samples
from .added import outside
from .model import Model

NORMAL = 1.959964  # standard errors on either side of a value: 95 % of a normal distribution
ROUNDED = 1e-12  # of the sum of the coefficients of older outputs: nearer to 1 is a pole at 1
FADES = 0.5  # a negative pole up to here is gone within a few samples, and stands as a delay
APART = 3.0  # times faster than the mass: what lags more is a part of its own
PRECISION = 30  # digits of poles: near 1 their logarithm loses many
MASSES = {
    ("N", "m"): "kg",
    **{(torque, "rad"): "kg m²" for torque in ("N m", "N·m", "Nm")},
}  # a force over acceleration
TIME: sp.Symbol = sp.Symbol("t", real=True)


@dataclass(frozen=True)
class Unit:
    """A unit as powers of that of the input, of the output and of the second.

    `force` is what enters beside the input: it has the unit of the input, or that of `scale`. `input` keeps the unit of
    the input.
    """

    force: int = 0
    y: int = 0
    s: int = 0
    input: int = 0
    said: str = ""  # a unit that is known as a text

    def text(self, labels: Mapping[str, str]) -> str:
        """Return the unit as text; "" for a pure number.

        Parameters
        ----------
        labels : mapping from "force", "u" and "y" to their units
        """
        if self.said:
            return self.said
        names = (labels["force"], labels["u"], labels["y"])
        if (self.force, self.y, self.s) == (1, -1, 2) and (names[0], names[2]) in MASSES:
            return MASSES[names[0], names[2]]
        listed = [*zip(names, (self.force, self.input, self.y), strict=True), ("s", self.s)]
        above = " ".join(_power(n, p) for n, p in listed if p > 0)
        below = [_power(n, -p) for n, p in listed if p < 0]
        if not below:
            return above
        joined = " ".join(below)
        return f"{above or '1'}/{f'({joined})' if len(below) > 1 or ' ' in joined else joined}"


def _power(name: str, power: int) -> str:
    whole = f"({name})" if " " in name and power > 1 else name
    return whole + ("" if power == 1 else str(power).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")))


@dataclass(frozen=True)
class Quantity:
    """One physical quantity.

    Attributes
    ----------
    name : str
        In words, such as "Coulomb friction".
    symbol : Symbol
        By which the equation calls it.
    expression : expression
        In the parameters of the model, and its poles p_1, p_2, ...
    value, error : float
        In `unit`; its standard error is NaN where no records were given, or where they do not fix it.
    unit : str
        "" for a pure number.
    in_input : float or None
        The same in the unit of the input, where `value` is a force in another one.
    effect : str
        Id of the effect that it belongs to, "" for the linear part.
    """

    name: str
    symbol: Any
    expression: Any
    value: float = float("nan")
    error: float = float("nan")
    unit: str = ""
    in_input: float | None = None
    input_unit: str = ""
    effect: str = ""

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return self.value - NORMAL * self.error

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.value + NORMAL * self.error

    @property
    def text(self) -> str:
        """Name, value, unit and interval, such as "mass 95.1 kg, 95 % 94.9 ... 95.3"."""
        return f"{self.name} {self.sized}"

    @property
    def sized(self) -> str:
        """Value, unit and interval."""
        factor, unit = prefixed(self.unit, self.value)
        digits = _digits(self.value, self.error)
        said = f"{number(factor * self.value, digits)} {unit}".rstrip()
        if self.in_input is not None:
            said += f" ({number(self.in_input)} {self.input_unit})"
        if self.error > 0:
            low, high = (number(factor * v, digits) for v in (self.low, self.high))
            said += f", 95 % {low} ... {high}" if low != high else ""
        return said

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; None for what is not known."""
        known = {n: v if isfinite(v) else None for n, v in (("low", self.low), ("high", self.high))}
        own = {"name": self.name, "symbol": str(self.symbol), "value": self.value, **known, "unit": self.unit}
        own |= {"in_input": self.in_input, "input_unit": self.input_unit} if self.in_input is not None else {}
        return own | ({"effect": self.effect} if self.effect else {})


def _digits(value: float, error: float) -> int:
    """Return how many digits show the interval too, three to six."""
    if not (isfinite(error) and error > 0 and value):
        return 3
    return next((d for d in (3, 4, 5) if abs(value) * 10.0 ** (1 - d) < 2 * error), 6)


# -- the linear part -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Linear:
    """A(q) y = B(q) u + c of a model around its operating point, and the poles of A.

    Attributes
    ----------
    a, b : mappings from lags to expressions in the model's symbols
    constant : expression
    poles : mapping from the symbols p_1, p_2, ... to numbers, the slowest first, without those at 1
    integrators : how many poles are at 1
    delayed : the poles that are not positive: they fade within a few samples, and count as a delay
    linear : whether the model's core is linear; else this is its tangent
    Ts : sampling time [s]
    """

    a: Mapping[int, Any]
    b: Mapping[int, Any]
    constant: Any
    poles: Mapping[Any, Any]
    integrators: int
    delayed: tuple[Any, ...]
    linear: bool
    Ts: Any

    @property
    def order(self) -> int:
        """The number of poles that a differential equation has."""
        return len(self.poles) - len(self.delayed) + self.integrators

    @property
    def lasting(self) -> list[Any]:
        """The symbols of the poles that a differential equation has, without those at 1, the slowest first."""
        return [p for p in self.poles if p not in self.delayed]

    @property
    def s(self) -> dict[Any, Any]:
        """The poles of the differential equation by those of the recursion, ln(p) / Ts [rad/s]."""
        return {p: sp.log(p) / self.Ts for p in self.lasting}

    @property
    def B(self) -> Any:
        """B(1): what a force beside a steady input has to be multiplied with."""
        return sp.Add(*self.b.values())

    @property
    def gain(self) -> Any:
        """Y over u in steady state, with integrators the derivative of y over u."""
        return self.B / sp.Mul(*(1 - p for p in self.poles)) / self.Ts**self.integrators

    def number(self, expr: Any, values: Mapping[Any, Any]) -> Any:
        """Return an expression at the values of the parameters and poles."""
        return sp.N(sp.sympify(expr).subs({**values, **self.poles}), PRECISION)

    def real(self, expr: Any, values: Mapping[Any, Any]) -> float:
        """Return an expression at the values of the parameters and poles as a float; pairs leave no imaginary part."""
        return float(sp.re(self.number(expr, values)))

    def derivatives(self, expr: Any, symbols: Sequence[Any], values: Mapping[Any, Any]) -> list[float]:
        """Return the derivatives by the parameters, through the poles too (the delta method's)."""
        expr, n, z = sp.sympify(expr), max(self.a, default=0), sp.Dummy("z")
        A = z**n - sp.Add(*(c * z ** (n - i) for i, c in self.a.items()))
        slope, through = sp.diff(A, z), {}
        for p in expr.free_symbols & self.poles.keys():
            at = self.number(slope.subs(z, p), values)
            outer = self.number(sp.diff(expr, p), values)
            through[p] = {i: outer * self.number(p ** (n - i), values) / at for i in self.a}
        found = []
        for symbol in symbols:
            total = self.number(sp.diff(expr, symbol), values)
            for of in through.values():
                for i, c in self.a.items():
                    if c.has(symbol):
                        total += of[i] * self.number(sp.diff(c, symbol), values)
            found.append(float(sp.re(total)))
        return found


def linear_part(model: Model) -> Linear:
    """Return the linear part of a fitted model's core around its operating point, and its poles.

    Raises
    ------
    ModelError
        For an inverse model, one without values or sampling time, one whose core remembers more than inputs and
        outputs, and one without a differential equation: a pole that alternates from sample to sample.
    """
    if model.lead or model.output.name != "y":
        raise ModelError("An inverse model has no differential equation: use the model itself.")
    if model.theta is None or not model.Ts:
        missing = "parameter values" if model.theta is None else "a sampling time: give Ts"
        raise ModelError(f"The model has no {missing}; a differential equation needs both.")
    none = {c: sp.S.Zero for e in model.effects for c in e.coefficients.values()}
    core = outside(model, expand_phi(model.core.xreplace(none), model.input))
    own = {s.left.base.name for s in model.states}
    inner = [s for s in samples(core) if s.base.name in own]
    if inner:
        raise ModelError(
            f"There is no linear part: the model depends on the internal state {inner[0].base.name}. A differential "
            "equation is only derived if the linear part contains nothing but inputs and outputs."
        )
    tangent = {s: derivative(core, s) for s in samples(core) if s.base in (model.input, model.output)}
    at_rest = {s: held(c, lambda _: sp.S.Zero) for s, c in tangent.items()}
    a = {lag(s): c for s, c in at_rest.items() if s.base == model.output and c != 0}
    b = {lag(s): c for s, c in at_rest.items() if s.base == model.input and c != 0}
    total = float(sp.Add(*b.values()).xreplace(model.values)) if b else 0.0
    if not isfinite(total) or total == 0:
        raise ModelError("There is no linear part: a steady input does not act on the output at the operating point.")
    linear = not any(samples(c) for c in tangent.values())
    listed = [sp.sympify(a.get(i, 0)).xreplace(model.values) for i in range(1, max(a, default=0) + 1)]
    poles, integrators = _poles(listed)
    named = {sp.Symbol(f"p_{i}"): p for i, p in enumerate(poles, 1)}
    delayed = tuple(s for s, p in named.items() if sp.im(p) == 0 and p <= 0)
    for s in delayed:
        if named[s] <= -FADES:
            raise ModelError(
                f"There is no differential equation with the pole {float(named[s]):.4g}: it alternates from sample "
                "to sample, which is impossible in continuous time. Fit fewer lags of the output, or a record at a "
                "higher rate."
            )
    constant = held(core, lambda _: sp.S.Zero)
    return Linear(a, b, constant, named, integrators, delayed, linear, sp.Float(model.Ts))


def _poles(a: Sequence[Any]) -> tuple[list[Any], int]:
    """Return the poles of y[k] = a[0] y[k-1] + ..., the slowest first, and how many more are at 1."""
    coefficients = [sp.S.One, *(-sp.Float(c, PRECISION) for c in a)]
    while len(coefficients) > 1 and coefficients[-1] == 0:
        coefficients.pop()
    ones = 0
    while len(coefficients) > 1 and abs(sum(coefficients)) < ROUNDED * sum(map(abs, coefficients)):
        quotient = [coefficients[0]]
        for c in coefficients[1:-1]:
            quotient.append(quotient[-1] + c)
        coefficients, ones = quotient, ones + 1
    if len(coefficients) == 1:
        return [], ones
    z = sp.Dummy("z")
    try:
        found = sp.Poly(coefficients, z).nroots(n=PRECISION, maxsteps=500)
    except NoConvergence:
        raise ModelError("The poles of the model cannot be distinguished: fit fewer lags of the output.") from None
    return sorted(found, key=lambda p: (float(abs(sp.log(p))) if p != 0 else float("inf"), -float(sp.im(p)))), ones


# -- from the recursion to the differential equation -----------------------------------------------------------


@dataclass(frozen=True)
class Transfer:
    """How the input reaches the output.

    Attributes
    ----------
    delay : expression
        The dead time [s].
    lead : expression
        Time constant of (1 + lead s) in the numerator [s]; None without one.
    exact : bool
        Whether a held input makes exactly this recursion of the differential equation.
    reason : str
        Why not.
    """

    delay: Any
    lead: Any
    exact: bool
    reason: str = ""


def transfer(linear: Linear, values: Mapping[Any, Any]) -> Transfer:
    """Return the dead time, and the lead where the numerator has one.

    Exact where the coefficients of the input are as many as a held input makes. Else the delay is that of slow motion:
    the mean lag of B, less that which the poles alone give a held input.
    """
    n, first, last = linear.order, min(linear.b), max(linear.b)
    span, Ts = last - first + 1, linear.Ts
    mean = sp.Add(*(i * c for i, c in linear.b.items())) / linear.B
    faded = sp.Add(*(p / (1 - p) for p in linear.delayed))
    if n == 0:
        return Transfer((mean + faded) * Ts, None, span == 1 and not linear.delayed, _several(span))
    simple = linear.integrators < 2 and len({complex(p) for p in linear.poles.values()}) == len(linear.poles)
    if linear.delayed:
        said = "a pole that is not positive decays within a few samples and is treated as a delay"
        return Transfer((mean + faded - _held_lag(linear, simple)) * Ts, None, False, said)
    if first >= 1 and span <= n and simple:
        lead = _lead(linear, first) if n == 2 else None
        said = "the zeros of the transfer function are left out" if n > 2 else ""
        return Transfer((first - 1) * Ts, lead, n <= 2, said)
    if n == 1 and first >= 1 and span == 2 and linear.lasting:  # a dead time between two samples
        (p,), share = linear.lasting, linear.b[first] / linear.B
        if 0 < linear.real(share, values) < 1:
            return Transfer((first - sp.log(1 - share * (1 - p)) / sp.log(p)) * Ts, None, True)
    said = "the input acts at once, which is impossible with a zero-order hold" if first == 0 else _several(span)
    return Transfer((mean - _held_lag(linear, simple)) * Ts, None, False, said)


def _several(span: int) -> str:
    said = f"{span} samples of the input act, more than a zero-order hold explains; they are treated as a delay"
    return said if span > 1 else ""


def _residues(linear: Linear) -> dict[Any, tuple[Any, Any]]:
    """Return (p, s) of each pole, also of that at 1."""
    found = {p: (p, s) for p, s in linear.s.items()}
    return found | ({sp.S.One: (sp.S.One, sp.S.Zero)} if linear.integrators else {})


def _lead(linear: Linear, first: int) -> Any:
    """Return the time constant of the zero of a second-order differential equation, from its residues."""
    (p, s), (q, z) = _residues(linear).values()
    one, two = linear.b.get(first, sp.S.Zero), linear.b.get(first + 1, sp.S.Zero)

    def residue(own: Any, exponent: Any, other: Any) -> Any:
        factor = 1 / linear.Ts if exponent == 0 else exponent / (own - 1)
        return (one * own + two) / (own - other) * factor

    left, right = residue(p, s, q), residue(q, z, p)
    return (left + right) / -(left * z + right * s)


def _held_lag(linear: Linear, simple: bool) -> Any:
    """Return the mean lag [samples] of B of a differential equation without zeros whose input is held."""
    n = linear.order
    if not simple or n > 3:  # of poles near 1
        return sp.Rational(n + 1, 2)
    z, pairs = sp.Dummy("z"), list(_residues(linear).values())
    P = sp.S.Zero
    for p, s in pairs:
        others = [q for q in pairs if q[0] != p]
        step = linear.Ts if s == 0 else (p - 1) / s
        P += step / sp.Mul(*(s - w for _, w in others)) * sp.Mul(*(z - q for q, _ in others))
    return n - (sp.diff(P, z) / P).subs(z, 1)


@dataclass(frozen=True)
class Row:
    """A quantity before its numbers: what it is called, its expression and its unit."""

    name: str
    symbol: str
    expression: Any
    unit: Unit
    effect: str = ""
    main: bool = True  # whether the short text tells it


def linear_rows(linear: Linear, way: Transfer, direction: int, values: Mapping[Any, Any]) -> list[Row]:
    """Return the quantities of the linear part."""
    rows, second = [], Unit(s=1)
    mass = _moving(linear, values)
    told = mass is not None and (linear.integrators > 0 or any(sp.im(p) != 0 for p in linear.poles.values()))
    forces = (("mass", "m", Unit(1, -1, 2)), ("viscous friction", "d", Unit(1, -1, 1)), ("stiffness", "k", Unit(1, -1)))
    for (name, symbol, per), e in zip(forces, mass or (), strict=False):
        rows += [Row(name, symbol, e * direction, per, main=told)] if e != 0 else []
    unit = Unit(y=1, s=-linear.integrators, input=-1)
    kind = {0: "gain", 1: "integrator gain"}.get(linear.integrators, f"gain of {linear.integrators} integrators")
    rows.append(Row(kind, "K", linear.gain, unit, main=not told))
    rows += _modes(linear, told)
    if way.lead is not None:
        slow = abs(linear.real(way.lead, values)) > float(linear.Ts)
        rows.append(Row("lead of the input", "T_z", way.lead, second, main=slow))
    if linear.real(way.delay, values) > 0:
        rows.append(Row("dead time", "T_d", way.delay, second))
    return rows


def _modes(linear: Linear, told: bool) -> list[Row]:
    """Return time constants, natural frequencies and damping ratios, the slowest first."""
    rows: list[Row] = []
    s, real = linear.s, [p for p in linear.lasting if sp.im(linear.poles[p]) == 0]
    swinging = [p for p in linear.lasting if p not in real]
    pairs = [*zip(swinging[::2], swinging[1::2], strict=True)]  # equally slow: each stands beside its conjugate
    for i, p in enumerate(real, 1):
        number = f"_{i}" if len(real) > 1 else ""
        rows.append(Row("time constant", f"tau{number}", -1 / s[p], Unit(s=1), main=not told))
    oscillating: list[Any] = [*pairs, *([real] if len(real) == linear.order == 2 else [])]
    for i, (p, q) in enumerate(oscillating, 1):
        number, omega = f"_{i}" if len(oscillating) > 1 else "", sp.sqrt(s[p] * s[q])
        main = (p, q) in pairs
        rows.append(Row("natural frequency", f"f_0{number}", omega / (2 * sp.pi), Unit(said="Hz"), main=main))
        rows.append(Row("damping ratio", f"zeta{number}", -(s[p] + s[q]) / (2 * omega), Unit(), main=main))
    return rows


def _moving(linear: Linear, values: Mapping[Any, Any]) -> tuple[Any, Any, Any] | None:
    """Return mass, viscous friction and stiffness per unit of the input, of two poles; the others lag before the mass.

    None where there are fewer poles, or where the others are not much faster.
    """
    r, s = linear.integrators, linear.s
    if r > 2 or linear.order < 2:
        return None
    own, others = linear.lasting[: 2 - r], linear.lasting[2 - r :]
    speed = {p: float(abs(linear.number(s[p], values))) for p in linear.lasting}
    if own and others and min(speed[p] for p in others) < APART * max(speed[p] for p in own):
        return None
    inverse = 1 / linear.gain
    if r == 2:
        return inverse, sp.S.Zero, sp.S.Zero
    if r == 1:
        return -inverse / s[own[0]], inverse, sp.S.Zero
    p, q = (s[e] for e in own)
    return inverse / (p * q), -inverse * (p + q) / (p * q), inverse


# -- the object ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Continuous(InLatex):
    """A model as a differential equation, with its quantities in physical units.

    Attributes
    ----------
    equation : Eq
        In y(t) and u(t), measured from zero, and the symbols of the quantities.
    quantities : tuple of Quantity
    exact : bool
        Whether a held input makes exactly the linear part of the model of it.
    notes : tuple of str
        What is an approximation, and why; what stands beside the equation.
    poles : mapping from p_1, p_2, ..., which expressions of quantities speak of, to their values
    """

    equation: Any
    quantities: tuple[Quantity, ...]
    exact: bool
    notes: tuple[str, ...] = ()
    poles: Mapping[Any, complex] = field(default_factory=dict)
    main: frozenset[str] = frozenset()  # symbols of the quantities that the text tells

    def __getitem__(self, name: str) -> Quantity:
        """Return a quantity by its name or symbol.

        Raises
        ------
        ModelError
            Where there is none.
        """
        for one in self.quantities:
            if name in (one.name, str(one.symbol)):
                return one
        raise ModelError(f"There is no quantity {name!r}; there are {', '.join(q.name for q in self.quantities)}.")

    @property
    def text(self) -> str:
        """One line: what matters first, effects before the linear part."""
        return "; ".join(q.text for q in sorted(self.told, key=lambda q: not q.effect))

    @property
    def told(self) -> list[Quantity]:
        """The quantities that matter: those of the text, in the order of the equation."""
        return [q for q in self.quantities if str(q.symbol) in self.main]

    @property
    def rows(self) -> list[tuple[str, str]]:
        """The symbol of every quantity in the equation, and its text."""
        return [(str(q.symbol), q.text) for q in self.quantities]

    def latex(self) -> str:
        """LaTeX of the equation and of the values below it."""
        rows = [rf"{latex(q.symbol)} &= {_latex_value(q)}" for q in self.quantities]
        left, right = latex(self.equation.lhs), latex(self.equation.rhs)
        shown = " \\\\\n".join([rf"{left} &= {right}", *rows])
        return f"\\begin{{aligned}}\n{shown}\n\\end{{aligned}}"

    def __repr__(self) -> str:
        return f"Continuous({self.text})"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""
        return {
            "equation": latex(self.equation), "exact": self.exact, "notes": list(self.notes),
            "quantities": [q.to_dict() for q in self.quantities],
        }  # fmt: skip


def _latex_value(one: Quantity) -> str:
    digits = _digits(one.value, one.error)
    value = _latex_number(one.value, digits)
    shown = rf"{value} \pm {_latex_number(NORMAL * one.error, 2)}" if one.error > 0 else value
    raised = {"²": "^2", "³": "^3", "⁴": "^4", "%": r"\%", " ": r"\,", "·": r"\,", "_": r"\_"}
    unit = "".join(raised.get(c, c) for c in one.unit)
    return (f"({shown})" if one.error > 0 and unit else shown) + (rf"\,\mathrm{{{unit}}}" if unit else "")


def _latex_number(value: float, digits: int) -> str:
    mantissa, _, exponent = number(value, digits).partition("e")
    return rf"{mantissa} \times 10^{{{int(exponent)}}}" if exponent else mantissa


def quantity(row: Row, linear: Linear, model: Model, labels: Mapping[str, str], factor: float) -> Quantity:
    """Return a row with its number.

    Parameters
    ----------
    labels : mapping from "force", "u" and "y" to their units
    factor : float
        Force per unit of the input.
    """
    value = linear.real(row.expression, model.values)
    power = factor**row.unit.force
    pure_force = row.unit.force == 1 and not (row.unit.y or row.unit.s) and labels["force"] != labels["u"]
    expression = sp.sympify(row.expression) * (sp.Float(power) if power != 1 else 1)
    return Quantity(
        row.name, sp.Symbol(row.symbol), expression, power * value,
        unit=row.unit.text(labels), in_input=value if pure_force else None, input_unit=labels["u"] * pure_force,
        effect=row.effect,
    )  # fmt: skip


def with_errors(found: Continuous, linear: Linear, model: Model, covariance: Any) -> Continuous:
    """Return it with standard errors by the delta method.

    Parameters
    ----------
    covariance : (n_theta, n_theta) nested sequence, in the order of the model's symbols
    """
    n, made = len(model.symbols), []
    for one in found.quantities:
        slopes = linear.derivatives(one.expression, model.symbols, model.values)
        known = [i for i in range(n) if slopes[i]]
        variance = sum(slopes[i] * slopes[j] * float(covariance[i][j]) for i in known for j in known)
        made.append(replace(one, error=variance**0.5 if variance >= 0 else float("nan")))
    return replace(found, quantities=tuple(made))


def equation_of(linear: Linear, way: Transfer, rows: Sequence[Row], terms: Any, scaled: bool) -> Any:
    """Return the differential equation in the symbols of the quantities.

    Parameters
    ----------
    terms : expression
        What effects put beside the input, in y(t) and its derivative [unit of the force].
    scaled : bool
        Whether forces have another unit than the input: the input then stands with the factor g.
    """
    y, u = sp.Function("y")(TIME), sp.Function("u")
    known = {row.symbol: sp.Symbol(row.symbol) for row in rows}
    arrived = u(TIME - known["T_d"]) if "T_d" in known else u(TIME)
    if "T_z" in known:
        arrived += known["T_z"] * sp.Derivative(arrived, TIME)
    arrived += known.get("u_0", 0)
    others = linear.lasting[2 - linear.integrators :]
    if "m" in known and not others:
        left = known["m"] * sp.Derivative(y, (TIME, 2)) + known.get("d", 0) * sp.Derivative(y, TIME)
        left += known.get("k", 0) * y
        return sp.Eq(left + terms, (sp.Symbol("g") if scaled else 1) * arrived, evaluate=False)
    D, s = sp.S.One, sp.Dummy("s")
    for row in rows:
        if row.symbol.startswith("tau") and not row.effect:
            D *= known[row.symbol] * s + 1
        if row.symbol.startswith("f_0") and not (linear.order == 2 and "tau_1" in known):
            omega, zeta = 2 * sp.pi * known[row.symbol], known[row.symbol.replace("f_0", "zeta")]
            D *= (s / omega) ** 2 + 2 * zeta / omega * s + 1
    powers = sp.Poly(sp.expand(D) * s**linear.integrators, s).all_coeffs()[::-1]
    left = sp.Add(*(c * (sp.Derivative(y, (TIME, i)) if i else y) for i, c in enumerate(powers)))
    force = terms / sp.Symbol("g") if scaled else terms
    return sp.Eq(left, known["K"] * (arrived - force), evaluate=False)
