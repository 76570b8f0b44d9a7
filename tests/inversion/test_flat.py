"""Flat pieces: every input on one gives the same output. The words say so, and the input nearest to the last one is taken.

Random laws with rectifiers, saturations, dead zones and friction that slips follow what their models made.
"""

from itertools import product

import numpy as np
import pytest
from sampling import some

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.errors import Diverged, Unreachable
from narx_sym.fit.laws.backtracking import open_stages
from narx_sym.fit.laws.driven import driven
from narx_sym.models.extend import extend, variants

N = 90
SHAPES = {
    "rectifier": lambda u, b: [(f"{u}", b), (f"abs({u})", b)],
    "falling rectifier": lambda u, b: [(f"{u}", b), (f"abs({u})", -b)],
    "saturation": lambda u, b: [(f"Max(Min({u}, 0.6), -0.4)", b)],
    "dead zone": lambda u, b: [(f"{u}", b), (f"Max(Min({u}, 0.3), -0.3)", -b)],
    "one stop": lambda u, b: [(f"Max({u} - 0.2, 0)", b)],
}


def slipping(pole, gain, tau=1, c=0.3, r=0.3):
    """Return a first-order model with elastic friction at its output."""
    plain = ns.NARX.from_terms(["y[k-1]", f"u[k-{tau}]"], [pole, gain], Ts=0.01)
    slips = next(v for v in variants(plain, []) if str(v).startswith("coulomb_friction (elastic, at the output"))
    model = extend(plain, slips).model
    numbers = {"theta_1": pole, "theta_2": gain, "c_coulomb_friction": c, "r_coulomb_friction": r}
    return model.replace(theta=[numbers[str(s)] for s in model.symbols])


def drawn(seed):
    """Return a model with a flat piece, tau_d from 1 to 4, older inputs and outputs, and perhaps friction that slips."""
    rng = np.random.default_rng(seed)
    tau, b = int(rng.integers(1, 5)), float(rng.uniform(0.3, 1.0) * rng.choice([-1, 1]))
    terms = [("y[k-1]", rng.uniform(0.2, 0.8)), *SHAPES[list(SHAPES)[seed % len(SHAPES)]](f"u[k-{tau}]", b)]
    terms += [(f"u[k-{tau + 1 + int(rng.integers(3))}]", b * rng.uniform(-0.7, 0.7))] * int(rng.integers(2))
    model = ns.NARX.from_terms([t for t, _ in terms], [float(c) for _, c in terms], Ts=0.01)
    if seed % 3 == 0:
        model = slipping(0.5, b, tau)
    u = 0.9 * np.sin(0.07 * np.arange(N) + rng.uniform(0, 6)) + 0.4 * np.sin(0.3 * np.arange(N))
    return model, np.where(np.arange(N) < 8, 0.0, u)


def attack(seed):
    model, u = drawn(seed)
    law = model.compensator()
    flat = [s for s in law.staged.stages if s.flat]
    assert flat and not any(s.proved for s in flat) and law.residual() == 0
    for stage in flat:
        assert "every" in stage.proof and f"nearest to {ns.symbolic.printing.text(stage.last)}" in stage.proof
    y = model.simulate(u, 0.0, u0=0.0)
    runs = [
        driven(law, compile(law.limited(), engine), y, 0.0, {}, on_divergence="nan")["m"][:N]
        for engine in ("native", "python")
    ]
    if np.abs(runs[0]).max() < 1e6:
        assert np.abs(runs[0] - runs[1]).max() <= 1e-9 * max(1.0, np.abs(runs[0]).max())
    try:
        m = law.run(y, 0.0, share=None)
    except Unreachable as error:  # the model made it
        assert str(error).startswith("The law does not reach") and "several inputs gave the same output" in str(error)
        return
    except Diverged:
        return
    assert np.abs(model.simulate(m, 0.0, u0=0.0) - y)[law.preview :].max() <= 1e-6 * np.ptp(y)


@pytest.mark.parametrize("seed", some(range(60), 30))
def test_every_value_on_a_flat_piece_is_said_to_reach_its_target(seed):
    attack(seed)


def older(tau, shape, lag, gain):
    """Return a model with a flat piece of u[k-tau] and an older input, and an input that passes the flat piece."""
    terms = [("y[k-1]", 0.6), *SHAPES[shape](f"u[k-{tau}]", 0.8), (f"u[k-{tau + lag}]", gain)]
    model = ns.NARX.from_terms([t for t, _ in terms], [c for _, c in terms], Ts=0.01)
    n = np.arange(120)
    return model, np.where(n < 8, 0.0, 0.9 * np.sin(0.07 * n) + 0.4 * np.sin(0.3 * n))


