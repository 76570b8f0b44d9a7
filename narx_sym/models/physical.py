"""Effects of a model in physical form: forces at the input, speeds per second, widths and times.

What an effect adds inside the recursion, c z[k], is the force c z / B(1) beside the input, since a steady input u adds
B(1) u. Friction, drag and springs count against the motion, so that what resists is positive. A friction that holds a
step r of the motion (y[k] = y[k-1] + soft(d, r)) is the force r / B(1). Steps are speeds times Ts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import sympy as sp

from ..symbolic.signals import INNER_INPUTS, samples
from .added import AddedEffect
from .continuous_time import TIME, Linear, Row, Unit
from .effects import Effect
from .extend import form_of
from .model import Model

Y = sp.Function("y")(TIME)
SPEED = sp.Derivative(Y, TIME)
MOVING = ("inside", "force", "motion")  # places where an effect is a force on what moves


@dataclass(frozen=True, eq=False)
class Subject:
    """An effect in a model, and what its force is measured by.

    Attributes
    ----------
    direction : 1, or -1 where a positive input moves the output down
    number : str
        What the symbols of a second effect of one kind end in.
    """

    added: AddedEffect
    effect: Effect | None
    model: Model
    linear: Linear
    direction: int
    number: str = ""

    @property
    def of_speed(self) -> bool:
        """Whether the output is the speed of what moves."""
        return "of a speed" in self.added.form

    @property
    def Ts(self) -> Any:
        """What turns a step into a speed: 1 where the output is the speed."""
        return sp.S.One if self.of_speed else self.linear.Ts

    @property
    def c(self) -> Any:
        """The coefficient; 1 where the whole effect acts."""
        return self.added.coefficients.get("c", sp.S.One)

    def shape(self, name: str) -> Any:
        """Return a shape parameter."""
        return self.added.shape[name]

    def force(self, expr: Any) -> Any:
        """Return what a contribution is as a force along the input's, positive upwards."""
        B = self.direction * self.linear.B
        return self.direction * expr if self.added.where == "force" else expr / B

    def row(self, name: str, symbol: str, expr: Any, unit: Unit, main: bool = True) -> Row:
        """Return a quantity of this effect."""
        return Row(name, symbol + self.number, expr, unit, self.added.effect, main)

    def generic(self, name: str) -> Row:
        """Return a shape parameter in its own unit, with seconds in the place of samples."""
        symbol = self.added.shape[name] if name in self.added.shape else sp.Integer(self.added.fixed[name])
        said = (self.effect.unit.get(name, "") if self.effect else "").removeprefix("1") or ""
        of = self.added.effect.partition(":")[0].replace("_", " ")
        named = f"{name} of the {of}"
        if said == "samples":
            return self.row(named, f"T_{name}", symbol * self.linear.Ts, Unit(s=1), main=False)
        unit, expr = _unit(said.removesuffix(" per sample"), self.added), symbol
        if said.endswith(" per sample"):
            expr = symbol / self.linear.Ts
            unit = Unit(y=unit.y, input=unit.input, s=-1) if not unit.said else Unit(said=f"{unit.said}/s")
        return self.row(named, f"{name}_{of.replace(' ', '_')}", expr, unit, main=False)


def _unit(said: str, added: AddedEffect) -> Unit:
    """Return what the catalogue says about the unit of a shape parameter."""
    driver = {"u": Unit(input=1), "y": Unit(y=1)}.get(added.driver)
    known: dict[str, Unit] = {
        "": Unit(), "s": Unit(s=1), "Hz": Unit(said="Hz"), "unit of u": Unit(input=1), "unit of y": Unit(y=1),
        "unit of y / unit of u": Unit(y=1, input=-1),
    }  # fmt: skip
    if driver is not None:
        known |= {
            "unit of the driver": driver, "unit of the driver times s": Unit(input=driver.input, y=driver.y, s=1),
            "1 / unit of the driver": Unit(input=-driver.input, y=-driver.y),
            " / unit of the driver": Unit(input=-driver.input, y=-driver.y),
        }  # fmt: skip
    return known.get(said, Unit(said=said))


