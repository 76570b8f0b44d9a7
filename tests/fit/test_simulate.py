"""Free run and one-step prediction along records: gaps, starts."""

import numpy as np

import narx_sym as ns
from narx_sym.data.record import Record
from narx_sym.fit.evaluate import free_run
from narx_sym.fit.simulate import predict
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.signals import u, y


def test_nothing_runs_across_a_gap():
    """After a gap a run starts anew from what was measured, as the fit and the errors have it."""
    model = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]"], [1.2, -0.4, 0.5])
    first, second = np.sin(np.arange(60) / 5), 3 + np.cos(np.arange(41) / 7)
    outputs = [model.simulate(w, y0) for w, y0 in ((first, 0.3), (second, 7.0))]
    parts = [np.concatenate(p) for p in ((first, second[:1], second), (outputs[0], [4.0], outputs[1]))]
    record = Record(*parts, np.arange(parts[0].size) * 0.1, 0.1, breaks=(60, 61))
    for run in (predict(model, record), free_run(model, record), model.predict(record)):
        assert run.shape == (len(record),) and np.abs(run - record.y).max() < 1e-12
    axes = model.plot_comparison(record).axes
    assert "NRMSE" in axes[0].get_title(loc="left") and float(axes[0].get_title(loc="left").split()[-1]) < 1e-12


def test_the_errors_are_of_all_samples_whether_a_gap_lies_between_or_not():
    """NRMSE is rms over the output's standard deviation: the table and the picture say the same."""
    rng = np.random.default_rng(0)
    w = np.concatenate([rng.standard_normal(200), 5 + rng.standard_normal(200)])  # another level after the gap
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2])
    noisy = model.simulate(w, 0.0) + 0.3 * rng.standard_normal(400)
    record = Record(w, noisy, np.arange(400) * 0.1, 0.1, breaks=(200,))
    run, found = free_run(model, record), ns.evaluate(model, record)
    assert found.free_run_nrmse == np.sqrt(np.mean((noisy - run) ** 2)) / np.std(noisy)
    assert found.free_run_mape == ns.mape(noisy, run)
    assert found.one_step_nrmse == ns.metrics.nrmse(noisy, predict(model, record))
    assert f"NRMSE {found.free_run_nrmse:.3g}" in model.plot_comparison(record).axes[0].get_title(loc="left")
    parts = record.segments()
    assert ns.evaluate(model, parts) == found


LINEAR = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)
CONTINUUM = ns.NARX.from_terms(
    ["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]"], [1.0, 0.7, 0.1], Ts=0.01, operating_point={u: 0.3, y: -2.0}
)
SIZES = {"tau": 0.05, "b": 0.7, "g": 0.9, "d": 1.1, "f": 3.0, "s": 0.1}


def valued(base, variant, size=0.2):
    """Put an effect with numbers into a base."""
    added = extend(base, variant)
    values = dict(zip(base.symbols, base.theta, strict=True)) | dict.fromkeys(added.coefficients, size)
    values |= {s: SIZES.get(p, 0.25) for s, p in zip(added.shape, variant.shape, strict=True)}
    return added.model.replace(theta=[values[s] for s in added.model.symbols])


def test_creep_of_more_than_the_whole_rests():
    creep = next(v for v in variants(LINEAR) if v.id == "creep")
    for size in (1.0, 1.5, 4.0):
        model = valued(LINEAR, creep, size)
        assert np.abs(model.simulate(np.full(40, 1.6), 2.0 * (1 + size), u0=1.6) - 2.0 * (1 + size)).max() < 1e-9


def test_the_engines_agree_about_a_direction_at_rest():
    """A dead zone before a friction: at rest the inner input does not move by a rounding error."""
    zone = next(v for v in variants(CONTINUUM) if v.id == "dead_zone")
    model = valued(CONTINUUM, zone, 0.37)
    for at in np.random.default_rng(0).normal(0.3, 1, 20):
        for engine in ("native", "python"):
            run = model.simulate(np.full(30, at), -1.0, u0=at, engine=engine)
            assert np.array_equal(run, np.full(30, run[0])) and abs(run[0] + 1) < 1e-12


def test_a_memory_that_runs_away_has_an_infinite_error_one_step_ahead_too():
    """The measured output does not hold what an effect remembers."""
    loop = next(v for v in variants(LINEAR) if v.effect.form == "Bouc-Wen" and v.where == "output")
    model = valued(LINEAR, loop)
    model = model.replace(theta=[-5.0 if str(s).startswith("b_") else v for s, v in model.values.items()])
    w = 50 * np.random.default_rng(0).standard_normal(300)
    found = ns.evaluate(model, ns.Record.from_arrays(w, w, Ts=0.01))
    assert (found.one_step_nrmse, found.free_run_nrmse) == (np.inf, np.inf)


def test_units_that_are_far_apart_are_no_divergence():
    """An error of 1e18 ranges is one, where nothing ran away."""
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0], Ts=0.01)
    u = np.sin(np.arange(300) / 9)
    record = ns.Record.from_arrays(1e9 * u, 1e-9 * model.simulate(u, 0.0), 0.01)
    errors = ns.evaluate(model, record)
    assert 1e15 < errors.free_run_nrmse < 1e20 and np.isfinite(errors.one_step_mape)


def test_a_model_of_numbers_alone_begins_like_the_one_with_parameters():
    """What the inputs drive is run up to the first sample, whether its numbers have names or not."""
    from printed import printed

    from narx_sym.fit.simulate import arrays, initial_values
    from narx_sym.models.extend import extend, variants

    base = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], Ts=0.1)
    slack = next(v for v in variants(base) if v.id == "backlash" and v.where == "input" and v.effect.full)
    made = extend(base, slack).model
    model = made.replace(theta=[0.3] * len(made.symbols))
    u = np.cumsum(np.random.default_rng(0).standard_normal(80))
    data = arrays(model, ns.Record.from_arrays(u, u, Ts=0.1))
    one, other = (initial_values(m, data, 2) for m in (model, printed(model)))
    assert one.keys() == other.keys() and all(np.array_equal(one[n], other[n]) for n in one)
