"""Where the model fails: each constructed error is found in its own panel, and noise in none."""

import itertools

import numpy as np
import pytest
import truths
from scipy.signal import lfilter

from narx_sym import plots
from narx_sym.diagnosis.misfit import Misfit, missing_input, reversals, where_it_fails
from narx_sym.diagnosis.misfit.variables import empty_panels
from narx_sym.errors import DataError, NarxError
from narx_sym.report.plots import draw_panel, new_axes

N, TS = 5000, 0.01
T = TS * np.arange(N)
UNITS = {"u": "V", "y": "um", "temperature": "K"}


def play(u, width):
    return u[0] + truths.play(u - u[0], width)


def experiment(seed=0):
    """Input, free run and a channel."""
    rng = np.random.default_rng(seed)
    parts = zip((1, 0.7, 0.5, 0.4), (0.2, 0.37, 0.61, 1.03), strict=True)
    u = sum(a * np.sin(2 * np.pi * f * T + rng.uniform(0, 6.28)) for a, f in parts)
    return u, np.tanh(play(u, 0.3)), np.sin(T / 7), rng


def swings():
    """Input whose amplitude and frequency change from swing to swing, with both, (N,) arrays."""
    rng = np.random.default_rng(7)
    u, sizes, rates, start = [], [], [], 1.0
    while len(u) < N:
        end, length = -np.sign(start) * rng.uniform(0.3, 1.0), int(rng.uniform(20, 100))
        u += list((start + end) / 2 + (start - end) / 2 * np.cos(np.pi * np.arange(length) / length))
        sizes += [abs(end - start) / 2] * length
        rates += [1 / (2 * TS * length)] * length
        start = end
    return np.array(u[:N]), np.array(sizes[:N]), np.array(rates[:N])


def constructed():
    u, y, c, _ = experiment()
    turns = reversals(u, 0.01 * np.ptp(u))
    after = np.searchsorted(turns, np.arange(N), side="right") - 1
    since = np.where(after >= 0, TS * (np.arange(N) - turns[after]), np.inf)
    return {
        "u": np.abs(u),
        "y": y**2,
        "direction": np.sign(np.gradient(u)),
        "rate": np.gradient(u) ** 2,
        "time_since_reversal": np.exp(-since / 0.1),
        "distance_since_reversal": play(u, 0.15) - u,
        "time": T,
        "spectrum": np.sin(2 * np.pi * 13 * T),
        "channel:temperature": c**3,
    }


def test_every_variable_has_an_error_that_only_it_explains():
    found = {name.partition(":")[0] for name in constructed()} - {"spectrum"}  # what all of them leave
    u, y, c, _ = experiment(0)
    every = {panel.name.partition(":")[0] for panel in empty_panels(u, y, TS, {"temperature": c})}
    assert found | {"amplitude_frequency"} == every  # two axes: the test below


def look(error, noise=0.0, u_noise=0.0, seed=0, **options):
    u, y, c, rng = experiment(seed)
    error = error / np.std(error) + noise * rng.standard_normal(N)
    return where_it_fails(u + u_noise * rng.standard_normal(N), y + error, y, TS, {"temperature": c}, **options)


@pytest.mark.parametrize("name", constructed())
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_constructed_error_is_found_in_its_panel(name, noise):
    found = look(constructed()[name], noise).panels[0]
    assert found.name == name
    assert found.share > 0.9 / (1 + noise**2)


@pytest.mark.parametrize("name", constructed())
def test_noise_on_the_input_does_not_mislead(name):
    best = [p.name for p in look(constructed()[name], u_noise=0.015).panels]  # 0.3 % of the range
    assert name in best[:1] or (name in best[:2] and name.endswith(("reversal", "direction")))


def test_amplitude_and_frequency():
    u, size, rate = swings()
    noise = np.random.default_rng(0).standard_normal((2, N))
    # Not a product: each alone explains little.
    error = np.sign(size - np.median(size)) * np.sign(rate - np.median(rate)) + 0.1 * noise[0]
    found = where_it_fails(u, noise[1] + error, noise[1], TS).panels[0]
    assert found.name == "amplitude_frequency"
    assert found.share > 0.5
    assert found.low.shape == found.high.shape == (found.mean.size, 2)
    assert "amplitude in [" in found.where(UNITS) and "Hz" in found.where(UNITS)
    figure, ax = new_axes()
    draw_panel(ax, found, None, UNITS)
    figure.canvas.draw()
    assert ax.get_legend().get_window_extent().y0 > ax.get_window_extent().y1  # above the picture, not over it


def test_white_noise_is_found_nowhere():
    shares: dict[str, list[float]] = {}
    for seed in range(8):
        u, y, c, rng = experiment(seed)
        for p in where_it_fails(u, y + 0.01 * rng.standard_normal(N), y, TS, {"temperature": c}).panels:
            shares.setdefault(p.name, []).append(p.share)
    assert len(shares) == 10
    assert all(np.median(s) < 0.005 and max(s) < 0.02 for s in shares.values())


