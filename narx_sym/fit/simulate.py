"""Simulation from given first outputs, and one-step prediction."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from ..data.record import Record
from ..data.units import in_units, listed
from ..engines.columns import Columns, reader
from ..engines.compile import compile
from ..engines.numbers import floats
from ..errors import Diverged, ModelError, NarxError
from ..models.model import Model
from ..symbolic.printing import text
from ..symbolic.recursion import Recursion
from ..symbolic.sensitivity import derivative
from ..symbolic.signals import expand_phi, k, lag, samples, t, x, y
from .coverage import beyond

Array = np.ndarray
Records: TypeAlias = Record | Sequence[Record]


# -- data of a model -------------------------------------------------------------------------------------------


def segments(records: Records) -> list[Record]:
    """Return the contiguous records among one or several."""
    return [s for record in listed(records) for s in record.segments()]


def parts(length: int, count: int) -> list[slice]:
    """Return the slices that cut so many samples into equal pieces."""
    return [slice(a, b) for a, b in pairwise(np.linspace(0, length, count + 1).astype(int).tolist())]


def centre(x: Array) -> float:
    """Return where a signal is measured from: zero where zero lies well inside its range, else its mean."""
    low, high = float(x.min()), float(x.max())
    return 0.0 if abs(high + low) <= 0.5 * (high - low) else float(x.mean())


def arrays(model: Model, record: Record, more: Iterable[str] = ()) -> dict[str, Array]:
    """Return the sequences by name as the model means them: an inverse model's y is the measured y[k + lead].

    Parameters
    ----------
    more : names of sequences that are needed beside those of the model

    Raises
    ------
    ModelError
        For a sequence that the record does not have.
    """
    clock = ["t"] if t in model.recursion.inputs else []
    names = dict.fromkeys(["u", "y", *model.inputs, *clock, *more])
    signals = record.signals
    missing = [name for name in names if name not in signals]
    if missing:
        raise ModelError(f"The model needs the channel {missing[0]!r}; name it with channels (--channels).")
    n, lead = len(record), model.lead if model.input == y else 0
    return {name: signals[name][lead:] if name == "y" else signals[name][: n - lead] for name in names}


def initial_values(model: Model, data: Mapping[str, Array], depth: int, engine: str = "native") -> dict[str, Array]:
    """Return the values before the first computed sample, (depth,) arrays: of the output, and of what effects remember.

    Parameters
    ----------
    data : the sequences by name, in the user's units; of the output at least `depth` samples

    Raises
    ------
    ModelError
        For an initial value that contains parameters, or is not finite.
    """
    found = {model.output.name: np.asarray(data[model.output.name][:depth])}
    # Without values nothing is known about an effect: it is taken as absent.
    theta = model.numbers
    symbols = () if theta is None else model.symbols
    for state in model.states:
        begin = model.in_user_units(state.initial) if theta is None else model.starts[state.left.base]
        read, value = reader((begin,), symbols)
        if begin.free_symbols - {b for s in read for b in s.free_symbols} - {*symbols}:
            raise ModelError(f"The initial value of {state.left} must contain signals and numbers only.")
        # Before the first sample everything is as at the first sample.
        given = [[np.float64(data[s.base.name][max(0, i - lag(s))]) for s in read] for i in range(depth)]
        name = state.left.base.name
        found[name] = np.array([float(value(*row, *(theta or ()))[0]) for row in given])
        if not np.all(np.isfinite(found[name])):
            shown = ", ".join(f"{text(s)} = {v:g}" for s, v in zip(read, given[0], strict=True))
            raise ModelError(
                f"The initial value of {state.left}, {text(begin.xreplace(model.values))}, is not finite at {shown}."
            )
    return found | _driven(model, data, found, depth, engine)


def _driven(
    model: Model, data: Mapping[str, Array], begin: Mapping[str, Array], depth: int, engine: str
) -> dict[str, Array]:
    """Run what the inputs alone drive up to the first computed sample, from rest at the first sample of all.

    The engine itself does it: what should stay where it is then differs from the run by no rounding, whose sign would
    count where a model uses the direction of an inner input.
    """
    reads = {s.left.base: {e.base for e in samples(expand_phi(s.right))} for s in model.states}
    held = {model.output, x}
    while more := {b for b, read in reads.items() if read & held} - held:
        held |= more
    free = [(left, right) for left, right in model.recursion.updates if left.base in reads and left.base not in held]
    if not free or model.numbers is None:
        return {}
    recursion = Recursion(tuple(free), model.symbols)
    wanted = [b.name for b in recursion.inputs]
    if any(data[n].size < depth for n in wanted):
        return {}
    ahead = recursion.depth
    padded = {n: np.concatenate([np.full(ahead, data[n][0]), data[n][:depth]]) for n in wanted}
    first = {b.name: begin[b.name][0] for b in recursion.states}
    run = compile(recursion, engine)(
        padded, fitted(model), first, start=ahead, length=ahead + depth, on_divergence="nan"
    )
    return {n: c[ahead:] for n, c in run.items() if np.all(np.isfinite(c[ahead:]))}


def shifted(model: Model, data: Mapping[str, Array]) -> dict[str, Array]:
    """Measure the sequences from the model's operating point."""
    point = {b.name: v for b, v in model.operating_point.items()}
    return {name: x - point[name] if name in point else x for name, x in data.items()}


