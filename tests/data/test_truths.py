"""The simulated truths of the evaluation: deterministic, of the stated size, physically right."""

import ast
import math
from pathlib import Path

import numpy as np
import pytest
import truths
from scipy.integrate import solve_ivp
from truths import FINER, GROUPS, NOISES, SIZE, SIZE_PAIR, TOLERANCE, Plant, battery, case

SEED = truths.DEV[0]
ALL = [(group, kind) for group, kinds in GROUPS.items() for kind in kinds]


def plant(fine, order=2, tau=0.08, zeta=0.6, held=False, h=0.01 / FINER):
    fine = np.asarray(fine, float)
    return Plant(order, tau, zeta, 1.0, 0, 0.0, h, held, fine[::FINER], fine, {})


def triangle(n, turns):
    return np.interp(np.arange(n), np.linspace(0, n - 1, len(turns)), turns)


def test_independent_of_the_package():
    tree = ast.parse(Path(truths.__file__).read_text())
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [n for n in names if n.split(".")[0] in ("narx_sym", "numba")]


@pytest.mark.parametrize(("group", "kind"), ALL)
def test_every_kind(group, kind):
    c = case(group, kind, SEED, excitation=truths.EXCITATIONS[len(kind) % 3], N=1000)
    for x in (c.u, c.y, c.clean, c.bare, *c.channels.values()):
        assert x.shape == (1000,) and np.isfinite(x).all()
    low, high = SIZE_PAIR if group == "pair" else SIZE
    for effect in c.info["effects"]:
        assert low * (1 - TOLERANCE) <= effect["size"] <= high * (1 + TOLERANCE)
    if group == "null":
        assert c.accept == () and np.array_equal(c.clean, c.bare)
    elif group != "pair":
        assert c.size == pytest.approx(c.info["effects"][0]["size"], rel=1e-9)
    assert len(c.accept) == len(c.info["effects"])
    assert c.u[0] == 0 and 0.9 < np.quantile(np.abs(c.u), 0.99) / c.info["amplitude"] < 1.1


def test_deterministic():
    a, b = (case("in", "hysteresis", 101, "sine", "ar80", N=800) for _ in range(2))
    assert np.array_equal(a.u, b.u) and np.array_equal(a.y, b.y) and a.name == b.name == "in/hysteresis/sine/s101/ar80"
    louder = case("in", "hysteresis", 101, "sine", "white", level=0.05, N=800)
    assert np.array_equal(a.clean, louder.clean) and not np.array_equal(a.y, louder.y)
    other = case("in", "hysteresis", 102, "sine", "ar80", N=800)
    assert not np.array_equal(a.u, other.u)
    assert case("in", "drift", 101, "steps", N=800).info["K"] == case("in", "drift", 101, "sine", N=800).info["K"]


def test_frozen_draws():
    """The records of the evaluation must not change unnoticed."""
    c = case("in", "backlash", SEED, N=600)
    assert (c.info["K"], c.u[599], c.y[599]) == pytest.approx((0.9083722699523509, 1.88603935, 0.52776856), rel=1e-4)


def test_battery():
    specs = list(battery("null", range(100, 115)))
    assert specs == list(battery("null", range(100, 115)))
    assert len(specs) == 15 * len(truths.NULL)
    for kind in truths.NULL:
        assert len({(s["excitation"], s["noise"]) for s in specs if s["kind"] == kind}) == 15
    white = [s["noise"] == "white" for s in battery("in", range(100, 116))]
    assert np.mean(white) == 0.5
    assert case(**specs[0], N=600).name.startswith("null/first_order/")
    assert not set(truths.DEV) & set(truths.JUDGE)


@pytest.mark.parametrize("noise", NOISES)
def test_noise(noise):
    c = case("null", "second_order", SEED, noise=noise, level=0.02)
    e = c.y - c.clean
    assert np.sqrt(np.mean(e**2)) == pytest.approx(0.02 * np.std(c.clean), rel=1e-9)
    x = np.concatenate([truths.colour(np.random.default_rng(i), noise, 4000) for i in range(10)])
    r = np.array([np.mean(x[m:] * x[: len(x) - m]) for m in (1, 400)]) / np.mean(x**2)
    if noise == "band":
        power = np.abs(np.fft.rfft(e)) ** 2
        peak = np.argmax(np.convolve(power, np.ones(41), "same"))
        assert 0.02 < peak / len(e) < 0.21 and power[max(peak - 160, 0) : peak + 160].sum() > 0.7 * power.sum()
    else:
        assert r[0] == pytest.approx({"white": 0, "ar95": 0.95, "ar80": 0.8, "drifting": 0.13}[noise], abs=0.06)
        assert (r[1] > 0.04) == (noise == "drifting")