def test_coloured_noise_is_not_taken_for_an_effect():
    """The standard errors hold: mean over standard error has a variance near one; the bare sd/sqrt(n) gives over ten."""
    scores, bare, shares = [], [], []
    for seed in range(8):
        u, y, _, rng = experiment(seed)
        e = lfilter([1], [1, -0.9], rng.standard_normal(N))
        misfit = where_it_fails(u, y + e, y, TS)
        for p in misfit.panels:
            if p.name in ("u", "y", "time"):
                scores += list(p.mean / p.error)
                bare += list(p.mean / (e.std() / np.sqrt(p.count)))
        shares += [p.share for p in misfit.panels]
    assert 0.6 < np.nanvar(scores) < 1.7
    assert np.nanvar(bare) > 5
    assert np.median(shares) < 0.02 and max(shares) < 0.15


def test_sorted_and_table():
    misfit = look(constructed()["u"], 0.1)
    rows = misfit.table(UNITS)
    assert [r["panel"] for r in rows] == [p.name for p in misfit.panels]
    assert rows[0]["worst"].startswith("u in [") and " V: mean error +" in rows[0]["worst"]
    assert rows[0]["worst"].endswith(" um")
    assert all(np.isnan(r["share_missing"]) for r in rows)
    shares = [r["share"] for r in rows]
    assert all(a > b - 0.03 for a, b in itertools.pairwise(shares))


def test_words():
    found = {n: look(e).panels[0].where(UNITS) for n, e in constructed().items()}
    assert found["spectrum"].startswith("around 13")
    assert found["direction"].split(":")[0] in ("falling", "rising")
    assert "after a reversal, " in found["distance_since_reversal"] and " V " in found["distance_since_reversal"]
    assert " s " in found["time_since_reversal"]
    assert " V/s" in found["rate"]
    assert " K" in found["channel:temperature"]


def test_region():
    misfit = look(constructed()["u"])
    panel, mask = misfit.panels[0], misfit.region("u")
    u = experiment()[0]
    assert mask.sum() == panel.count[panel.worst]
    assert panel.low[panel.worst] <= u[mask].min() and u[mask].max() <= panel.high[panel.worst]
    assert misfit.region("spectrum").all()
    with pytest.raises(DataError, match="no panel 'x'"):
        misfit.region("x")


def test_few_samples_are_grey():
    u, y, _, rng = experiment()
    rare = (np.arange(N) % 1000 == 500).astype(float)  # five samples with a level of their own
    misfit = where_it_fails(u, y + rng.standard_normal(N) + 50 * rare, y, TS, {"switch": rare})
    panel = next(p for p in misfit.panels if p.name == "channel:switch")
    assert list(panel.count) == [N - 5, 5]
    assert list(np.isnan(panel.mean)) == [False, True]
    assert panel.worst == 0


def test_direction_rests_on_plateaus_only():
    k = np.arange(4000)
    noise = 0.002 * np.random.default_rng(0).standard_normal(k.size)

    def counts(u):
        panels = {p.name: p for p in where_it_fails(u, noise, 0 * noise + u, TS).panels}
        return panels["direction"].count / k.size

    wave, flat = np.sin(2 * np.pi * k / 500), np.clip(3 * np.sin(2 * np.pi * k / 500), -1, 1)
    for e in (0 * noise, noise):
        assert counts(wave + e)[1] < 0.01
        assert counts(flat + e)[1] == pytest.approx(np.mean(np.abs(flat) == 1), abs=0.05)


def test_reversals():
    k = np.arange(2000)
    u = np.cos(2 * np.pi * k / 500)
    assert list(reversals(u, 0.02)) == [250, 500, 750, 1000, 1250, 1500, 1750]
    noisy = u + 0.004 * np.random.default_rng(0).standard_normal(k.size)
    found = reversals(noisy, 0.04)
    assert found.size == 7
    assert np.abs(found - reversals(u, 0.02)).max() < 25
    assert reversals(k / 10.0, 0.1).size == reversals(0.0 * k, 0.1).size == 0


@pytest.mark.parametrize("n", [2, 3, 7, 30, 150])
@pytest.mark.parametrize("u", [np.zeros, np.arange, lambda n: np.arange(n) % 2, lambda n: np.sin(np.arange(n))])
@pytest.mark.filterwarnings("error")
def test_small_and_constant(n, u):
    u, e = np.asarray(u(n), dtype=float), np.random.default_rng(n).standard_normal(n)
    for residual in (e, 0 * e):
        misfit = where_it_fails(u, residual, 0 * e, TS, missing=residual)
        assert all(0 <= p.share <= 1 for p in misfit.panels)
        assert "u" not in [p.name for p in misfit.panels] or np.ptp(u) > 0
        assert len(misfit.table()) == len(misfit.panels_missing)


def test_refusals():
    with pytest.raises(DataError, match="one length"):
        where_it_fails(np.zeros(5), np.zeros(5), np.zeros(4), TS)
    with pytest.raises(NarxError, match="finite"):
        where_it_fails(np.zeros(5), np.full(5, np.nan), np.zeros(5), TS)
    with pytest.raises(DataError, match="slopes"):
        missing_input(np.zeros(5), np.zeros((4, 1)))
    with pytest.raises(NarxError, match="no panel"):
        plots.where_it_fails(Misfit(np.zeros(5), None, [], []))


