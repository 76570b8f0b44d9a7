"""Stability and range stand first; no source of what is unstable, no law of what is useless."""

import numpy as np
import pytest

import narx_sym as ns
from narx_sym.errors import Diverged, ModelError
from narx_sym.fit.laws import damping, stability
from narx_sym.fit.laws.stability import strays
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info

TS = 0.01
KNOWN = Info(ranges={"u": (-2.0, 2.0), "y": (-4.0, 4.0)})
RNG = np.random.default_rng(0)
INPUT = 1.8 + 1.5 * np.sin(0.02 * np.arange(1500)) + 0.3 * np.sin(0.13 * np.arange(1500))


def test_what_is_said_is_the_largest_zero_of_the_model():
    rng = np.random.default_rng(1)
    for _ in range(5):
        b = rng.uniform(-1, 1, 3)
        law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "u[k-3]"], [0.7, *b], Ts=TS).compensator()
        largest = float(np.abs(np.roots(b)).max())
        if law.damping().share < 1 or abs(largest - 1) < 1e-9:
            continue
        found = law.stability()
        assert found.stable == (largest < 1) and f"up to {largest:.4g}" in str(found)
        if found.stable:
            assert "Stable: " in law.export("c").splitlines()[1]
            continue
        for to in ("c", "st", "fmu", "plcopen"):
            with pytest.raises(ModelError, match=r"not exported\. UNSTABLE: .*force=True"):
                law.export(to)
        assert "UNSTABLE: " in law.export("c", force=True).splitlines()[1] and "UNSTABLE: " in law.export("js")


def test_a_law_with_branches_is_tried_over_the_known_range():
    y = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.6, 0.5], Ts=TS).simulate(INPUT, 0.0)
    said = {}
    for zero in (-0.5, -1.02):
        bent = ns.NARX.from_terms(
            ["y[k-1]", "u[k-1]", "Max(u[k-1] - 2, 0)", "u[k-2]"], [0.6, 0.5, 0.0, 0.5 * zero], Ts=TS
        )
        fitted = bent.fit(ns.Record.from_arrays(INPUT, y, TS)).replace(theta=[0.6, 0.5, 0.1 * 0, 0.5 * zero])
        said[zero] = fitted.replace(theta=[0.6, 0.5, 1e-3, 0.5 * zero]).compensator().stability()
    assert said[-0.5].stable is True and said[-1.02].stable is False and "slow sine" in str(said[-1.02])


@pytest.mark.long  # a root finder in each of many runs
def test_a_damped_law_that_runs_away_is_refused():
    """It is stable around slow motion alone: along this reference its input would grow to 6e8."""
    base = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1.0, 0.4565, -0.0046], Ts=TS)
    wanted = (
        "hysteresis (play superposition, at the output, driven by u)", "coulomb_friction (Dahl, inside, driven by y)"
    )  # fmt: skip
    model = base
    for name in wanted:
        added = extend(model, next(v for v in variants(model, []) if str(v) == name)).model
        model = added.replace(theta=[0.1] * len(added.symbols))
    theta = [1.0, 0.4565, -0.0046, 0.3049, 0.0267, -0.0816, -0.1541, -0.1554, 0.4648, -0.1633, 0.4815]
    model = model.replace(theta=theta)
    n = np.arange(120)
    u = np.where(n < 8, 0.0, 0.9 * np.sin(0.07 * n) + 0.35 * np.sin(0.31 * n))
    y, law = model.simulate(u, y0=0.0, u0=0.0), model.compensator()
    assert law.follow(y, m0=0.0).runs_away
    for clip in (False, True):
        with pytest.raises(Diverged, match="diverges although it is damped"):
            law.run(y, m0=0.0, clip=clip)


@pytest.mark.parametrize("kept", (damping, stability))
def test_what_is_kept_for_an_equal_model_may_go_with_it(kept, monkeypatch):
    """The model that was there first is the key, and may be collected before its entry is read again."""

    class Going(dict):
        def __setitem__(self, key, value):
            pass

    monkeypatch.setattr(kept, "_known", Going())
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.7, 0.5, 0.2], Ts=TS).compensator()
    assert law.stability().stable and law.damping().share == 1


def test_a_model_that_is_no_better_than_a_constant_makes_no_law():
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5], Ts=TS)
    fitted = model.fit(ns.Record.from_arrays(INPUT, RNG.standard_normal(INPUT.size), TS))
    assert fitted.info.useless
    with pytest.raises(ModelError, match="no better than a constant"):
        fitted.compensator()
    assert fitted.compensator(force=True).law is not None and model.compensator().law is not None


@pytest.mark.parametrize("c", (-0.7, -0.5, -0.3, 0.5, 0.8))
def test_a_law_that_leaves_the_only_input_is_unstable(c):
    """What the output gets at once is less than what comes a sample later: rounding grows until it is the input itself.

    Where it then stays bounded a disturbance grows no more: one input alone makes the output, and the law takes others.
    """
    core = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.3], Ts=TS, info=KNOWN)
    at_once = "hysteresis (Bouc-Wen, at the output, driven by u)"
    added = extend(core, next(v for v in variants(core, []) if str(v) == at_once))
    numbers = dict(zip([*added.coefficients, *added.shape], (c, 0.2, 0.9), strict=True))
    law = added.model.replace(theta=[*core.theta, *numbers.values()], info=KNOWN).compensator()
    assert all(stage.proved for stage in law.staged.stages) and law.damping().share == 1
    assert law.stability().stable is (abs(0.3 - 0.8 * c) < abs(c)) and (law.stability().apart < 1e-9) is (c > 0)


@pytest.mark.parametrize("name", ("dead_zone", "saturation", "backlash"))
def test_of_a_flat_piece_every_input_is_alike(name):
    """A whole effect at the input: the law takes other inputs there than what made the output, and does not stray."""
    core = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.6, 0.5], Ts=TS, info=KNOWN)
    variant = next(v for v in variants(core, []) if v.id == name and v.where == "input" and v.effect.form != "soft")
    added = extend(core, variant)
    theta = [*core.theta, *(1.0 for _ in added.coefficients), *(0.5 for _ in added.shape)]
    law = added.model.replace(theta=theta, info=KNOWN).compensator()
    assert law.stability().apart > 0.01 and law.stability().stable is True and not strays(law)
