"""Equations of one's own become a model like the others: read, sampled exactly where they are linear, saved, fitted."""

import numpy as np
import pytest
import sympy as sp
from sampling import more, only
from scipy.linalg import expm

import narx_sym as ns
from narx_sym.tasks.base import fit_equations

MASS = "x'' = (g*u - d*x' - s*x + o)/m\ny = x\ng = 2\nm ~ {m} in 0.1 ... 10\nd ~ {d}\ns ~ {s}\no ~ 0.5"
PENDULUM = "phi'' = -w*sin(phi) - d*phi' + b*u\ny = phi\nw ~ 8 in 1 ... 100\nb ~ 1.2\nd ~ 0.5 in 0.001 ... 10"
FEW = only("coulomb_friction", "stribeck_friction", "end_stop", "cubic_gain", "drift")
ALL = pytest.mark.parametrize("catalogue", [FEW, pytest.param(ns.EFFECTS, marks=more)], ids=["few", "all"])
TANKS = """
q = b*sign(h1)*sqrt(Abs(h1))       # what flows from the upper tank to the lower one
h1' = a*u - q
h2' = q - e*sign(h2)*sqrt(Abs(h2))
y = h2
h1(0) = y
a ~ 0.05 in 0.02 ... 0.12
b ~ 0.05 in 0.02 ... 0.12
e ~ 0.05 in 0.02 ... 0.12
"""


def held(A, B, h):
    """Return what one sample with a held input does to the states: by the matrix exponential."""
    n = len(A)
    M = expm(h * np.block([[A, B], [np.zeros((B.shape[1], n + B.shape[1]))]]))
    return M[:n, :n], M[:n, n:]


@pytest.mark.parametrize(
    "m, d, s",
    [(1.0, 0.4, 9.0), (1.0, 7.0, 2.0), (2.0, 3.0, 0.0), (1.5, 0.0, 0.0)],
    ids=["swings", "creeps", "integrates", "twice"],
)
def test_linear_equations_are_sampled_exactly(m, d, s):
    text = MASS.format(m=m, d=d, s=s)
    for name, value in (("d", d), ("s", s)):  # what is zero is no parameter, but zero
        text = text.replace(f"{name} ~ 0.0", f"{name} = 0") if not value else text
    h, rng = 0.05, np.random.default_rng(1)
    model = ns.from_equations(text, h)
    Ad, Bd = held(np.array([[0.0, 1.0], [-s / m, -d / m]]), np.array([[0.0, 0.0], [2.0 / m, 0.5 / m]]), h)
    u, x, y = rng.standard_normal(300), np.zeros(2), []
    for value in u:
        y.append(x[0])
        x = Ad @ x + Bd @ [value, 1.0]
    assert np.abs(model.simulate(u, y0=y[:2]) - y).max() < 1e-8 * np.ptp(y)
    assert not model.states and model.delay == 1


@pytest.mark.parametrize("text", [MASS.format(m=1, d=0.4, s=9), MASS.format(m=1, d=7, s=2), PENDULUM, TANKS])
def test_equations_have_an_exact_law(text):
    assert ns.from_equations(text, 0.05).compensator().residual() == 0


def test_a_first_order_lag_and_a_difference_equation_are_the_same():
    h = 0.1
    lag = ns.from_equations("y' = (K*u - y)/T\nK ~ 3\nT ~ 0.7", h)
    same = ns.from_equations(f"y[k] = p*y[k-1] + b*u[k-1]\np ~ {np.exp(-h / 0.7)}\nb ~ {3 * (1 - np.exp(-h / 0.7))}", h)
    u = np.random.default_rng(2).standard_normal(100)
    assert np.allclose(lag.simulate(u, y0=0.2), same.simulate(u, y0=0.2), atol=1e-12)