@dataclass(frozen=True)
class Found:
    """What an effect is in physical form.

    Attributes
    ----------
    rows : list of Row
    term : expression in y(t) and its derivative, in the symbols of the rows [force]; what stands against the motion
    told : names of the parameters that the rows tell; others follow with their own units
    note : what stands in front of the equation or behind it, in words
    """

    rows: list[Row]
    term: Any = sp.S.Zero
    told: tuple[str, ...] = ("c",)
    note: str = ""


RULES: dict[str, Callable[[Subject], Found | None]] = {}


def rule(*ids: str) -> Callable[[Callable[[Subject], Found | None]], Callable[[Subject], Found | None]]:
    """Register how effects of some ids are told; None where a form or place has no physical form here."""

    def register(of: Callable[[Subject], Found | None]) -> Callable[[Subject], Found | None]:
        RULES.update(dict.fromkeys(ids, of))
        return of

    return register


# -- forces on what moves --------------------------------------------------------------------------------------


def _side(subject: Subject) -> Any:
    """Return the direction of the motion."""
    return sp.sign(Y if subject.of_speed else SPEED)


@rule("coulomb_friction")
def coulomb(subject: Subject) -> Found | None:
    """Tell friction of constant size: a force, or a part of an output that is a force."""
    added, symbol = subject.added, sp.Symbol("F_C" + subject.number)
    told: tuple[str, ...] = ("c",)
    if added.where == "output" and added.driver == "u":
        if added.form == "viscoelastic":  # its spring is stretched so far at most, either way
            ends = {"up": ("r", "F_u"), "down": ("e", "F_d")}
            return Found(
                [
                    subject.row(f"Coulomb friction {n}", f, subject.c * subject.shape(p), Unit(y=1))
                    for n, (p, f) in ends.items()
                ],
                told=("c", "r", "e"),
            )
        taken = sp.Add(*(e.coefficients.get("c", 1) * e.shape["w"] for e in _slacks(subject.model, added)))
        return Found([subject.row("Coulomb friction", "F_C", subject.c * (1 - taken), Unit(y=1))])
    if added.where == "motion":
        size, told = subject.force(subject.c * subject.shape("r")), ("c", "r")
    elif added.where in MOVING:
        size = -subject.force(subject.c)
    else:
        return None
    rows = [subject.row("Coulomb friction", "F_C", size, Unit(1))]
    if "s" in added.shape and added.form.startswith("smooth"):
        unit = Unit(y=1) if subject.of_speed else Unit(y=1, s=-1)
        rows.append(
            subject.row("speed at which friction is reached", "v_C", subject.shape("s") / subject.Ts, unit, False)
        )
        return Found(
            rows, symbol * sp.tanh((Y if subject.of_speed else SPEED) / sp.Symbol("v_C" + subject.number)), ("c", "s")
        )
    if "r" in added.shape and "Dahl" in added.form:
        unit = Unit(y=1, s=1) if subject.of_speed else Unit(y=1)
        rows.append(subject.row("way over which friction turns round", "x_C", subject.shape("r"), unit, False))
        told = ("c", "r")
    return Found(rows, symbol * _side(subject), told)


def _slacks(model: Model, friction: AddedEffect) -> list[AddedEffect]:
    """Return the slacks behind an elastic friction: near none of its force, a share w of it is not passed on."""
    return [e for e in model.effects if e.where == "friction" and "w" in e.shape and friction.form == "elastic"]


@rule("stiction")
def stiction(subject: Subject) -> Found | None:
    """Tell friction that holds: on the move, and to break loose."""
    if subject.added.where != "motion":
        return None
    moving, more = (subject.force(subject.c * subject.shape(n)) for n in ("r", "e"))
    rows = [subject.row("Coulomb friction", "F_C", moving, Unit(1))]
    rows.append(subject.row("breakaway friction", "F_S", moving + more, Unit(1)))
    return Found(rows, sp.Symbol("F_C" + subject.number) * _side(subject), ("c", "r", "e"))


@rule("stribeck_friction")
def stribeck(subject: Subject) -> Found | None:
    """Tell friction at rest beyond that of motion, and the speed at which it is gone."""
    if subject.added.where not in MOVING:
        return None
    size, slow = sp.Symbol("F_S" + subject.number), sp.Symbol("v_S" + subject.number)
    rows = [subject.row("Stribeck friction", "F_S", -subject.force(subject.c), Unit(1))]
    rows.append(subject.row("Stribeck speed", "v_S", subject.shape("s") / subject.linear.Ts, Unit(y=1, s=-1)))
    return Found(rows, size * sp.exp(-((SPEED / slow) ** 2)) * sp.sign(SPEED), ("c", "s"))


