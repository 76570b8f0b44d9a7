"""Effects of a model in physical form: forces at the input, speeds per second, widths and times.

What an effect adds inside the recursion, c z[k], is the force c z / B(1) beside the input, since a steady input u adds
B(1) u. Friction, drag and springs count against the motion, so that what resists is positive. A friction that holds a
step r of the motion (y[k] = y[k-1] + soft(d, r)) is the force r / B(1). Steps are speeds times Ts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from ..symbolic.signals import INNER_INPUTS, samples
from .added import AddedEffect
from .continuous_time import TIME, Linear, Row, Unit
from .effects import PLACES, Effect
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

    @property
    def way(self) -> Any:
        """The speed of what moves, in the equation."""
        return Y if self.of_speed else SPEED

    def symbol(self, name: str) -> Any:
        """Return the symbol of one of its quantities in the equation."""
        return sp.Symbol(name + self.number)

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
            " / unit of the driver": Unit(input=-driver.input, y=-driver.y),
        }  # fmt: skip
    return known.get(said, Unit(said=said))


@dataclass(frozen=True)
class Found:
    """What an effect is in physical form.

    Attributes
    ----------
    rows : list of Row
        Parameters that stand in none of them follow with their own units.
    term : expression in y(t) and its derivative, in the symbols of the rows [force]; what stands against the motion
    note : what stands in front of the equation or behind it, in words
    """

    rows: list[Row]
    term: Any = sp.S.Zero
    note: str = ""


Told = Callable[[Subject], Found | None]
RULES: dict[str, Told] = {}


def rule(*ids: str, only: Collection[str] = PLACES) -> Callable[[Told], Told]:
    """Register how effects of some ids are told; None where a form or place has no physical form here."""

    def register(of: Told) -> Told:
        RULES.update(dict.fromkeys(ids, lambda subject: of(subject) if subject.added.where in only else None))
        return of

    return register


# -- forces on what moves --------------------------------------------------------------------------------------


@rule("coulomb_friction")
def coulomb(subject: Subject) -> Found | None:
    """Tell friction of constant size: a force, or a part of an output that is a force."""
    added, size = subject.added, subject.symbol("F_C")
    if added.where == "output" and added.driver == "u":
        if added.form == "viscoelastic":  # its spring is stretched so far at most, either way
            ends = {"up": ("r", "F_u"), "down": ("e", "F_d")}.items()
            sizes = {n: (f, subject.c * subject.shape(p)) for n, (p, f) in ends}
            return Found([subject.row(f"Coulomb friction {n}", f, e, Unit(y=1)) for n, (f, e) in sizes.items()])
        taken = sp.Add(*(e.coefficients.get("c", 1) * e.shape["w"] for e in _slacks(subject.model, added)))
        return Found([subject.row("Coulomb friction", "F_C", subject.c * (1 - taken), Unit(y=1))])
    if added.where not in MOVING:
        return None
    held = added.where == "motion"
    force = subject.force(subject.c * subject.shape("r")) if held else -subject.force(subject.c)
    rows = [subject.row("Coulomb friction", "F_C", force, Unit(1))]
    if "s" in added.shape and added.form.startswith("smooth"):
        unit = Unit(y=1) if subject.of_speed else Unit(y=1, s=-1)
        reached = subject.shape("s") / subject.Ts
        rows.append(subject.row("speed at which friction is reached", "v_C", reached, unit, False))
        return Found(rows, size * sp.tanh(subject.way / subject.symbol("v_C")))
    if "r" in added.shape and "Dahl" in added.form:
        unit = Unit(y=1, s=1) if subject.of_speed else Unit(y=1)
        rows.append(subject.row("way over which friction turns round", "x_C", subject.shape("r"), unit, False))
    return Found(rows, size * sp.sign(subject.way))


def _slacks(model: Model, friction: AddedEffect) -> list[AddedEffect]:
    """Return the slacks behind an elastic friction: near none of its force, a share w of it is not passed on."""
    return [e for e in model.effects if e.where == "friction" and "w" in e.shape and friction.form == "elastic"]


@rule("stiction", only=("motion",))
def stiction(subject: Subject) -> Found:
    """Tell friction that holds: on the move, and to break loose."""
    moving, more = (subject.force(subject.c * subject.shape(n)) for n in ("r", "e"))
    rows = [subject.row("Coulomb friction", "F_C", moving, Unit(1))]
    rows.append(subject.row("breakaway friction", "F_S", moving + more, Unit(1)))
    return Found(rows, subject.symbol("F_C") * sp.sign(subject.way))


@rule("stribeck_friction", only=MOVING)
def stribeck(subject: Subject) -> Found:
    """Tell friction at rest beyond that of motion, and the speed at which it is gone."""
    rows = [subject.row("Stribeck friction", "F_S", -subject.force(subject.c), Unit(1))]
    rows.append(subject.row("Stribeck speed", "v_S", subject.shape("s") / subject.linear.Ts, Unit(y=1, s=-1)))
    size, slow = subject.symbol("F_S"), subject.symbol("v_S")
    return Found(rows, size * sp.exp(-((SPEED / slow) ** 2)) * sp.sign(SPEED))


@rule("channel_friction", only=MOVING)
def loaded(subject: Subject) -> Found:
    """Tell friction that grows with a channel: its part without it, and its slope."""
    added, held = subject.added, subject.added.where == "motion"
    parts = (added.symbols.get(n, sp.S.Zero) for n in (("r", "q") if held else ("c1", "c2")))
    constant, slope = (subject.force(subject.c * e) if held else -subject.force(e) for e in parts)
    channel = added.effect.partition(":")[2]
    rows = [subject.row("Coulomb friction", "F_C", constant, Unit(1))]
    rows.append(subject.row(f"Coulomb friction per {channel}", "F_q", slope, Unit(1)))
    return Found(rows, note=f"friction is F_C + F_q {channel}")


@rule("quadratic_drag", only=MOVING)
def drag(subject: Subject) -> Found:
    """Tell drag with the square of the speed."""
    unit, way = Unit(1, -2) if subject.of_speed else Unit(1, -2, 2), subject.way
    size = -subject.force(subject.c) * subject.Ts**2
    return Found([subject.row("quadratic drag", "D", size, unit)], subject.symbol("D") * way * sp.Abs(way))


@rule("uneven_speed")
def uneven(subject: Subject) -> Found:
    """Tell how much larger viscous friction is down than up: a step s < 0 becomes (1 + c) s."""
    more = -subject.c / (1 + subject.c) * subject.linear.Ts / (subject.direction * subject.linear.B)
    name = "further viscous friction while the output falls"
    return Found([subject.row(name, "d_f", more, Unit(1, -1, 1))], subject.symbol("d_f") * sp.Min(SPEED, 0))


@rule("hardening_spring", "quadratic_spring")
def spring(subject: Subject) -> Found:
    """Tell a spring force with the cube or the square of the deflection."""
    power, name = (3, "cubic") if subject.added.effect == "hardening_spring" else (2, "quadratic")
    zero = _around(subject.model, "y")
    deflection, symbol = Y - sp.Symbol("y_0") if zero else Y, f"k_{power}"
    rows = [subject.row(f"{name} stiffness", symbol, -subject.force(subject.c), Unit(1, -power))]
    said = f"deflections are measured from y_0 = {zero:.6g}" if zero else ""
    return Found(rows, subject.symbol(symbol) * deflection**power, said)


@rule("offset")
def offset(subject: Subject) -> Found:
    """Tell a constant load, or a constant of the sensor."""
    if subject.added.where == "inside":
        load = subject.row("constant load", "F_0", -subject.force(subject.c), Unit(1))
        return Found([load], subject.symbol("F_0"))
    return Found([subject.row("offset of the output", "y_c", subject.c, Unit(y=1))])


@rule("end_stop")
def stops(subject: Subject) -> Found:
    """Tell where the stops are, and how stiff."""
    form, zero = subject.added.form, _around(subject.model, "y")
    if subject.added.where == "input":  # of what lies behind a first lag, in the unit of what drives it
        name, sign = ("lower", -1) if "lower" in form else ("upper", 1)
        at = _zero(subject) + sign * subject.shape("r")
        rows = [subject.row(f"{name} end stop of the first lag", "u_s", at, Unit(input=1))]
        rows.append(subject.row("time constant of the first lag", "tau_1", subject.shape("tau"), Unit(s=1)))
        return Found(rows, note=_before(subject, "first lag"))
    both, rigid = "both" in form, "rigid" in form
    if both and not rigid:
        rows = [subject.row("half-width of the gap between the end stops", "y_s", subject.shape("r"), Unit(y=1))]
    else:
        upper, lower = ("upper", 1, "r"), ("lower", -1, "e" if both else "r")
        rows = [
            subject.row(
                f"{name} end stop", f"y_{name[0]}" if both else "y_s", zero + sign * subject.shape(p), Unit(y=1)
            )
            for name, sign, p in ((upper, lower) if both else (upper,) if "upper" in form else (lower,))
        ]
    if not rigid:
        rows.append(subject.row("stiffness of the end stop", "k_s", subject.force(subject.c), Unit(1, -1)))
    return Found(rows)


# -- what acts before or behind ----------------------------------------------------------------------------------


def _width(subject: Subject, name: str, symbol: str) -> Row:
    """Return the width of an effect in the unit of its driver."""
    unit = Unit(y=1) if subject.added.where == "output" else Unit(input=1)
    return subject.row(name, symbol, subject.shape("r"), unit)


@rule("backlash")
def backlash(subject: Subject) -> Found:
    """Tell half the width of the play, or of the slack behind an elastic friction."""
    if subject.added.where == "friction":  # a way of r takes an elastic friction from none of its force to all
        rubs = next(e for e in subject.model.effects if e.effect == "coulomb_friction" and e.form == "elastic")
        width = subject.shape("w") * rubs.shape["r"]
        return Found([subject.row("half-width of the slack", "r_b", width, Unit(input=1))])
    rows = [_width(subject, "half-width of the play", "r_b")]
    if subject.added.where == "inside":  # an elastic shaft
        return Found([*rows, subject.generic("d")])
    return Found(rows, note=_before(subject, "play"))


@rule("saturation")
def saturation(subject: Subject) -> Found:
    """Tell where the input is limited."""
    zero = _zero(subject)
    if "e" not in subject.added.shape:
        said = f" on either side of u = {zero:.6g}" if zero else ""
        rows = [_width(subject, "limit of the saturation", "u_s")]
        return Found(rows, note=_before(subject, "saturation") + said)
    ends = (("upper", zero + subject.shape("r")), ("lower", zero - subject.shape("e")))
    rows = [subject.row(f"{n} limit of the saturation", f"u_{n[0]}", at, Unit(input=1)) for n, at in ends]
    return Found(rows, note=_before(subject, "saturation"))


@rule("dead_zone")
def dead_zone(subject: Subject) -> Found:
    """Tell half the width of the dead zone."""
    said = f" around u = {zero:.6g}" if (zero := _zero(subject)) else ""
    rows = [_width(subject, "half-width of the dead zone", "u_d")]
    return Found(rows, note=_before(subject, "dead zone") + said)


@rule("creep")
def creep(subject: Subject) -> Found:
    """Tell its time constants tau, 3 tau and 9 tau, and its share."""
    rows = [subject.row("shortest time constant of creep", "tau_c", subject.shape("tau"), Unit(s=1))]
    rows.append(subject.row("share of creep", "c_c", subject.c, Unit()))
    return Found(rows, note="creep has three time constants, tau_c, 3 tau_c and 9 tau_c")


@rule("rate_dependence")
def actuator_lag(subject: Subject) -> Found:
    """Tell a lag before the actuator."""
    rows = [subject.row("time constant of the actuator", "tau_a", subject.shape("tau"), Unit(s=1))]
    return Found(rows, note=_before(subject, "lag"))


@rule("input_delay")
def later(subject: Subject) -> Found:
    """Tell a further dead time."""
    time = subject.added.fixed["d"] * subject.linear.Ts
    return Found([subject.row("further dead time", "T_a", time, Unit(s=1))], note=_before(subject, "dead time"))


@rule("rate_limit")
def rate_limit(subject: Subject) -> Found:
    """Tell limits of the actuator's speed."""
    names = {"r": " upwards", "e": " downwards"} if "e" in subject.added.shape else {"r": ""}
    speeds = {n: (said, subject.shape(n) / subject.linear.Ts) for n, said in names.items()}
    unit = Unit(input=1, s=-1)
    rows = [subject.row(f"limit of speed{said}", f"v_{n}", speed, unit) for n, (said, speed) in speeds.items()]
    return Found(rows, note=_before(subject, "limit of speed"))


