"""A model as it is printed, read back."""

import narx_sym as ns
from narx_sym.symbolic.grammar import parse
from narx_sym.symbolic.recursion import State


def printed(model):
    """The model that stands in `model.lines(numbers=True)`; states begin where those of the model do."""
    lines = [line.partition(" = ")[2] for line in model.lines(numbers=True)]
    names = [*(s.left.base.name for s in model.states), *model.channels, "t"]
    *states, last = (parse(right, signals=names) for right in lines)
    kept = [
        State(s.left, right, s.initial.xreplace(model.printed), s.group)
        for s, right in zip(model.states, states, strict=True)
    ]
    return ns.Model(last, (), [], states=kept, operating_point=model.operating_point, Ts=model.Ts)