@rule("channel_friction")
def loaded(subject: Subject) -> Found | None:
    """Tell friction that grows with a channel: its part without it, and its slope."""
    added = subject.added
    if added.where not in MOVING:
        return None
    names, sign = (("r", "q"), 1) if added.where == "motion" else (("c1", "c2"), -1)
    symbols = [added.symbols.get(n, sp.S.Zero) for n in names]
    if added.where == "motion":
        symbols = [subject.c * s for s in symbols]
    constant, slope = (sign * subject.force(s) for s in symbols)
    channel = added.effect.partition(":")[2]
    rows = [subject.row("Coulomb friction", "F_C", constant, Unit(1))]
    per = subject.row(f"Coulomb friction per {channel}", "F_q", slope, Unit(1))
    return Found([*rows, per], told=("c", *names), note=f"friction is F_C + F_q {channel}")


@rule("quadratic_drag")
def drag(subject: Subject) -> Found | None:
    """Tell drag with the square of the speed."""
    if subject.added.where not in MOVING:
        return None
    unit, way = (Unit(1, -2), Y) if subject.of_speed else (Unit(1, -2, 2), SPEED)
    size = -subject.force(subject.c) * subject.Ts**2
    return Found([subject.row("quadratic drag", "D", size, unit)], sp.Symbol("D" + subject.number) * way * sp.Abs(way))


@rule("uneven_speed")
def uneven(subject: Subject) -> Found | None:
    """Tell how much larger viscous friction is down than up: a step s < 0 becomes (1 + c) s."""
    more = -subject.c / (1 + subject.c) * subject.linear.Ts / (subject.direction * subject.linear.B)
    name = "further viscous friction while the output falls"
    symbol = sp.Symbol("d_f" + subject.number)
    return Found([subject.row(name, "d_f", more, Unit(1, -1, 1))], symbol * sp.Min(SPEED, 0))


@rule("hardening_spring")
def cubic(subject: Subject) -> Found:
    """Tell a spring force with the cube of the deflection."""
    return _spring(subject, 3, "cubic stiffness", "k_3")


@rule("quadratic_spring")
def square(subject: Subject) -> Found:
    """Tell a spring force with the square of the deflection."""
    return _spring(subject, 2, "quadratic stiffness", "k_2")


def _spring(subject: Subject, power: int, name: str, symbol: str) -> Found:
    around = _around(subject.model, "y")
    deflection = Y - sp.Symbol("y_0") if around else Y
    rows = [subject.row(name, symbol, -subject.force(subject.c), Unit(1, -power))]
    return Found(rows, sp.Symbol(symbol + subject.number) * deflection**power, note=_from("y", around))


@rule("offset")
def offset(subject: Subject) -> Found:
    """Tell a constant load, or a constant of the sensor."""
    if subject.added.where == "inside":
        return Found(
            [subject.row("constant load", "F_0", -subject.force(subject.c), Unit(1))], sp.Symbol("F_0" + subject.number)
        )
    return Found([subject.row("offset of the output", "y_c", subject.c, Unit(y=1))])


@rule("end_stop")
def stops(subject: Subject) -> Found | None:
    """Tell where the stops are, and how stiff."""
    added, rigid, zero = subject.added, "rigid" in subject.added.form, _around(subject.model, "y")
    ends = {"upper": ("r",), "lower": ("e",)}
    rows = []
    if "both" not in added.form:
        upper = "upper" in added.form
        at = zero + subject.shape("r") * (1 if upper else -1)
        rows.append(subject.row(f"{'upper' if upper else 'lower'} end stop", "y_s", at, Unit(y=1)))
    elif rigid:
        for name, (shape,) in ends.items():
            at = zero + subject.shape(shape) * (1 if name == "upper" else -1)
            rows.append(subject.row(f"{name} end stop", f"y_{name[0]}", at, Unit(y=1)))
    else:
        rows.append(subject.row("half-width of the gap between the end stops", "y_s", subject.shape("r"), Unit(y=1)))
    if rigid:
        return Found([*rows, *_share(subject)], told=("c", "r", "e"))
    stiff = subject.force(subject.c)
    return Found([*rows, subject.row("stiffness of the end stop", "k_s", stiff, Unit(1, -1))], told=("c", "r"))


