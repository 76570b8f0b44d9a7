"""After a stretch that no input reaches: the model chooses among the roots, not the last bit."""

import numpy as np
import pytest
from sampling import some

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.fit.laws.driven import driven
from narx_sym.fit.laws.run import RUNS_AWAY
from narx_sym.fit.laws.trial import growth

N = 140
FORMS = {
    "quadratic": lambda u, b, c: [(u, b), (f"{u}**2", c * b)],
    "quadratic gain": lambda u, b, c: [(u, b), (f"y[k-1]*{u}**2", c * b)],
    "rectifier": lambda u, b, c: [(u, b), (f"abs({u})", b * np.sign(c))],
    "fold": lambda u, b, c: [(u, b), (f"abs({u} - 0.3)", 2 * b * np.sign(c))],
    "play of a sign": lambda u, b, c: [(u, b), (f"sign({u})", c * b)],
}


def drawn(seed):
    """Return a law, and what its model made with two stretches out of reach in it."""
    rng = np.random.default_rng(seed)
    tau, b, c = (
        int(rng.integers(1, 5)),
        float(rng.uniform(0.3, 1.0)),
        float(rng.uniform(0.1, 0.6) * rng.choice([-1, 1])),
    )
    terms = [("y[k-1]", rng.uniform(0.2, 0.8)), *FORMS[list(FORMS)[seed % len(FORMS)]](f"u[k-{tau}]", b, c)]
    terms += [(f"u[k-{tau + 1}]", b * rng.uniform(-0.3, 0.3))] * int(rng.integers(2))
    terms += [(f"u[k-{tau + 1}]*y[k-1]", 0.1)] * int(rng.integers(2))
    model = ns.NARX.from_terms([t for t, _ in terms], [float(c) for _, c in terms], Ts=0.01)
    i = np.arange(N)
    u = np.where(i < 8, 0.0, 0.9 * np.sin(0.07 * i + 0.3) + 0.35 * np.sin(0.31 * i))
    y = model.simulate(u, 0.0, u0=0.0)
    away = 2 * np.ptp(y) * rng.choice([-1, 1], size=2)
    return model.compensator(), y + away[0] * ((40 < i) & (i < 60)) + away[1] * ((85 < i) & (i < 100))


def attack(seed):
    law, r = drawn(seed)
    runs = [
        driven(law, compile(law.limited(), engine), r, 0.0, {}, on_divergence="nan")["m"][:N]
        for engine in ("native", "python", "casadi")
    ]
    runs.append(driven(law, compile(law.limited()), r * (1 + 2e-16), 0.0, {}, on_divergence="nan")["m"][:N])
    size = max(1.0, float(np.abs(runs[0]).max()))
    apart = max(float(np.abs(x - runs[0]).max()) for x in runs[1:]) / size
    assert apart <= 1e-9 or growth(law, r, 0.0, {}, N - 1) >= RUNS_AWAY or not size < 1e6


@pytest.mark.parametrize("seed", some(range(60), 20))
def test_last_digits_choose_no_root(seed):
    attack(seed)


@pytest.mark.parametrize("engine", ["native", "python"])
@pytest.mark.parametrize("curve", [0.3, -0.3])
def test_from_the_vertex_the_law_leaves_to_where_the_output_rises(engine, curve):
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2"], [0.5, 0.4, curve]).compensator()
    vertex = -0.4 / (2 * curve)
    level = -(0.4**2) / (4 * curve)  # where the model rests at 2*level
    r = np.r_[np.zeros(3), np.full(4, 2 * level - 5 * np.sign(curve)), np.full(4, 2 * level + np.sign(curve) * 0.2)]
    found = driven(law, compile(law.limited(), engine), r, 0.0, {})["m"]
    assert found[3:5] == pytest.approx(vertex)
    assert np.sign(0.4 + 2 * curve * found[7]) == 1
    assert law.polynomials[0].choice.endswith("and from there the one where it rises")
