"""One step of a model or a law as a plain function of samples, for NumPy, machine code and CasADi."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp

from ..errors import ModelError
from ..inversion.solution import Root
from ..symbolic.printing import text
from ..symbolic.recursion import Recursion
from ..symbolic.signals import k, lag, renamed, samples, signal
from .compile import compile
from .numbers import floats
from .numpy import lambdify as in_numpy


def lambdify(thing: Any, engine: str = "numpy", parameters: bool = False) -> Callable[..., Any]:
    """Return one step of a model, a law or a recursion as a plain function; it accepts numbers and arrays.

    Parameters
    ----------
    thing : Model, Compensator or Recursion
    engine : "numpy", "native", "python" or "casadi"
        What computes it. With "casadi" the arguments may be SX, MX or DM as well.
    parameters : bool
        Whether the parameters are arguments too, behind the samples. Without values they are anyway.

    Returns
    -------
    function of `function.arguments` that returns `function.returns`
        Both are texts, such as "y[k-1]", in the user's units. One value is returned as it is, several as a tuple.

    Raises
    ------
    ModelError
        For an unknown engine, and for a function that an engine does not have.

    Examples
    --------
    >>> import narx_sym as ns
    >>> model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    >>> step = model.lambdify()
    >>> step.arguments, step.returns
    (('u[k-1]', 'y[k-1]'), ('y[k]',))
    >>> float(step(1.0, 4.0))
    4.0
    >>> law = model.compensator().lambdify("native")
    >>> law.arguments
    ('r[k+1]', 'r[k]')
    >>> law([4.0, 5.0], [4.0, 4.0]).tolist()
    [1.0, 1.5]
    """
    recursion = thing if isinstance(thing, Recursion) else thing.recursion
    recursion = recursion.subs({} if parameters or recursion is thing else getattr(thing, "model", thing).values)
    own = [left for left, _ in recursion.updates]
    read = {s for _, right in recursion.updates for s in samples(right)} - set(own)
    named: list[Any] = [*sorted(read, key=lambda s: (s.base.name, lag(s))), k, *recursion.parameters]
    symbols = {one: sp.Dummy(text(one), real=True) for one in (*own, *named)}
    rights = [renamed(right, symbols) for _, right in recursion.updates]
    if not any(right.has(symbols[k]) for right in rights):
        named.remove(k)
    results, arguments = ([symbols[one] for one in listed] for listed in (own, named))
    make = {"numpy": _in_turn, "casadi": _casadi}.get(engine, _compiled)
    if make is _in_turn and any(right.has(Root) for right in rights):  # only Python's engine has a root finder
        make, engine = _compiled, "python"
    step = make(arguments, results, rights, engine)

    def function(*given: Any) -> Any:
        if len(given) != len(arguments):
            raise ModelError(f"{len(arguments)} arguments are needed: {', '.join(map(text, named))}.")
        found = step(*given)
        return found[0] if len(found) == 1 else tuple(found)

    function.arguments, function.returns = tuple(map(text, named)), tuple(map(text, own))  # type: ignore[attr-defined]
    return function


def _in_turn(arguments: list[Any], results: list[Any], rights: list[Any], engine: str) -> Callable[..., Any]:
    """Return a NumPy function: each value by its own, from what is given and from the ones before it."""
    steps = [in_numpy([right], [*arguments, *results[:i]]) for i, right in enumerate(rights)]

    def step(*given: Any) -> list[Any]:
        known = [floats(x) for x in given]
        for one in steps:
            (value,) = one(*known)
            known.append(value + np.zeros(np.broadcast_shapes(*map(np.shape, known[: len(given)]))))
        return known[len(given) :]

    return step


def _casadi(arguments: list[Any], results: list[Any], rights: list[Any], engine: str) -> Callable[..., Any]:
    import casadi as ca

    from .casadi import convert

    given = [ca.SX.sym(a.name) for a in arguments]
    known = dict(zip(arguments, given, strict=True))
    for result, right in zip(results, rights, strict=True):
        known[result] = convert(right, known)
    function = ca.Function("step", given, [known[result] for result in results])
    return lambda *values: [function(*values)] if len(results) == 1 else list(function(*values))


def _compiled(arguments: list[Any], results: list[Any], rights: list[Any], engine: str) -> Callable[..., Any]:
    """Return the step as a recursion that remembers nothing, over the samples of arrays."""
    inputs = {one: signal(f"a{i}")[k] for i, one in enumerate(arguments)}
    outputs = {one: signal(f"b{i}")[k] for i, one in enumerate(results)}
    updates = [(outputs[r], renamed(right, inputs | outputs)) for r, right in zip(results, rights, strict=True)]
    compiled = compile(Recursion(tuple(updates)), engine)
    order = [base.name for base in compiled.recursion.inputs]

    def step(*given: Any) -> list[Any]:
        columns = np.broadcast_arrays(*map(floats, given))
        shape, size = (columns[0].shape, columns[0].size) if columns else ((), 1)
        known = {f"a{i}": np.ascontiguousarray(c).ravel() for i, c in enumerate(columns)}
        found = [np.full(size, np.nan) for _ in results]
        arrays, at = [*found, *(known[name] for name in order)], 0
        while at < size:  # a value that is not finite ends no array
            at = compiled.run(arrays, np.empty(0), at, size) + 1
        return [one.reshape(shape)[()] for one in found]

    return step
