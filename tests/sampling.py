"""A quick part of what is tested at many points; the others are asked with -m more. Few effects instead of all."""

from itertools import product

import pytest

from narx_sym.models.effects import EFFECTS, Catalogue

more = pytest.mark.more


def only(*names):
    """Return a catalogue of few effects: where something else is looked at, deriving all of them takes longest."""
    return Catalogue({name: EFFECTS[name] for name in names})


def matrix(quick, *axes):
    """Return all combinations of several arguments; those that are not among the quick ones are asked with -m more."""
    return [pytest.param(*case, marks=() if case in quick else more) for case in product(*axes)]


def some(values, every=3):
    """Return the cases of a test, of which one in `every` is a quick one."""
    return [value if i % every == 0 else pytest.param(value, marks=more) for i, value in enumerate(values)]
