"""Free run and one-step prediction along records: gaps, starts."""

import numpy as np

import narx_sym as ns
from narx_sym.data.record import Record
from narx_sym.fit.simulate import free_run, predict


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