# -- what acts before or behind ----------------------------------------------------------------------------------


def _width(subject: Subject, name: str, symbol: str, shape: str = "r") -> Row:
    """Return a shape parameter in the unit of its driver."""
    unit = Unit(y=1) if subject.added.where == "output" else Unit(input=1)
    return subject.row(name, symbol, subject.shape(shape), unit)


def _share(subject: Subject) -> list[Row]:
    """Return how much of the whole effect acts, where that is a parameter."""
    if not (subject.added.full and "c" in subject.added.coefficients):
        return []
    of = subject.added.effect.replace("_", " ")
    return [subject.row(f"share of the {of}", "share", subject.c, Unit(), main=False)]


@rule("backlash")
def backlash(subject: Subject) -> Found | None:
    """Tell half the width of the play."""
    if subject.added.where == "friction":  # a way of r takes an elastic friction from none of its force to all
        rubs = next(e for e in subject.model.effects if e.effect == "coulomb_friction" and e.form == "elastic")
        width = subject.shape("w") * rubs.shape["r"]
        rows = [subject.row("half-width of the slack", "r_b", width, Unit(input=1))]
        return Found([*rows, *_share(subject)], told=("c", "w"))
    if subject.added.where not in ("input", "output", "inside"):
        return None
    rows = [_width(subject, "half-width of the play", "r_b")]
    if subject.added.where == "inside":  # an elastic shaft
        return Found([*rows, subject.generic("d")], told=("r", "d"))
    return Found([*rows, *_share(subject)], told=("c", "r"), note=_before(subject, "play"))


@rule("saturation")
def saturation(subject: Subject) -> Found:
    """Tell where the input is limited."""
    zero = 0.0 if _raw(subject) else _around(subject.model, "u")
    if "e" not in subject.added.shape:
        rows = [_width(subject, "limit of the saturation", "u_s")]
        said = f" on either side of u = {zero:.6g}" if zero else ""
        return Found([*rows, *_share(subject)], told=("c", "r"), note=_before(subject, "saturation") + said)
    high, low = zero + subject.shape("r"), zero - subject.shape("e")
    rows = [subject.row("upper limit of the saturation", "u_u", high, Unit(input=1))]
    rows.append(subject.row("lower limit of the saturation", "u_l", low, Unit(input=1)))
    return Found([*rows, *_share(subject)], told=("c", "r", "e"), note=_before(subject, "saturation"))


@rule("dead_zone")
def dead_zone(subject: Subject) -> Found:
    """Tell half the width of the dead zone."""
    zero = 0.0 if _raw(subject) else _around(subject.model, "u")
    said = f" around u = {zero:.6g}" if zero else ""
    rows = [_width(subject, "half-width of the dead zone", "u_d"), *_share(subject)]
    return Found(rows, told=("c", "r"), note=_before(subject, "dead zone") + said)


@rule("creep")
def creep(subject: Subject) -> Found:
    """Tell its time constants tau, 3 tau and 9 tau, and its share."""
    rows = [subject.row("shortest time constant of creep", "tau_c", subject.shape("tau"), Unit(s=1))]
    rows.append(subject.row("share of creep", "c_c", subject.c, Unit()))
    return Found(rows, told=("c", "tau"), note="creep has three time constants, tau_c, 3 tau_c and 9 tau_c")


@rule("rate_dependence")
def actuator_lag(subject: Subject) -> Found:
    """Tell a lag before the actuator."""
    rows = [subject.row("time constant of the actuator", "tau_a", subject.shape("tau"), Unit(s=1))]
    return Found([*rows, *_share(subject)], told=("c", "tau"), note=_before(subject, "lag"))


@rule("input_delay")
def later(subject: Subject) -> Found:
    """Tell a further dead time."""
    samples_ = sp.Integer(subject.added.fixed["d"])
    rows = [subject.row("further dead time", "T_a", samples_ * subject.linear.Ts, Unit(s=1)), *_share(subject)]
    return Found(rows, told=("c", "d"), note=_before(subject, "dead time"))