def _before(subject: Subject, what: str) -> str:
    """Say where an effect stands that is no force."""
    said = {"input": f"u is the input after the {what}", "output": f"y is the output before the {what}"}
    return said.get(subject.added.where, "")


def _around(model: Model, name: str) -> float:
    return float(model.operating_point.get(model.output if name == "y" else model.input, 0.0))


def _zero(subject: Subject) -> float:
    """Return from where an effect at the input measures it."""
    return 0.0 if _raw(subject) else _around(subject.model, "u")


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
                [], note=f"{kind.replace('_', ' ')} has no physical form here: its model parameters are given"
            )
        elif added.full and "c" in added.coefficients and not any(subject.c in _symbols(r) for r in found.rows):
            share = subject.row(
                f"share of the {added.effect.replace('_', ' ')}", "share", subject.c, Unit(), main=False
            )
            found = replace(found, rows=[*found.rows, share])
        taken = {row.symbol for row in rows}
        if any(row.symbol in taken for row in found.rows):  # another effect has this name
            end = f"_{len(rows)}"
            term += found.term.xreplace({sp.Symbol(r.symbol): sp.Symbol(r.symbol + end) for r in found.rows})
            rows += [Row(r.name, r.symbol + end, r.expression, r.unit, r.effect, r.main) for r in found.rows]
        else:
            term += found.term
            rows += found.rows
        rows += _others(subject, set().union(*map(_symbols, found.rows)), units)
        notes += [found.note] if found.note else []
    return rows, term, notes


def _incomplete(subject: Subject) -> bool:
    """Whether a shape parameter was put in as a number and is gone."""
    own = subject.effect
    return own is not None and any(p not in {**subject.added.shape, **subject.added.fixed} for p in own.shape)


def _symbols(row: Row) -> set[Any]:
    """Return the parameters that a row tells."""
    return set(sp.sympify(row.expression).free_symbols)


def _others(subject: Subject, told: set[Any], units: Mapping[str, str]) -> list[Row]:
    """Return the parameters that no row tells, in their own units."""
    added = subject.added
    of = added.effect.partition(":")[0].replace("_", " ")
    rows = []
    for name, symbol in added.coefficients.items():
        if symbol not in told:
            unit = units.get(str(symbol), "")
            row = subject.row(f"{name} of the {of}", str(symbol), symbol, Unit(said="" if unit == "1" else unit), False)
            rows.append(row)
    shapes = [n for n, s in added.shape.items() if s not in told]
    return rows + [subject.generic(n) for n in (*shapes, *(n for n in added.fixed if added.effect != "input_delay"))]
