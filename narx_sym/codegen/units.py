"""The units of a model's parameters, and of the numbers in its equations and in those of its law."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..data.units import powers, product, shown
from ..symbolic.printing import latex, text
from ..symbolic.signals import INNER_INPUTS, INNER_OUTPUTS, expand_phi, k, m, r, samples, t, u, y
from .dimensions import Dimensions, Powers
from .layout import RAISED

if TYPE_CHECKING:
    from ..inversion.compensator import Compensator
    from ..models.model import Model


@dataclass(frozen=True)
class Coefficients:
    """Numbers of one equation that have one unit.

    Attributes
    ----------
    left, left_unit : what the equation computes, such as m[k], and its unit, "" where it is not known
    values : the numbers without their signs, the smallest first, each once
    unit : text such as "V/um", "1" for pure numbers
    """

    left: Any
    left_unit: str
    values: tuple[float, ...]
    unit: str


# -- what follows ----------------------------------------------------------------------------------------------


def coefficient_units(
    model: Model, units: Mapping[str, str] | None = None, shapes: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the unit of each parameter by its name, if it is determined; see `narx_sym.codegen.dimensions`.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "um"}, and of channels; by default those of the model's records
    shapes : mapping from shape parameters to their units, where the catalogue says them
    """
    labels = _labels(model.info.units if units is None else units)
    given = {n: label for n, label in (shapes or {}).items() if label}
    if not labels:
        return given
    found = _of_model(model, labels, {n: powers(label.removesuffix(" per sample")) for n, label in given.items()})
    own = {str(s): found.unit(found.named(s)) for s in model.symbols}
    return {n: _spelled(of, labels) for n, of in own.items()} | given


def coefficients(
    law: Compensator, units: Mapping[str, str] | None = None, latex: bool = False
) -> tuple[Coefficients, ...]:
    """Return the coefficients of a law with their units; coefficients whose unit is not determined are left out.

    Parameters
    ----------
    units : mapping such as {"u": "V", "y": "um"}, and of channels; by default those of the model's records
    latex : bool
        The numbers that stand in `law.latex(numbers=True)`, in one bracket over the gain, instead of those of
        `law.lines(numbers=True)`.
    """
    if latex:
        return numbers_told(law.model, law.grouped(numbers=True), units)
    values = law.model.values
    return numbers_told(law.model, [(left, right.xreplace(values)) for left, right in law.updates], units)


def numbers_told(
    model: Model, equations: Iterable[tuple[Any, Any]], units: Mapping[str, str] | None = None
) -> tuple[Coefficients, ...]:
    """Return the numbers of equations with numbers, of a model or of its law, as `coefficients` does.

    Each left side is a sample, or a sample times its gain. What the model remembers has the units that follow from the
    model, also where the law alone would not tell.
    """
    labels = _labels(model.info.units if units is None else units)
    if not labels:
        return ()
    found, places = _of_model(model, labels, {}), []
    for left, right in equations:
        begun = len(found.numbers)
        found.equal(left, right)
        places.append((samples(left)[0], found.numbers[begun:]))
    told = []
    for left, numbers in places:
        groups: dict[str, set[float]] = {}
        for value, own in numbers:
            unit = _spelled(found.unit(own), labels)
            if unit and (abs(value), unit) != (1.0, "1"):  # that says nothing
                groups.setdefault(unit, set()).add(abs(value))
        whole = _spelled(found.unit(found.named(left.base)), labels)
        told += [Coefficients(left, whole, tuple(sorted(each)), unit) for unit, each in groups.items()]
    return tuple(told)


def _labels(units: Mapping[str, str]) -> dict[str, str]:
    return {name: label for name, label in units.items() if label}


def _of_model(model: Model, labels: Mapping[str, str], given: Mapping[str, Powers]) -> Dimensions:
    """Return what a model's equations say; m is an input and r an output."""
    driven = u if model.input == y else model.input
    known = {name: powers(label) for name, label in labels.items()} | {t.name: {"second": Fraction(1)}}
    outer = {m.name: driven.name, r.name: y.name}
    known |= {own: known[name] for own, name in outer.items() if name in known}
    found = Dimensions(known, given)
    for left, right in (*((s.left, s.right) for s in model.states), (model.output[k], model.F)):
        found.equal(left, expand_phi(right))
    for bases, other in (((m, *INNER_INPUTS), driven), ((r, *INNER_OUTPUTS), y)):
        for base in bases:
            found.alike(base, other)
    return found


def _spelled(of: Powers | None, labels: Mapping[str, str]) -> str:
    return "" if of is None else shown(product(of), labels.values())


# -- how it is told --------------------------------------------------------------------------------------------


def by_unit(
    told: Sequence[Coefficients],
    write: Callable[[float], str] = "{:.6g}".format,
    within: Callable[[Any], str] = lambda left: f" in {text(left)}",
) -> list[tuple[str, str]]:
    """Return rows of a table, numbers and their unit: as few rows as there are units, whatever the law remembers.

    Numbers that read alike and have several units are told with their equation.

    Parameters
    ----------
    write : function from a number to its text, by default with the six digits that equations have
    within : function from a left side to the text that names the equation
    """
    units: dict[str, set[str]] = {}
    for one in told:
        for value in one.values:
            units.setdefault(write(value), set()).add(one.unit)
    rows: dict[str, dict[str, float]] = {}
    for one in told:
        for value in one.values:
            said = write(value)
            rows.setdefault(one.unit, {})[said + (within(one.left) if len(units[said]) > 1 else "")] = value
    return [(", ".join(sorted(row, key=lambda said: row[said])), unit) for unit, row in rows.items()]


def units_told(
    model: Model, equations: Sequence[tuple[Any, Any]], units: Mapping[str, str] | None = None
) -> list[tuple[str, str]]:
    """Return rows as `by_unit` does for equations of a model or of its law, with the parameters that stand in them."""
    read = set().union(*(right.free_symbols for _, right in equations))
    names = coefficient_units(model, units) if read & set(model.symbols) else {}
    rows: dict[str, list[str]] = {}
    for s in model.symbols:
        if s in read and names.get(str(s)):
            rows.setdefault(names[str(s)], []).append(str(s))
    for numbers, unit in by_unit(numbers_told(model, equations, units)):
        rows.setdefault(unit, []).append(numbers)
    return [(", ".join(listed), unit) for unit, listed in rows.items()]


def coefficients_latex(told: Sequence[Coefficients]) -> str:
    """Return LaTeX of the table of `by_unit`, "" where there is nothing; it needs amsmath alone."""
    listed = by_unit(told, latex, lambda left: rf" \text{{ in }} {latex(left)}")
    rows = [rf"{numbers} & {_unit_latex(unit)} \\" for numbers, unit in listed]
    head = [r"\begin{array}{ll}", r"\text{coefficients} & \text{unit} \\ \hline"]
    return "\n".join([*head, *rows, r"\end{array}"]) if rows else ""


def _unit_latex(unit: str) -> str:
    """Return LaTeX of a unit: upright, its powers raised, without what would be a command."""
    plain = re.sub(r"[\\{}^~]", "", unit)
    plain = re.sub(r"([_&%#$])", r"\\\1", plain).replace("·", r"\,").replace(" ", r"\,")
    plain = plain.replace("µ", r"\mu ").replace("μ", r"\mu ").replace("Ω", r"\Omega ").replace("°", r"^{\circ}")
    raised = re.sub(f"[{''.join(map(chr, RAISED))}]+", lambda found: f"^{{{found[0].translate(RAISED)}}}", plain)
    return rf"\mathrm{{{raised}}}"