def pendulum(u, h, friction):
    """Return the angle of a pendulum with dry friction, by Runge and Kutta in steps of a tenth."""
    x, y = np.zeros(2), []

    def slope(x, value):
        return np.array([x[1], -9 * np.sin(x[0]) + value - 0.3 * x[1] - friction * np.tanh(x[1] / 0.01)])

    for value in u:
        y.append(x[0])
        for _ in range(10):
            a = slope(x, value)
            b = slope(x + h / 20 * a, value)
            c = slope(x + h / 20 * b, value)
            x = x + h / 60 * (a + 2 * b + 2 * c + slope(x + h / 10 * c, value))
    return np.array(y)


def swung(friction, N=2000, h=0.02):
    t = np.arange(N) * h
    u = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in ((2, 0.3, 0), (2, 0.11, 1), (1, 0.7, 2)))
    y = pendulum(u, h, friction)
    return ns.Record.from_arrays(u, y + 0.005 * np.std(y) * np.random.default_rng(1).standard_normal(N), Ts=h)


@ALL
def test_a_pendulum_without_friction_is_told_that_friction_is_missing(catalogue, tmp_path):
    record = swung(friction=0.5)
    own = ns.from_equations(PENDULUM, record.Ts).fit(record, method="free_run")
    found = ns.diagnose(own, record, catalogue=catalogue)
    assert found.best.effect in ("coulomb_friction", "stribeck_friction")
    assert found.errors["completed"]["validation"] < 0.2 * found.errors["baseline"]["validation"]
    values = {str(s): float(v) for s, v in found.model.values.items()}
    assert values["w"] == pytest.approx(9, rel=0.03) and values["d"] == pytest.approx(0.3, rel=0.1)
    found.report(tmp_path / "own.html", {"u": "N m", "y": "rad"})
    page = (tmp_path / "own.html").read_text(encoding="utf-8")
    assert "could not be made" not in page and "0.500 N m" in page  # the friction that was simulated


@ALL
def test_a_pendulum_that_lacks_nothing_is_told_so(catalogue):
    record = swung(friction=0.0)
    own = ns.from_equations(PENDULUM, record.Ts).fit(record, method="free_run")
    assert own.values[own.symbols[0]] == pytest.approx(9, rel=0.01)
    assert ns.diagnose(own, record, catalogue=catalogue).verdict == "nothing_detectable"


def tanks(u, brim, h=4.0):
    """Return the level of the lower of two tanks; the upper one overflows at its brim."""
    h1, h2, y = 2.0, 3.0, []
    for value in u:
        y.append(h2)
        for _ in range(40):
            q = 0.045 * np.sqrt(h1)
            h2 += h / 40 * (q - 0.05 * np.sqrt(h2))
            h1 = min(h1 + h / 40 * (0.06 * value - q), brim)
    return np.array(y)


@ALL
@pytest.mark.parametrize("brim", [6.5, np.inf])
def test_two_tanks_are_told_that_one_overflows(brim, catalogue, monkeypatch):
    if catalogue is FEW:  # what the laws of two forms are worth takes longer than all the rest
        monkeypatch.setattr("narx_sym.diagnosis.steps.law_worth", lambda model: 2)
    rng, N = np.random.default_rng(3), 1000
    u = np.convolve(rng.standard_normal(N + 200), np.hanning(60), "same")[100 : 100 + N]
    u = np.maximum(1.8 + 1.6 * u / np.abs(u).max(), 0.1)
    y = tanks(u, brim)
    record = ns.Record.from_arrays(u, y + 0.01 * np.std(y) * rng.standard_normal(N), Ts=4.0)
    own = ns.from_equations(TANKS, record.Ts).fit(record, method="free_run")
    found = ns.diagnose(own, record, machine="tank", catalogue=catalogue)
    if np.isinf(brim):
        assert found.verdict == "nothing_detectable"
        assert own.theta == pytest.approx([0.06, 0.045, 0.05], rel=0.05)
    else:
        assert "end_stop" in found.best.effect
        assert any(c.effect == "end_stop" and c.variant.driver == "h1" for c in found.candidates)
        assert found.errors["completed"]["validation"] < 0.1 * found.errors["baseline"]["validation"]