def simulate(
    model: Model,
    u: Any,
    y0: Any = None,
    channels: Mapping[str, Any] | None = None,
    engine: str = "native",
    u0: float | None = None,
    warn: bool = True,
) -> Array:
    """Simulate the model (free run) from an input and the first outputs.

    Parameters
    ----------
    model : Model with theta
    u : (N,) or (N, 1) array, list or Series
        The model's input [its unit].
    y0 : number or (depth,) array, optional
        The outputs before the first computed sample [its unit]. By default the model's line through the data it was
        fitted on, at u[0]; a model that was not fitted to data needs y0 unless it has no memory.
    channels : mapping of names to (N,) arrays
    u0 : number, optional
        The input before the start: everything rests at (u0, y0) until the first sample [unit of the input]. Without
        it, y0 stands for the outputs at the first samples themselves.
    warn : bool
        Whether to warn where the input goes beyond the range, the rate or the frequency seen in identification.

    Returns
    -------
    (N,) array [unit of the output]

    Raises
    ------
    Diverged
        Where the run leaves the finite numbers: the first bad sample and what to check.
    """
    fitted(model)
    source = vector(u, "input of a simulation")
    given = {name: vector(x, f"channel {name}") for name, x in named(channels).items()}
    u0 = None if u0 is None else float(vector(np.atleast_1d(u0), "input before the start, u0,")[0])
    if warn:
        for said in extrapolates(model, [source if u0 is None else np.concatenate([[u0], source])]):
            warnings.warn(said, stacklevel=2)
    if u0 is not None:
        depth = max(1, model.recursion.depth)
        held = dict(given)
        if t in model.recursion.inputs:
            held.setdefault("t", np.arange(source.size) * (model.Ts or 1.0))
        before = {n: np.concatenate([np.full(depth, values[0]), values]) for n, values in held.items()}
        y0 = vector(np.atleast_1d(rest_output(model, u0) if y0 is None else y0), "initial output y0")
        known = {n: float(values[0]) for n, values in held.items()}
        rest = rest_states(model, u0, float(y0[-1]), known, engine)
        return _run(model, np.concatenate([np.full(depth, u0), source]), y0, before, engine, rest)[depth:]
    y0 = vector(np.atleast_1d(rest_output(model, source[0]) if y0 is None else y0), "initial output y0")
    return _run(model, source, y0, given, engine)


def _run(
    model: Model,
    source: Array,
    y0: Any,
    channels: Mapping[str, Any],
    engine: str,
    rest: Mapping[str, float] | None = None,
) -> Array:
    """Run a model from its first outputs; what it remembers starts from `rest`, or from its initial values."""
    theta = fitted(model)
    compiled = compile(model.recursion, engine)
    given = {model.input.name: source, **channels}
    depth = compiled.recursion.depth
    if source.size <= depth:
        return np.resize(np.asarray(y0, dtype=float), source.size)
    if t in compiled.recursion.inputs and "t" not in given:
        given["t"] = np.arange(source.size) * (model.Ts or 1.0)
    initial: dict[str, Any] = {model.output.name: y0}
    if rest is not None:
        initial |= rest
    elif model.states:
        before = {**given, model.output.name: np.resize(np.asarray(y0, dtype=float), max(1, depth))}
        initial = initial_values(model, before, max(1, depth), engine) | initial
    runs = {base.name: np.empty(source.size) for base in compiled.recursion.states}
    try:
        return compiled(given, theta, initial, out=runs, output=model.output)[model.output.name]
    except Diverged as error:
        raise Diverged(f"{error}{_what_grew(model, given | runs, error.at)}", error.at, error.trajectory) from None


def rest_states(
    model: Model, start: float, output: float, known: Mapping[str, float] | None = None, engine: str = "native"
) -> dict[str, float]:
    """Return the values of a model's states at rest with a given input and output.

    What effects remember has its initial value there; the core's output `x` is what they leave of the output.

    Parameters
    ----------
    start, output : numbers [units of u and y]
    known : mapping of names to numbers
        Further channels, and `t`.
    """
    data = {model.input.name: start, model.output.name: output, "t": 0.0, **(known or {})}
    if not model.states:
        return {}
    held = initial_values(model, {n: np.full(1, float(value)) for n, value in data.items()}, 1, engine)
    return {name: float(c[0]) for name, c in held.items() if name != model.output.name}