@pytest.mark.parametrize("case", some(product([1, 2, 3], SHAPES, [1, 2, 3]), 4), ids=str)
def test_an_own_output_is_reached_although_a_choice_decides_what_follows(case):
    """What an older input adds depends on which of the inputs on the flat piece was taken: it is chosen later."""
    tau, shape, lag = case
    model, u = older(tau, shape, lag, -0.15 if lag == 3 else 0.2)
    y = model.simulate(u, 0.0, u0=0.0)
    law = model.compensator()
    (stage,) = law.staged.stages
    assert "but every m[k]" in stage.proof and stage.proof in law.checked and not stage.proved
    found = law.follow(y, 0.0)
    assert not found.held.any()
    assert not found.missed.any()
    assert np.abs(model.simulate(found.m, 0.0, u0=0.0) - y)[tau:].max() <= 1e-9 * np.abs(y).max()


def slipped(seed, tau, unit=1.0):
    """Return a model whose friction slips, its law, and what the model made, in a unit of y and its reciprocal of u."""
    rng, n = np.random.default_rng(1000 + seed), np.arange(N)
    drawn = rng.uniform([0.2, 0.3, 0.1, 0.1], [0.8, 1.0, 0.8, 0.6]) * [1, rng.choice([-1, 1]), rng.choice([-1, 1]), 1]
    pole, gain, c, r = drawn if seed >= 0 else (0.5, 0.5, 0.3, 0.3)
    model = slipping(pole, gain * unit**2, tau, c * unit, r / unit)
    u = rng.uniform(0.5, 1.5) * np.sin(0.07 * n + rng.uniform(0, 6)) + 0.4 * np.sin(0.3 * n)
    return model, model.compensator(), model.simulate(np.where(n < 8, 0.0, u) / unit, 0.0, u0=0.0)


@pytest.mark.parametrize("unit", [1e-5, 1e5])
def test_what_friction_made_is_reached_in_any_unit(unit):
    model, law, y = slipped(3, 2, unit)
    found = law.follow(y, 0.0, share=None)
    assert not found.missed.any() and np.abs(model.simulate(found.m, 0.0, u0=0.0) - y).max() <= 1e-9 * np.ptp(y)


@pytest.mark.parametrize("case", some(product(range(-1, 40), [1, 2, 3, 4]), 23), ids=str)
def test_what_friction_made_while_it_slipped_is_reached(case):
    """At each turn the last inputs with which it slips, tau of them, decide when it slips on the other side."""
    model, law, y = slipped(*case)
    assert "every m[k] from" in law.checked and law.residual() == 0
    found = law.follow(y, 0.0, share=None)
    assert not found.missed.any() and np.abs(model.simulate(found.m, 0.0, u0=0.0) - y).max() <= 1e-9 * np.ptp(y)


def test_what_a_choice_decides_is_said_where_the_reference_is_read_from_sample_to_sample():
    model, u = older(1, "rectifier", 2, 0.2)
    y = model.simulate(u, 0.0, u0=0.0)
    law = model.compensator()
    assert law.follow(y, 0.0, back=False).missed.any()
    with pytest.warns(UserWarning, match="computed sample by sample on a machine it would miss some"):
        law.run(y, 0.0)
    _, law, y = slipped(-1, 2)
    y[1] += 1.0  # at rest before: friction alone does not reach this
    with pytest.raises(Unreachable, match="Before that, several inputs gave the same output"):
        law.run(y, 0.0, share=None)


@pytest.mark.parametrize("engine", ["native", "python"])
@pytest.mark.parametrize(("last", "wanted"), [(-0.7, -0.7), (0.0, 0.0), (0.5, 0.0)])
def test_the_value_nearest_to_the_last_one_is_taken(last, wanted, engine):
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "abs(u[k-1])"], [0.5, 0.4, 0.4]).compensator()
    found = compile(law.recursion, engine)({"r": np.zeros(6)}, law.theta, {"m": last})["m"]
    assert found[2] == wanted
    below = compile(law.recursion, engine)({"r": np.r_[0.0, 0.0, np.full(4, -1.0)]}, law.theta, {"m": last})["m"]
    assert below[2] == wanted  # nothing lower is reached: it stays as near as it can, too


def test_a_flat_piece_before_a_stage_that_takes_steps():
    """Static friction behind a slack: what its stage computes first is known no sooner than what it reads."""
    model = ns.NARX.from_terms(["y[k-1]", "u[k-2]"], [0.6, 0.4])
    for effect, value in ((("backlash", "inside", "", "elastic"), 0.04), (("stiction", "motion", "y", ""), 0.15)):
        added = next(v for v in variants(model) if (v.id, v.where) == effect[:2] and effect[3] in ("", v.effect.form))
        made = extend(model, added)
        given = dict(zip(model.symbols, model.theta, strict=True))
        model = made.model.replace(theta=[given.get(s, value) for s in made.model.symbols])
    law = model.compensator()
    u = np.repeat([0.0, 0.6, -0.4, 0.9, 0.2], 12)
    found = law.follow(model.simulate(u, 0.0, u0=0.0), 0.0, share=None)
    assert any(b.flat for stage in open_stages(law) for b in stage.branches)
    assert found.runs_away  # and says so
