"""A law in C starts at the rest of its first reference and keeps the known range of its input."""

import shutil

import numpy as np
import pytest
from test_c import stepped

import narx_sym as ns

TS = 0.01
RNG = np.random.default_rng(0)
INPUT = 1.8 + 1.5 * np.sin(0.02 * np.arange(1500)) + 0.3 * np.sin(0.13 * np.arange(1500))


def made(theta=(0.9, 0.2, 0.05, 0.3), noise=0.0):
    """Return a model that was fitted to its own output."""
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]", "1"], list(theta), Ts=TS)
    y = model.simulate(INPUT, 0.0) + noise * RNG.standard_normal(INPUT.size)
    return model.fit(ns.Record.from_arrays(INPUT, y, TS))


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler here")
def test_the_source_starts_at_the_rest_of_its_reference_and_keeps_the_known_range(tmp_path):

    law = made(noise=1e-3).compensator()
    low, high = law.model.info.ranges["u"]
    assert str(law.stability()).endswith(
        f"y from {law.model.info.ranges['y'][0]:.4g} to {law.model.info.ranges['y'][1]:.4g}."
    )
    for level in (4.5, 8.0):
        r = level + np.where(np.arange(200) < 20, 0.0, 6.0 * np.sin(0.05 * (np.arange(200) - 20)))
        source = law.export("c")
        assert "law_init(law_state *past, law_real r)" in source
        found = stepped(tmp_path, source, "law", {"r": r[1:]}, [float(r[0])])
        expected = law.run(r, limits=(low, high))[:-1]
        assert np.abs(found - expected).max() <= 2e-3 * (high - low) and found.min() >= low and found.max() <= high
        assert abs(found[0] - law.rest_input(level)) <= 1e-3 * (high - low)
    free = stepped(tmp_path, law.export("c", limits=None), "law", {"r": r[1:]}, [float(r[0])])
    assert free.max() > high
