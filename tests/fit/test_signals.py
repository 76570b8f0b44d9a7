"""A second measured or controlled input is no special case: selection, fit, simulation, law, C."""

import shutil
import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest
from sampling import some
from scipy.signal import lfilter

import narx_sym as ns
from narx_sym.errors import ModelError
from narx_sym.symbolic.signals import k, lag, m, r, samples, signal, u, y

w, p = signal("w"), signal("p")
gcc = shutil.which("gcc")
N, TS = 300, 0.01


def record(noise=0.0):
    rng = np.random.default_rng(3)
    first, second = np.cumsum(rng.standard_normal((2, N)), axis=1) / 4
    out = np.zeros(N)
    for i in range(1, N):
        out[i] = 0.6 * out[i - 1] + first[i - 1] + 0.5 * second[i - 1]
    return ns.Record.from_arrays(first, out + noise * rng.standard_normal(N), Ts=TS, channels={"w": second, "p": first})


def test_signals_by_name():
    found = record()
    assert list(found.signals) == ["u", "y", "t", "w", "p"] and found.signals["w"] is found.channels["w"]
    model = ns.NARX.from_terms(["y[k-1]", "w[k-1]", "u[k-1]"], channels=["w"])
    assert model.inputs == ("u", "w") and ns.NARX.from_terms(["y[k-1]", "u[k-1]"]).inputs == ("u",)


def test_a_channel_is_selected():
    pool = ns.pool(n_y=1, n_u=1, degree=1, lags={"w": 1}, phi=False)
    assert w[k] in pool.terms and w[k - 1] in pool.terms
    chosen = ns.select(pool, record(0.001), continuum=False, n_terms=3)
    assert set(chosen.model.terms) == {y[k - 1], u[k - 1], w[k - 1]}
    assert dict(zip(chosen.model.terms, chosen.model.theta, strict=True))[w[k - 1]] == pytest.approx(0.5, abs=0.01)
    with pytest.raises(ModelError, match="needs the channel 'q'"):
        ns.select(ns.pool(n_y=1, n_u=1, degree=1, lags={"q": 1}), record(), continuum=False, n_terms=2)


def test_identify_takes_the_channels_that_are_named():
    found = ns.identify(record(0.001), base="linear", n_y=1, n_u=1, delay=1, lags={"w": [1], "p": []})
    assert found.channels == ("w",) and w[k - 1] in found.terms
    assert found.theta[found.terms.index(w[k - 1])] == pytest.approx(0.5, abs=0.02)
    still = ns.Record.from_arrays(
        record().u, record().u + 2 * record().channels["w"], Ts=TS, channels={"w": record().channels["w"]}
    )
    static = ns.identify(still, base="static", degree=1, lags={"w": [0]})
    assert dict(zip(static.terms, static.theta, strict=True))[w[k]] == pytest.approx(2.0)


def test_a_base_without_them_says_so():
    with pytest.warns(UserWarning, match="the channel 'w' is not used"):
        ns.identify(record(), base="linear", n_y=1, n_u=1, delay=1)


def test_another_input_than_u():
    model = ns.NARX.from_terms(["y[k-1]", "p[k-1]", "w[k-1]"], input="p", channels=["w"]).fit(record())
    assert model.theta == pytest.approx([0.6, 1.0, 0.5]) and set(model.info.ranges) == {"p", "y"}
    data = record()
    run = model.simulate(data.channels["p"], data.y[0], {"w": data.channels["w"]})
    assert run == pytest.approx(data.y, abs=1e-9)
    steps = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]"], [0.5, 1.0], input="p")
    assert steps.terms[1] == p[k - 1] - p[k - 2]
    with pytest.raises(ModelError, match="from u, or another measured signal, to y"):
        ns.NARX.from_terms(["y[k-1]"], input="p", output="u")


@pytest.mark.parametrize("driven", ("u", "p"))
def test_the_law_reads_the_other_signal(driven, tmp_path):
    terms = ["y[k-1]", f"{driven}[k-1]", "w[k-1]"]
    model = ns.NARX.from_terms(terms, [0.6, 1.0, 0.5], input=driven, channels=["w"], Ts=TS)
    law = model.compensator()
    a, b, c = model.symbols
    assert law.residual() == 0 and (law.law - (r[k + 1] - a * r[k] - c * w[k]) / b).expand() == 0 and law.law.has(r)
    assert not law.law.has(m) and {str(s.label) for s in law.recursion.inputs} == {"r", "w"}
    other = record().channels["w"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # nothing was identified: no ranges
        command = law.run(record().y, 0.0, {"w": other})
        reached = model.simulate(command, record().y[0], {"w": other})
    assert reached[:-1] == pytest.approx(record().y[:-1], abs=1e-9)
    if gcc is not None:  # the source tests itself against our own run
        (tmp_path / "law.c").write_text(law.export("c"))
        subprocess.run([gcc, tmp_path / "law.c", "-DLAW_SELF_TEST", "-o", tmp_path / "law", "-lm"], check=True)
        subprocess.run([tmp_path / "law"], check=True)


@pytest.mark.parametrize("base", ["narx", "static", "linear"])
def test_an_input_by_its_role_takes_part_in_every_base(base):
    """From its own dead time on; of a `narx` base in products with the other input too."""
    rng = np.random.default_rng(3)
    first, other = (np.repeat(rng.uniform(-1, 1, 1200 // n), n) + 0.1 * rng.standard_normal(1200) for n in (20, 30))
    late = 0.3 * np.roll(first, 2) + 0.2 * np.roll(other, 6) + 0.15 * np.roll(first, 2) * np.roll(other, 6)
    out = lfilter([1.0], [1, -0.5], late)
    seen = ns.Record.from_arrays(first, out, Ts=TS, channels={"w": other}, roles={"w": "input"})
    alone = ns.identify(replace(seen, channels={}), base=base)
    model = ns.identify(seen, base=base)
    assert "w" in model.channels and min(map(lag, samples(model.F, signal("w")))) in (6, 7)
    assert ns.evaluate(model, seen).free_run_nrmse < 0.7 * ns.evaluate(alone, seen).free_run_nrmse


@pytest.mark.parametrize("seed", some(range(40), every=40))
def test_a_second_input_has_its_own_pole_and_dead_time(seed):
    """Two lags side by side, each with its own dead time: what is left is the noise."""
    rng = np.random.default_rng(seed)
    n, poles, dead = 1500, rng.uniform((0.6, 0.85), (0.9, 0.97)), rng.integers((0, 0), (4, 40))
    levels = rng.uniform(-1, 1, (2, n // 25))
    signals, out = [np.repeat(x, 25) + 0.3 * rng.standard_normal(n) for x in levels], np.zeros(n)
    for x, pole, d in zip(signals, poles, dead, strict=True):
        part = np.zeros(n)
        for i in range(1 + d, n):
            part[i] = pole * part[i - 1] + (1 - pole) * x[i - 1 - d]
        out += part
    noise = 0.005 * np.std(out)
    seen = ns.Record.from_arrays(signals[0], out + noise * rng.standard_normal(n), Ts=TS, channels={"u2": signals[1]})
    assert seen.roles == {"u2": "input"}
    assert ns.evaluate(ns.identify(seen, base="linear"), seen).free_run_rms < 1.1 * noise