def test_linear_solver_is_exact():
    t = np.arange(4001) * 0.01 / FINER
    p = plant(np.sin(9 * t))
    y = p.linear(p.fine)
    answer = solve_ivp(
        lambda t, x: [x[1], (np.sin(9 * t) - x[0]) / 0.08**2 - 2 * 0.6 / 0.08 * x[1]], (0, t[-1]), [0.0, 0.0], rtol=1e-10,
        atol=1e-12, t_eval=t,
    )  # fmt: skip
    assert np.abs(y - answer.y[0]).max() < 1e-5


@pytest.mark.parametrize("order", [1, 2])
def test_internal_force_against_another_solver(order):
    t = np.arange(4001) * 0.01 / FINER
    p = plant(np.sin(9 * t), order)

    def rate(t, x):
        d = np.sin(9 * t) - 0.3 * x[0] ** 3
        return [(d - x[0]) / 0.08, 0.0] if order == 1 else [x[1], (d - x[0]) / 0.08**2 - 2 * 0.6 / 0.08 * x[1]]

    answer = solve_ivp(rate, (0, t[-1]), [0.0, 0.0], rtol=1e-10, atol=1e-12, t_eval=t)
    y = truths.smooth_inside(p, p.fine, lambda y, v, d: 0.3 * y**3)
    assert np.abs(y - answer.y[0]).max() < 1e-5


def test_play_lags_by_its_width():
    path = triangle(1001, [0, 1, -1, 1])
    w = truths.play(path, 0.2)
    slope = np.sign(np.diff(path, prepend=0))
    moving = np.abs(np.diff(w, prepend=0)) > 1e-12
    assert np.allclose((path - w)[moving], 0.2 * slope[moving])
    assert np.ptp((path - w)[50:]) == pytest.approx(0.4)
    c = case("in", "backlash", SEED, N=1000)
    assert 0.01 < c.info["effects"][0]["strength"] < 0.5


def test_dry_friction_sticks_exactly():
    path = triangle(60001, [0, 1, -1, 0])
    p = plant(path)
    y = truths.dry_inside(p, path, 0.2)
    assert np.abs(y[: int(0.19 * 20000)]).max() < 1e-12
    still = np.abs(np.diff(y)) < 1e-12
    # Each reversal is held until the drive has changed by twice the force.
    assert 0.2 < still.mean() < 0.45
    slides = np.abs(path - y - 0.2 * np.sign(np.gradient(path)))[1:][~still]
    assert np.median(slides) < 0.02  # else it follows, behind by the force


def test_stribeck_needs_more_to_break_loose():
    path = triangle(20001, [0, 1])
    starts = [np.argmax(np.abs(truths.dry_inside(plant(path), path, 0.1, s, 0.5)) > 1e-9) for s in (0.0, 0.3)]
    assert path[starts[0]] == pytest.approx(0.1, abs=0.01) and path[starts[1]] == pytest.approx(0.3, abs=0.01)


def test_lugre_sticks():
    path = triangle(80001, [0, 1, 0.7, 1.0, 0.7])
    p = plant(path)
    y = truths.lugre_inside(p, path, 0.2, 0.25, 0.05, 60.0)
    assert np.ptp(y[: int(0.18 * 20000)]) < 0.01  # below the break-away force: bristles only
    assert y[20000] == pytest.approx(0.8, abs=0.05)  # slides behind by the friction
    assert np.ptp(y[21000:]) < 0.1 * 0.3  # small reversals: the linear actuator would move by 0.3
    assert np.ptp(y[21000:]) > 0.3 / 200  # but presliding is elastic


def test_hysteresis_memories():
    t = np.arange(4000)
    path = np.sin(2 * np.pi * t / 1000)
    # Forces of sliders lead the motion, magnetisation lags the field.
    for side, memory in (
        (1, lambda x: truths.bouc_wen(x, 0.3, 0.7, 2)),
        (1, lambda x: truths.maxwell_slip(x, np.linspace(0.1, 0.8, 7), np.ones(7))),
        (-1, lambda x: truths.jiles_atherton(x, 0.5, 0.4, 0.1, 0.1)),
    ):
        z = memory(path)
        up, down = z[3000], z[3500]  # both at zero input
        assert side * up > 0.05 * np.ptp(z) and side * down < -0.05 * np.ptp(z)
        # The loop repeats, and it does not know how fast it is traversed.
        assert np.allclose(z[2000:3000], z[3000:], atol=0.01 * np.ptp(z))
        assert np.allclose(memory(path[::4]), z[::4], atol=0.01 * np.ptp(z))
    assert np.abs(truths.bouc_wen(10 * path, 0.3, 0.7, 1)).max() <= 1 + 1e-6


def test_wrong_names_are_refused():
    for bad in ({"kind": "gravity"}, {"kind": "drift", "excitation": "noise"}, {"kind": "drift", "noise": "pink"}):
        with pytest.raises(ValueError):
            case("in", seed=SEED, N=600, **bad)
    assert math.isinf(truths.smooth_inside(plant(np.ones(4000)), np.ones(4000), lambda y, v, d: -9 * y)[-1])
