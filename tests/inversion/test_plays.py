"""The inverse of a sum of plays is a sum of plays: radii and weights by a recursion (Krejci & Kuhnen 2001)."""

import numpy as np
import pytest
import sympy as sp

from narx_sym.engines.compile import compile
from narx_sym.fit.bases.play import Shape
from narx_sym.inversion.plays import inverse_of
from narx_sym.models.effects.memory import play
from narx_sym.models.model import Model
from narx_sym.symbolic.recursion import State
from narx_sym.symbolic.signals import k, signal, u, v, y

RNG = np.random.default_rng(11)
SHAPED = Shape((0.5, 1.1, 1.6), (0.5, 1.0), 0).model({}, [0.6, 1.0, 0.8, 0.4, 0.2, 0.0, -0.2, 0.1])


def symbolic(n):
    """Plays with symbols for radii and weights."""
    p, r = sp.symbols(f"p_0:{n + 1}", real=True), sp.symbols(f"r_1:{n + 1}", real=True)
    states = [play(u, signal(f"z{i}"), radius) for i, radius in enumerate(r, 1)]
    states = [State(s.left, s.right, s.initial, f"z{i}") for i, s in enumerate(states, 1)]
    total = sp.Add(p[0] * u[k], *(w * s.left for w, s in zip(p[1:], states, strict=True)))
    return p, r, Model(v[k], (*p, *r), [*np.ones(n + 1), *range(1, n + 1)], states=[*states, State(v[k], total, u[k])])


def history(n, size):
    """Random turns, some of them very near to each other."""
    turns = RNG.uniform(-size, size, 1 + n // 7)
    turns[::5] *= 1e-3
    return np.interp(np.arange(n), np.arange(turns.size) * 7, turns)


def misses(law, models, n):
    """The largest error of model(law(r)) over random weights, radii and histories, relative to the reference."""
    count, worst = len(law.model.memory), 0.0
    command, machine = compile(law.limited()), compile(law.model.recursion)  # once: only the numbers change
    for _ in range(models):
        weights = RNG.uniform(0.0, 2.0, count + 1) * (RNG.random(count + 1) < 0.9)
        weights[0] = 10 ** RNG.uniform(-1, 1)
        theta = [*weights, *np.sort(RNG.uniform(0.01, 3.0, count))]
        reference = history(n, 5 * weights.sum())
        rest = reference[0] / weights.sum()
        held = {str(s.left.base.label): rest for s in law.model.memory} | {"y": reference[0], "v": reference[0]}
        m = command({"r": reference}, theta, {**held, "m": rest}, start=1)["m"]
        run = machine({"u": m}, theta, held, start=1)["y"]
        worst = max(worst, np.abs(run - reference).max() / np.abs(reference).max())
    return worst


@pytest.mark.parametrize(("plays", "models", "n"), [(3, 15, 140), pytest.param(10, 200, 700, marks=pytest.mark.long)])
def test_the_model_behind_the_law_is_the_reference(plays, models, n):
    *_, model = symbolic(plays)
    law = model.compensator()
    assert [s.how for s in law.staged.stages][-1] == "plays" and law.closed_form
    assert misses(law, models, n) < 1e-12


def test_the_weights_and_radii_of_the_printed_law_are_those_of_the_recursion():
    p, r, model = symbolic(2)
    weights, radii = inverse_of(list(p), [sp.S.Zero, *r])
    S = [p[0], p[0] + p[1], p[0] + p[1] + p[2]]
    by_hand = [1 / S[0], -p[1] / (S[0] * S[1]), -p[2] / (S[1] * S[2])]
    assert all(sp.simplify(a - b) == 0 for a, b in zip(weights, by_hand, strict=True))
    assert radii == [0, p[0] * r[0], sp.Add(p[0] * r[1], p[1] * (r[1] - r[0]))]
    slopes = np.cumsum([1.0, 0.5, 0.25])  # with all plays moving the inverse's slope is that of the model, inverted
    numbers = [w.xreplace(dict(zip(p, (1.0, 0.5, 0.25), strict=True))) for w in weights]
    assert np.cumsum(numbers).astype(float) == pytest.approx(1 / slopes)
    law = model.compensator()
    assert law.updates[-1][0] is not None
    assert all(sp.simplify(law.law.coeff(s) - w) == 0 for s, w in _used(law, weights))


def _used(law, weights):
    names = ["m_plays", "m_play1", "m_play2"]
    return [(signal(name)[k], w) for name, w in zip(names, weights, strict=True)]


def test_the_operating_point_and_curve_and_lag_are_inverted_in_stages():
    model = SHAPED.replace(operating_point={u: 1.8, y: -96.0})
    law = model.compensator()
    assert [s.how for s in law.staged.stages] == ["branches", "plays"]
    assert law.checked.startswith("exactly one v[k] for every r[k] (proved); exactly one m[k] for every v[k] (proved")
    reference = -96 + history(300, 2.0)
    run = model.simulate(law.run(reference, 1.8, clip=True), reference[0], u0=1.8, warn=False)
    assert np.abs(run - reference).max() < 1e-12 * 100


def test_it_goes_on_from_where_a_limited_machine_is():
    law = SHAPED.compensator()
    reference = 3 * np.sin(np.arange(400) / 20)
    with pytest.warns(UserWarning, match="limit of the actuator"):
        held = law.run(reference, 0.0, limits=(-0.9, 0.9))
    run = SHAPED.simulate(held, 0.0, u0=0.0, warn=False)
    free = np.abs(held) < 0.9 - 1e-9
    free[0] = False
    assert 50 < free.sum() < 350 and np.abs(run - reference)[free].max() < 1e-12


def test_plays_that_do_not_start_together_are_left_to_the_search_over_kinks():
    apart = [State(s.left, s.right, 0 if i == 1 else s.initial, s.group) for i, s in enumerate(SHAPED.states)]
    assert SHAPED.replace(states=apart).compensator().staged.stages[-1].how == "nodes"


def test_weights_that_fall_are_left_to_the_search_over_kinks():
    model = SHAPED.replace(theta=[0.6, 1.0, -0.8, -0.4, 0.2, 0.0, -0.2, 0.1])
    assert model.compensator().staged.stages[-1].how != "plays"
    rising = SHAPED.replace(theta=[0.6, 1.0, -0.3, 0.4, 0.2, 0.0, -0.2, 0.1])  # a weight below zero, all slopes above
    assert rising.compensator().staged.stages[-1].how == "plays"
