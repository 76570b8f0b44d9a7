"""What an effect is: a small function that returns its equations, with what people need to know about it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import inf
from typing import Any

import sympy as sp

from ...errors import ModelError
from ...symbolic.functions import within
from ...symbolic.printing import text
from ...symbolic.recursion import State
from ...symbolic.signals import k, signal
from ..doors import EffectDoors
from . import _derived

# Where an effect may act, in words: from the input to what is measured.
PLACES: dict[str, str] = {
    "input": "at the input", "force": "as a force at the input", "inside": "inside", "motion": "on the motion",
    "friction": "in the friction", "output": "at the output", "sensor": "at the sensor",
}  # fmt: skip
# Kinds of machine, in words: an effect says in which it is impossible, and what it is called there.
MACHINES = {
    "thermal": "a thermal machine", "tank": "a tank", "drive": "a drive",
    "motion-force": "a moved part with a measured force", "smart-material": "a smart material",
    "soft": "a soft actuator", "propeller": "a propeller", "valve": "a process valve", "structure": "a structure",
    "circuit": "a circuit", "battery": "a battery", "process": "a flow process", "pendulum": "a pendulum",
}  # fmt: skip
# Names of arguments that are sequences; all others are shape parameters.
SEQUENCES: tuple[str, ...] = ("x", "u", "y", "t", "channel")

# The coefficients that mean an effect: lowest and highest.
ANY: tuple[float, float] = (-inf, inf)
POSITIVE: tuple[float, float] = (0.0, inf)
WHOLE: tuple[float, float] = (0.0, 1.0)
OF_A_SPEED = "of a speed"  # the form of what is driven by a speed

COEFFICIENT = re.compile(r"c[0-9]*")  # the names of coefficients


@dataclass(frozen=True)
class Scan:
    """Start values of a shape parameter in the fit of an effect: `values` times a scale of the driving signal.

    Attributes
    ----------
    of : str
        The scale: "amplitude" (half the range of the driving signal), "depth" (how far it falls below the operating
        point), "speed" (rms step from sample to sample), "stroke" (half the distance between reversals, if the signal
        is a speed), "time" (from a few samples to a fraction of the record, on a log scale), "ratio" (no scale), "gain"
        (slope of the line through the data), "peaks" (of the residual's periodogram) or "steps" (whole samples, not
        refined).
    values : tuple of float
        The start values over the scale.
    beyond : float
        The fit may exceed the largest start value by this factor, and go below the smallest by a factor of four; if
        `signed`, down to the same size below zero.
    per_channel : bool
        Whether the scale is divided by the size of the channel.
    unit : str
        Unit of the parameter. Default: that of the scale. A number of steps with the unit "samples" is a time: it is
        adapted to the sampling rate of the record.

    Examples
    --------
    >>> import narx_sym as ns
    >>> ns.Scan("amplitude", (0.2, 0.5, 1.0)).values
    (0.2, 0.5, 1.0)
    """

    of: str
    values: tuple[float, ...] = ()
    power: int = 1
    beyond: float = 4.0
    signed: bool = False
    per_channel: bool = False
    unit: str | None = None

    def said(self, driver: str) -> str:
        """Return the unit of what is scanned, in words; "" where it has none."""
        if self.unit is not None:
            return self.unit
        of = ("u" if driver == "uy" else "the driver") + (" / unit of the channel" if self.per_channel else "")
        plain = UNITS.get(self.of, "").format(of)
        return {1: plain, 0: "1", -1: f"1 / {plain}"}.get(self.power, "")


UNITS = {
    "amplitude": "unit of {}", "depth": "unit of {}", "speed": "unit of {} per sample", "stroke": "unit of {} times s",
    "time": "s", "ratio": "1", "gain": "unit of y / unit of u", "peaks": "Hz",
}  # fmt: skip
AMPLITUDE: Scan = Scan("amplitude", (0.03, 0.08, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9))
CURVATURE: Scan = Scan("amplitude", (0.3, 1.0, 2.5, 6.0, 15.0), power=-1)
SPEED = Scan("speed", (0.1, 0.5, 1.5))
SLOW_SPEED = Scan("speed", (0.05, 0.15, 0.4), beyond=1.0)  # well below the speed: tanh reaches its plateau
TIME: Scan = Scan("time", (0.0, 0.15, 0.3, 0.45), beyond=1.0)  # slower lags are creep
GAIN: Scan = Scan("gain", (0.7, 1.0, 1.3, 1.6, 2.0, 3.0))
PEAKS = Scan("peaks", (0, 1, 2))
RATIO: Scan = Scan("ratio", (1.0, -1.0))
STEPS = Scan("steps", (1, 2, 3, 5, 8), unit="samples")
SCANS = {s.of: s for s in (AMPLITUDE, SPEED, TIME, GAIN, PEAKS, STEPS)}  # the usual ones


@dataclass(frozen=True)
class Form:
    """The equations of one effect: states in order, and one contribution z per coefficient."""

    z: tuple[Any, ...]
    states: tuple[State, ...] = ()


@dataclass(frozen=True)
class Effect(EffectDoors):
    """A physical effect that a model may lack.

    Attributes
    ----------
    id : str
        The name users see; several forms may share it.
    function : callable
        From driving sequences and shape parameters to an expression, a list of them (one coefficient each) or a Form.
    places : mapping from a place to the drivers that make sense there ("u", "y", "uy", "t", "channel", "friction")
    scan : mapping from each shape parameter to a Scan
    share : (lowest, highest) coefficient that means this effect
        `ANY`; `POSITIVE` where the other sign is something else; `WHOLE` where 1 is all of it (a complete dead zone).
    sentence, source : str
        In plain words; where the equation comes from.
    centred : bool
        Whether it matters where zero is: then it is tried around zero and around the operating point.
    closer : bool
        Whether it is a closer form of an effect that other forms of it find: asked where these leave something.
    never, only : of `MACHINES`
        Where it is impossible, as it would take another machine; and, if given, the only ones where it is tried.
    means : mapping from `MACHINES` to words
        What it is called there; what has the same name is the same thing there.
    """

    id: str
    function: Callable[..., Any]
    places: dict[str, tuple[str, ...]]
    scan: dict[str, Scan]
    share: tuple[float, float]
    sentence: str
    source: str
    form: str = ""
    centred: bool = False
    closer: bool = False
    never: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    means: Mapping[str, str] = field(default_factory=dict)

    @property
    def sign(self) -> int:
        """+1 where only a positive coefficient means this effect; 0 where both signs do."""
        return int(self.share[0] >= 0)

    @property
    def full(self) -> bool:
        """Whether a coefficient of 1 is the whole effect: more than that means something else."""
        return self.share[1] == 1

    @property
    def unit(self) -> dict[str, str]:
        """The unit of each shape parameter that has one, in words."""
        driver = next(iter(self.places.values()))[0]
        return {p: unit for p in self.shape if (unit := self.scan[p].said(driver))}

    @property
    def family(self) -> str:
        """The module that it stands in."""
        return (self.function.__module__ or "").rpartition(".")[2]

    @property
    def standing(self) -> bool:
        """Whether its driver is a speed: zero is where the part stands, wherever the operating point is."""
        return self.form.endswith(OF_A_SPEED)

    @property
    def turning(self) -> bool:
        """Whether it shows only where its driver turns back, as a memory does: on one way it is a curve."""
        first = EFFECTS[self.id][0] if self.lagged and self.id in EFFECTS else self
        return first.family == "memory"

    @property
    def lagged(self) -> bool:
        """Whether it stands behind a lag of its own, which is no more than a part of it."""
        return len(self.shape) > 1 and any(s.of == "time" for s in self.scan.values())

    @cached_property
    def weights(self) -> bool:
        """Whether its coefficients are weights of like parts: with both signs it is two, one against the other."""
        return _derived.alike(self.equations(**dict.fromkeys(self.steps, 1)))

    @cached_property
    def at_rest(self) -> bool:
        """Whether it is met at rest, as the end of a way is: what only a changing input reaches is a friction."""
        return _derived.ends(self)

    @cached_property
    def limit(self) -> tuple[str, float, str] | tuple[()]:
        """(shape parameter, value, id): there it is another effect, which needs one parameter less; or nothing."""
        return _derived.at_limit(self, EFFECTS.all())

    @cached_property
    def series(self) -> tuple[int, str] | tuple[()]:
        """(degree, id) where it takes away as the Taylor polynomial of another effect, but turns back; or nothing."""
        return _derived.taylor(self, EFFECTS.all())

    @cached_property
    def steps(self) -> tuple[str, ...]:
        """Names of the shape parameters that are numbers of samples."""
        return tuple(p for p, s in self.scan.items() if s.of == "steps")

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments, in order."""
        return tuple(inspect.signature(self.function).parameters)

    @cached_property
    def shape(self) -> tuple[str, ...]:
        """Names of the shape parameters, in order."""
        return tuple(a for a in self.arguments if a not in SEQUENCES and a != "Ts")

    def equations(self, Ts: Any = 1.0, **values: Any) -> Form:
        """Return the form over the driving sequence `x` and `u`, `y`, `t`, `channel`.

        Shape parameters are real symbols of their own names unless `values` says otherwise.
        """
        return _equations(self, Ts if "Ts" in self.arguments else None, tuple(values.items()))

    def _written(self, Ts: Any, values: dict[str, Any]) -> Form:
        given: dict[str, Any] = {name: signal(name) for name in SEQUENCES}
        # The sampling time enters as a number of few digits: equations stay readable.
        given["Ts"] = Ts if Ts is None or isinstance(Ts, sp.Basic) else sp.Float(f"{Ts:.9g}")
        given |= {p: sp.Symbol(p, positive=True) for p in self.shape} | values
        made = self.function(**{name: given[name] for name in self.arguments})
        if isinstance(made, Form):
            return made
        listed = made if isinstance(made, (list, tuple)) else [made]
        return Form(tuple(sp.sympify(z) for z in listed))

    @property
    def written(self) -> str:
        """The equations as text: c times each contribution, and what it remembers."""
        # Numbers of samples stand in lags and must be numbers; the middle one of those that are tried is shown.
        steps = {p: self.scan[p].values[len(self.scan[p].values) // 2] for p in self.steps}
        form = self.equations(Ts=sp.Symbol("Ts", positive=True), **{p: int(n) for p, n in steps.items()})
        many = len(form.z) > 1
        parts = [sp.Symbol(f"c{i + 1 if many else ''}") * z for i, z in enumerate(form.z)]
        said = [" + ".join(map(text, parts)), *(f"{text(s.left)} = {text(s.right)}" for s in form.states)]
        shown = "; ".join(said) + "".join(f" (here {p} = {n:g})" for p, n in steps.items())
        return re.sub(r"-(\w+\[k-\d+\]) \+ (\w+\[k\])", r"\2 - \1", shown)  # a difference, newest first

    @property
    def acts(self) -> str:
        """Where it acts, what drives it, and what its shape parameters are, in words."""
        words = {"u": "u", "y": "y", "uy": "u and y", "t": "time", "channel": "the channel", "friction": "its share"}
        places = [
            f"{PLACES[place]}, driven by {'the step' if place == 'motion' else ' or '.join(words[d] for d in by)}"
            for place, by in self.places.items()
        ]
        units = [f"{p} in {self.unit[p]}" for p in self.shape if self.unit.get(p)]
        return "; ".join(
            [*places, *units, *(["tried only if an error remains with its other forms"] if self.closer else [])]
        )

    def another(self, form: str, where: str | dict[str, Any], **options: Any) -> Callable[[Callable[..., Any]], Effect]:
        """Declare another form: with the id and sentence of this one, its share too unless that is given.

        See `effect` for the options; the docstring of the function says what the form is.
        """
        return effect(where, id=self.id, form=form, sentence=self.sentence, **{"share": self.share} | options)

    def __repr__(self) -> str:
        return f"Effect({self.id}{', ' + self.form if self.form else ''})"

    def __hash__(self) -> int:
        return hash((self.id, self.form))

    def __reduce_ex__(self, protocol: Any) -> Any:
        # An effect of the catalogue has taken the name of its function, which is therefore not found by it.
        known = any(form is self for form in EFFECTS.get(self.id, ()))
        return (_of_catalogue, (self.id, self.form)) if known else super().__reduce_ex__(protocol)


@lru_cache(maxsize=2048)
def _equations(effect: Effect, Ts: Any, values: tuple[tuple[str, Any], ...]) -> Form:
    return effect._written(Ts, dict(values))


def _of_catalogue(name: str, form: str) -> Effect:
    return next(one for one in EFFECTS[name] if one.form == form)


class Catalogue(dict[str, list[Effect]]):
    """Effects by id; iterating over `all()` gives every form.

    Attributes
    ----------
    machine : the kind of machine that it is for, one of `MACHINES`, or ""
    excluded : ids of effects that are impossible there
    """

    machine: str = ""
    excluded: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Catalogue({len(self)} effects)"

    def all(self) -> list[Effect]:
        """Return every form of every effect."""
        return [e for forms in self.values() for e in forms]

    def add(self, one: Effect) -> None:
        """Add a form; the same form twice replaces the first."""
        forms = self.setdefault(one.id, [])
        forms[:] = [f for f in forms if f.form != one.form] + [one]

    def without(self, *ids: str) -> Catalogue:
        """Return a catalogue that lacks some effects.

        Raises
        ------
        ModelError
            For an id that it does not have; a channel is no part of the id here.
        """
        unknown = [name for name in ids if name not in self]
        if unknown:
            raise ModelError(f"Unknown effect {unknown[0]!r}; there are {', '.join(sorted(self))}.")
        return Catalogue({name: list(forms) for name, forms in self.items() if name not in ids})

    def of(self, machine: str) -> Catalogue:
        """Return what may be met in a kind of machine; "" is one that is not known."""

        def there(one: Effect) -> bool:
            return machine not in one.never and (not one.only or machine in one.only)

        found = Catalogue({name: kept for name, forms in self.items() if (kept := list(filter(there, forms)))})
        found.machine = machine
        found.excluded = tuple(n for n in self if n not in found and any(machine in f.never for f in self[n]))
        return found

    @property
    def meanings(self) -> dict[str, str]:
        """What effects are called in the machine, by id, where that is another name."""
        forms = ((name, one.means) for name, forms in self.items() for one in forms)
        return {name: means[self.machine] for name, means in forms if self.machine in means}


EFFECTS: Catalogue = Catalogue()


def effect(  # noqa: PLR0913
    where: str | Sequence[str] | dict[str, Any],
    *,
    driver: str | Sequence[str] = "u",
    scan: dict[str, Scan] | None = None,
    share: tuple[float, float] = ANY,
    source: str = "",
    id: str | None = None,
    form: str = "",
    centred: bool = False,
    sentence: str = "",
    closer: bool = False,
    never: str | None = None,
    only: str = "",
    means: dict[str, str] | None = None,
    register: bool = True,
) -> Callable[[Callable[..., Any]], Effect]:
    """Turn a function that returns an equation into an effect, and put it into the catalogue.

    The first argument of the function is the driving signal x, the others are shape parameters. What it returns is
    multiplied by a coefficient c, with c = 0 meaning "no effect". Its docstring is the sentence that users read.

    Parameters
    ----------
    where : str, list of str, or mapping from places to drivers
        Where the effect may act: keys of `effects.PLACES`, such as "input" or "output".
    driver : str
        Driving signal ("u", "y", "uy", "t", "channel") at every place, if `where` is not a mapping.
    scan : mapping
        A Scan for every shape parameter of the function.
    share : (low, high)
        Smallest and largest coefficient for which this is still the effect: `ANY`, `POSITIVE` or `WHOLE`.
    sentence : str
        What the effect is, in plain words. Default: the docstring of the function.
    closer : bool
        Whether it is only tried if an error remains with the other forms of the effect.
    never : str
        Machines where it is impossible, such as "thermal tank". Default: as in the first form of the effect.
    only : str
        The only machines where it is tried.
    means : mapping
        Its name in some machines, such as {"tank": "overflow"}. Default: as in the first form of the effect.
    register : bool
        False: do not put it into the catalogue.

    Raises
    ------
    ModelError
        For an unknown place, a shape parameter without a scan rule, or one that has the name of a coefficient.

    Examples
    --------
    >>> import narx_sym as ns
    >>> @ns.effect("input", scan={"s": ns.Scan("amplitude", (0.2, 0.5, 1.0))}, source="own notes", register=False)
    ... def soft_start(x, s):
    ...     "The amplifier gives less around zero."
    ...     return -x[ns.k] * s**2 / (s**2 + x[ns.k] ** 2)
    >>> soft_start.id, soft_start.shape
    ('soft_start', ('s',))
    """

    def listed(x: Any) -> tuple[str, ...]:
        return (x,) if isinstance(x, str) else tuple(x)

    places = {p: listed(d) for p, d in where.items()} if isinstance(where, dict) else {}
    places = places or {p: listed(driver) for p in listed(where)}

    def decorate(function: Callable[..., Any]) -> Effect:
        name = id or function.__name__
        unknown = set(places) - set(PLACES)
        if unknown:
            raise ModelError(f"Effect {name}: a place is one of {', '.join(PLACES)}, not {unknown.pop()!r}.")
        plain = " ".join((function.__doc__ or "").split())
        first = next((f for f in EFFECTS.get(name, ()) if f.form != form), None)
        one = Effect(
            name, function, places, scan or {}, share, sentence or plain or name, source, form, centred, closer,
            tuple(never.split()) if never is not None else first.never if first else (), tuple(only.split()),
            means if means is not None else first.means if first else {},
        )  # fmt: skip
        stray = {*one.never, *one.only, *one.means} - set(MACHINES)
        if stray:
            raise ModelError(f"Effect {name}: a machine is one of {', '.join(MACHINES)}, not {stray.pop()!r}.")
        wrong = [p for p in one.shape if COEFFICIENT.fullmatch(p)]
        if wrong:
            raise ModelError(
                f"Effect {name}: the shape parameter {wrong[0]!r} is called like a coefficient; choose another name."
            )
        missing = [p for p in one.shape if p not in one.scan]
        if missing:
            raise ModelError(f"Effect {name}: give a scan rule for the shape parameter {missing[0]!r}.")
        if register:
            EFFECTS.add(one)
        return one

    return decorate


def clip(x: Any, r: Any) -> Any:
    """Limit x to [-r, r]."""
    return within(x, -r, r)


def step(x: Any) -> Any:
    """Return the difference of a driving sequence, its velocity times Ts."""
    return x[k] - x[k - 1]