def _what_grew(model: Model, runs: Mapping[str, Any], at: int) -> str:
    """Name the terms that grew before a divergence, and the slope of what the core computes there."""
    depth, inner = model.recursion.depth, model.inner
    end = max(depth, at - 1)  # the last sample whose past is still well inside the finite numbers
    window = {n: np.asarray(run, dtype=float).ravel()[max(0, end - depth) : end + 1] for n, run in runs.items()}
    # What effects add to the core's output counts beside the core's own terms.
    terms = [(c, e) for _, pairs in model.system() for c, e in pairs if e != x[k]]
    terms = [(c, e) for c, e in terms if samples(e)]
    try:
        written = [model.in_user_units((c * e).xreplace(model.values)) for c, e in terms]
        slope_of = model.in_user_units(derivative(model.core, inner[k - 1])).xreplace(model.values)
        sizes, slope = Columns(written)(window)[-1], float(np.abs(Columns([slope_of])(window)[-1, 0]))
    except (NarxError, LookupError, ValueError, TypeError):
        return ""
    order = [i for i in np.argsort(-np.abs(sizes)) if np.isfinite(sizes[i])][:3]
    if not order:
        return ""
    grown = ", ".join(f"{text(terms[i][1])} ({sizes[i]:.3g})" for i in order)
    said = f"; |dF/d{inner.name}[k-1]| = {slope:.3g} there (stable below 1)" if model.n_y else ""
    return f" Largest terms at sample {end}: {grown}{said}."


def vector(x: Any, what: str, least: int = 1) -> Array:
    """Return a signal as a (N,) array; (N, 1) is flattened, anything else is refused."""
    try:
        values = floats(x)
    except (TypeError, ValueError):
        raise ModelError(f"The {what} must be numbers, (N,).") from None
    if values.ndim != 1 and (values.ndim != 2 or 1 not in values.shape):
        raise ModelError(f"The {what} must have the shape (N,) or (N, 1), not {values.shape}.")
    if values.size < least or not np.all(np.isfinite(values)):
        wanted = "one sample" if least == 1 else "two samples"
        raise ModelError(f"The {what} must have at least {wanted}, all of them finite numbers; none may be missing.")
    return values.ravel()


def named(channels: Mapping[Any, Any] | None) -> dict[str, Any]:
    """Return channels by name; a sequence such as `ns.u` may stand for its own."""
    if not isinstance(channels or {}, Mapping):
        raise ModelError('The channels must be a mapping of names to arrays, such as {"w": w}.')
    return {str(getattr(n, "label", n)): x for n, x in (channels or {}).items()}


def fitted(model: Model) -> Array:
    """Return theta, or say that there is none."""
    if not isinstance(model, Model):
        raise ModelError(f"Give a model (ns.identify, ns.load), not {type(model).__name__}.")
    if model.theta is None:
        raise ModelError("The model has no parameter values: fit it or give theta.")
    return model.theta


def rest_output(model: Model, value: float) -> float:
    """Return the output to start from at rest with a given input: on the line through the fitted data."""
    line = model.info.line
    if line is not None:
        return float(line[0] + line[1] * value)
    if value != 0:
        warnings.warn("No initial output was given: the simulation starts from 0.", stacklevel=3)
    return 0.0


def by_parts(model: Model, record: Record, run: Callable[[Record], Array]) -> Array:
    """Run over each contiguous part of a record by itself; a sample left alone is the measured one."""
    fitted(model)
    (record,) = in_units([record], model.info.units)
    lead, measured = (model.lead, record.u) if model.input == y else (0, record.y)
    edges = pairwise((0, *record.breaks, len(record)))
    return np.concatenate([run(record[a:b]) if b - a > 1 else measured[a : max(a, b - lead)] for a, b in edges])


def predict(model: Model, record: Record) -> Array:
    """Predict one step ahead from measured outputs; the first samples, which have no past, are the measured ones.

    A record with gaps is predicted part by part.

    Returns
    -------
    (N,) array [unit of the output]; for an inverse model each part lacks its last `lead` samples
    """
    return by_parts(model, record, lambda part: _predicted(model, part))


def _predicted(model: Model, record: Record) -> Array:
    theta = fitted(model)
    data = arrays(model, record)
    predictor = compile(model.predictor)
    initial = initial_values(model, data, max(1, predictor.recursion.depth)) if model.states else {}
    result = predictor(data, theta, initial)["prediction"]
    result[: predictor.recursion.depth] = data[model.output.name][: predictor.recursion.depth]
    return result


def extrapolates(model: Model, inputs: Sequence[Array], Ts: float | None = None) -> list[str]:
    """Say where inputs go beyond what the model has seen in identification; see `narx_sym.fit.coverage.beyond`.

    Parameters
    ----------
    inputs : (N,) arrays, contiguous each [unit of the model's input]
    Ts : float, optional [s]
        Of the inputs; by default that of the model.
    """
    name = model.input.name
    return [f"{said}: this extrapolates" for said in beyond(model.info, name, "input", inputs, Ts or model.Ts)]
