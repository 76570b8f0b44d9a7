"""Random recursions for Hypothesis, inputs for them, and their runs in every engine."""

import numpy as np
import sympy as sp
from hypothesis import strategies as st

from narx_sym.engines.compile import ENGINES, compile
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, phi1, phi2, signal, u

V, W, X = signal("v"), signal("w"), signal("x")
STATES = (signal("p"), signal("q_1"), X)
A, B = sp.symbols("a b", real=True)


def inputs_of(n, seed=0):
    """Two inputs in [-1, 1] that stay away from 0 and from their own past."""
    random = np.random.default_rng(seed)
    return {name: random.uniform(0.05, 1, n) * random.choice([-1, 1], n) for name in "uv"}


def runs(recursion, inputs, theta=(), initial=None, **options):
    return {e: compile(recursion, e)(inputs, theta, initial, **options) for e in ENGINES}


def assert_agree(results, rtol=1e-12):
    reference = results["python"]
    for engine, found in results.items():
        assert found.keys() == reference.keys()
        for name, expected in reference.items():
            assert np.array_equal(np.isnan(found[name]), np.isnan(expected)), engine
            size = np.nanmax(np.abs(expected), initial=1e-300)
            np.testing.assert_allclose(found[name], expected, rtol=0, atol=rtol * size, err_msg=f"{engine}: {name}")


@st.composite
def recursions(draw, small=False):
    """Contracting recursions: with states and inputs in [-1, 1] every term is in [-1, 1], the weights add to 0.9.

    The states `tie_i` at the end record what decides a sign or a branch.
    """
    states = STATES[: draw(st.integers(1, 1 if small else 3))]
    inputs = (u, V)[: draw(st.integers(1, 2))]
    deciding = []

    def past(position):
        base = draw(st.sampled_from(states))
        newest = 0 if states.index(base) < position else 1
        return base[k - draw(st.integers(newest, 3))]

    def given_input():
        return draw(st.sampled_from(inputs))[k - draw(st.integers(-2, 3))]

    def decided(argument):
        deciding.append(argument)
        return argument

    def term(position):
        s, other, v, e = past(position), past(position), given_input(), given_input()
        kind = draw(st.integers(0, 15))
        return (
            s, s * other, s * v, v * e, s**2 * v, abs(s), abs(s - v) / 2,
            sp.sign(decided(s - v / 3)) * other, sp.sign(decided(v)) * s, sp.Max(s, v), sp.Min(s, other, v / 2),
            sp.tanh(2 * s + v), sp.Piecewise((s, decided(v - other / 4) > 0), (other / 2, True)),
            phi2[k - 1] * s, abs(phi1[k - 2]) * s / 2, sp.Max(-v, sp.Min(v, s)) * sp.cos(other),
        )[kind]  # fmt: skip

    updates = []
    for position, base in enumerate(states):
        terms = [term(position) for _ in range(draw(st.integers(1, 2 if small else 4)))]
        weights = [draw(st.sampled_from((-1, 1))) * sp.Float(draw(st.floats(0.05, 0.8))) for _ in terms]
        total = sum(abs(w) for w in weights)
        scale = min(1, 0.8 / float(total))
        right = sum(
            (scale * w * t for w, t in zip(weights, terms, strict=True)), start=draw(st.sampled_from((0, A, B / 2)))
        )
        updates.append((base[k], right))
    updates += [(signal(f"tie_{i}")[k], x) for i, x in enumerate(dict.fromkeys(deciding))]
    return (
        Recursion(tuple(updates), (A, B)),
        draw(st.sampled_from((40, 300, 530)[: 1 if small else 3])),
        draw(st.integers(0, 99)),
    )