# -- equivalent missing input ----------------------------------------------------------------------------------

POLES = (1.5, -0.55)


def forced(noise=0.02, seed=0):
    """Forcing, and the error it makes through the model, with noise."""
    u = experiment(seed)[0]
    w = 0.01 * np.sign(u)
    return w, lfilter([1], [1, *(-a for a in POLES)], w) + noise * np.random.default_rng(seed).standard_normal(N)


def slopes(n=N):
    return np.tile(POLES, (n, 1))


@pytest.mark.parametrize("floor", [None, 0.02])
def test_missing_input_is_recovered(floor):
    w, e = forced()
    found = missing_input(e, slopes(), floor)
    assert np.corrcoef(found, w)[0, 1] > 0.93
    assert found[w > 0].mean() == pytest.approx(0.01, rel=0.15)


def test_missing_input_leaves_the_noise():
    _, e = forced()
    followed = lfilter([1], [1, *(-a for a in POLES)], missing_input(e, slopes(), 0.02))
    assert np.sqrt(np.mean((followed - e)[10:] ** 2)) == pytest.approx(0.02, rel=0.02)


def test_missing_input_of_varying_slopes():
    """Without noise, the forcing is what the recursion leaves."""
    rng = np.random.default_rng(0)
    a = rng.uniform(-0.4, 0.45, (300, 2))
    w, e = rng.standard_normal(300), np.zeros(300)
    w[:2] = 0
    for k in range(2, 300):
        e[k] = a[k] @ e[[k - 1, k - 2]] + w[k]
    np.testing.assert_allclose(missing_input(e, a, 1e-9), w, atol=5e-3)


def test_missing_input_of_a_static_model_is_the_error():
    e = np.random.default_rng(0).standard_normal(50)
    np.testing.assert_array_equal(missing_input(e, np.zeros((50, 0))), e)
    np.testing.assert_array_equal(missing_input(0 * e, np.ones((50, 1))), 0 * e)


def test_missing_input_of_noise_is_small():
    e = np.random.default_rng(0).standard_normal(N)
    for floor in (None, 1.0, 2.0):
        assert np.std(missing_input(e, slopes(), floor)) < 0.02


def test_missing_input_sits_at_the_cause():
    """The dynamics smear a force against u over the loop; the missing input shows it against u again."""
    u, y, *_ = experiment()
    w = 0.01 * np.abs(u)
    e = lfilter([1], [1, -0.99], w - w.mean()) + 0.005 * np.random.default_rng(0).standard_normal(N)
    found = missing_input(e, np.full((N, 1), 0.99), 0.005)
    rows = {r["panel"]: r for r in where_it_fails(u, y + e, y, TS, missing=found).table()}
    assert rows["u"]["share_missing"] > 0.85 > 0.5 > rows["u"]["share"]


# -- pictures --------------------------------------------------------------------------------------------------


def test_picture(tmp_path):
    w, e = forced()
    u, y, c, _ = experiment()
    for missing, columns in ((None, 1), (w, 2)):
        misfit = where_it_fails(u, y + e, y, TS, {"temperature": c}, missing, 0.02)
        figure = plots.where_it_fails(misfit, tmp_path / f"{columns}.png", UNITS)
        assert (tmp_path / f"{columns}.png").stat().st_size > 10_000
        assert len(figure.axes) == 4 * columns
        assert all("[" in ax.get_ylabel() and "%" in ax.get_title(loc="left") for ax in figure.axes)
        means = [ax for ax in figure.axes[::columns] if ax.get_ylabel().startswith("mean")]
        assert len({ax.get_ylim() for ax in means}) == 1


def test_pictures_of_all_panels():
    u, size, rate = swings()
    e = size + np.sign(rate - np.median(rate)) + 0.3 * np.sin(2 * np.pi * 13 * T)
    for error in (e, 0 * e, *constructed().values()):
        plots.where_it_fails(where_it_fails(u, u + error, u, TS))


def test_line_beside_a_hump():
    """The line is named, also where coloured noise has more power elsewhere."""
    u, y, _, rng = experiment()
    hump = lfilter([1], [1, -0.98], rng.standard_normal(N))
    misfit = where_it_fails(u, y + hump + 1.5 * np.sin(2 * np.pi * 13 * T), y, TS)
    line = next(p for p in misfit.panels if p.name == "spectrum")
    assert line.centres[line.worst] == pytest.approx(13, abs=0.2)
    assert line.mean[line.worst] < line.mean.max()


def test_time_is_that_of_the_record():
    """Not counted from where a segment or a cut begins."""
    u, y, *_ = experiment(0)
    late = [where_it_fails(u, y + (T > 0.9 * T[-1]), y, TS, begin=begin) for begin in (0.0, 100.0)]
    low = [next(p for p in found.panels if p.name == "time").low[0] for found in late]
    assert low == pytest.approx([0.0, 100.0], abs=TS)