@rule("rate_limit")
def rate_limit(subject: Subject) -> Found:
    """Tell limits of the actuator's speed."""
    names = {"r": "limit of speed upwards", "e": "limit of speed downwards"}
    own = names if "e" in subject.added.shape else {"r": "limit of speed"}
    rows = [
        subject.row(name, f"v_{shape}", subject.shape(shape) / subject.linear.Ts, Unit(input=1, s=-1))
        for shape, name in own.items()
    ]
    return Found([*rows, *_share(subject)], told=("c", *own), note=_before(subject, "limit of speed"))


def _before(subject: Subject, what: str) -> str:
    """Say where an effect stands that is no force."""
    return {"input": f"u is the input after the {what}", "output": f"y is the output before the {what}"}.get(
        subject.added.where, ""
    )


def _around(model: Model, name: str) -> float:
    return float(model.operating_point.get(model.output if name == "y" else model.input, 0.0))


def _from(name: str, value: float) -> str:
    return f"deflections are measured from {name}_0 = {value:.6g}" if value else ""


def _raw(subject: Subject) -> bool:
    """Whether an effect at the input measures it from zero, and not from the operating point."""
    point, brought = _around(subject.model, "u"), set(subject.added.symbols.values())
    if not point:
        return True
    bases = {subject.model.input, *INNER_INPUTS}
    sums = (
        part
        for state in subject.model.states
        if state.right.free_symbols & brought or state.group == subject.added.group
        for part in state.right.atoms(sp.Add)
    )
    return any(
        any(a.is_Float and abs(float(a) - point) < 1e-9 * abs(point) for a in part.args)
        and any(s.base in bases for s in samples(part))
        for part in sums
    )


# -- all of them -----------------------------------------------------------------------------------------------


def effect_rows(
    model: Model, linear: Linear, direction: int, units: Mapping[str, str]
) -> tuple[list[Row], Any, list[str]]:
    """Return the quantities of all effects, what they put into the equation, and what is to be said beside.

    Parameters
    ----------
    units : mapping from names of parameters to their units, where these follow, for those without a physical form
    """
    rows: list[Row] = []
    term, notes, seen = sp.S.Zero, [], dict[str, int]()
    for added in model.effects:
        kind = added.effect.partition(":")[0]
        seen[kind] = seen.get(kind, 0) + 1
        subject = Subject(added, form_of(added), model, linear, direction, str(seen[kind]) if seen[kind] > 1 else "")
        found = RULES[kind](subject) if kind in RULES and not _incomplete(subject) else None
        if found is None:
            found = Found(
                [], told=(), note=f"{kind.replace('_', ' ')} has no physical form here: its model parameters are given"
            )
        taken = {row.symbol for row in rows}
        if any(row.symbol in taken for row in found.rows):  # another effect has this name
            end = f"_{len(rows)}"
            term += found.term.xreplace({sp.Symbol(r.symbol): sp.Symbol(r.symbol + end) for r in found.rows})
            rows += [Row(r.name, r.symbol + end, r.expression, r.unit, r.effect, r.main) for r in found.rows]
        else:
            term += found.term
            rows += found.rows
        rows += _others(subject, found.told, units)
        notes += [found.note] if found.note else []
    return rows, term, notes


def _incomplete(subject: Subject) -> bool:
    """Whether a shape parameter was put in as a number and is gone."""
    own = subject.effect
    return own is not None and any(p not in {**subject.added.shape, **subject.added.fixed} for p in own.shape)


def _others(subject: Subject, told: tuple[str, ...], units: Mapping[str, str]) -> list[Row]:
    """Return the parameters that no row tells, in their own units."""
    added = subject.added
    of = added.effect.partition(":")[0].replace("_", " ")
    rows = []
    for name, symbol in added.coefficients.items():
        if name not in told:
            unit = units.get(str(symbol), "")
            rows.append(
                subject.row(f"{name} of the {of}", str(symbol), symbol, Unit(said="" if unit == "1" else unit), False)
            )
    return rows + [subject.generic(n) for n in (*added.shape, *added.fixed) if n not in told]