def test_a_model_of_ones_own_is_saved_with_its_bounds(tmp_path):
    known = "y' = (K*u - y)/T\nT = 0.7\nK ~ 3 in 0 ... 9"  # what is known of an exponential is a number
    for text in (MASS.format(m=1, d=0.4, s=9), PENDULUM, TANKS, known):
        model = ns.from_equations(text, 0.05)
        ns.save(model, tmp_path / "own.json")
        again = ns.load(tmp_path / "own.json")
        assert again == model and again.bounds == model.bounds and again.bounds


def test_the_load_of_an_axis_that_integrates_is_known():
    from narx_sym.fit.freerun import has_integrator, load_of

    axis = ns.from_equations("x'' = (u - d*x' + o)/m\ny = x\nm ~ 2\nd ~ 3\no ~ 0", 0.01)
    assert has_integrator(axis) and load_of(axis) == sp.Symbol("o", real=True)
    swings = ns.from_equations(MASS.format(m=1, d=0.4, s=9), 0.01)
    assert not has_integrator(swings) and load_of(swings) is None


@pytest.mark.parametrize(
    "text, said",
    [
        ("y' = -a*y + u\na ~ 1\na ~ 2", "Line 3: the name 'a' is given twice"),
        ("y' = -a*y + u\na ~ 3 in 4 ... 5", "Line 2: a must start inside"),
        ("y' = -a*y + w\na ~ 1", "unknown name 'w'"),
        ("y' = u\nthis is no equation", "Line 2: cannot read 'this is no equation'"),
        ("x' = u - x", "need the output"),
        ("y = u", "need the output"),
        ("y' = u - y\ny[k] = u[k-1]", "given twice|not both"),
        ("y' = u - y\ny = 3*u", "Line 2: the name 'y' is given twice"),
        (3, "text with one per line, not int"),
        ("y' = u - p\np = q\nq = p", "circular"),
        ("y' = u - y\nz(0) = 1", "no state"),
        ("y' = u - y\na ~ 1", "appears in no equation"),
        ("sin' = u", "means something else"),
        ("y' = __import__('os')", "Cannot read"),
        ("\n".join(["# x"] * 500), "at most 200"),
    ],
)
def test_what_cannot_be_read_is_said(text, said):
    with pytest.raises(ns.NarxError, match=said):
        ns.from_equations(text, 0.1)


@pytest.mark.parametrize("Ts", [None, 0, -1.0, float("nan"), float("inf"), "soon"])
def test_derivatives_need_a_sampling_time(Ts):
    with pytest.raises(ns.ModelError, match="sampling time"):
        ns.from_equations("y' = u - y", Ts)


def test_a_measured_channel_takes_part():
    rng, N = np.random.default_rng(4), 800
    u, load = (np.cumsum(rng.standard_normal(N)) / 10 for _ in range(2))
    model = ns.from_equations("y' = (K*u - y)/T + c*load\nload = channel\nK ~ 2\nT ~ 0.5\nc ~ 0.3", 0.1)
    y = model.simulate(u, y0=0.0, channels={"load": load})
    record = ns.Record.from_arrays(u, y, Ts=0.1, channels={"load": load})
    start = model.replace(theta=[1.0, 1.0, 0.0])
    assert start.fit(record, method="free_run").theta == pytest.approx([2, 0.5, 0.3], rel=1e-5)


@pytest.mark.parametrize("samples, said", [(8, "too few"), (40, "give start values nearer to the machine")])
def test_equations_that_cannot_be_fitted_say_what_to_do(samples, said):
    u = np.sin(np.arange(samples))
    record = ns.Record.from_arrays(u, 0.1 * np.cos(np.arange(samples)), 10.0)
    with pytest.raises(ns.FitError, match=said):
        fit_equations("y' = a*y**3 + u\na ~ 9", [record])
