"""A quick part of what is tested at many points; the others are asked in `.ci/run`."""

import pytest

more = pytest.mark.more


def some(values, every=3):
    """Return the cases of a test, of which one in `every` is a quick one."""
    return [value if i % every == 0 else pytest.param(value, marks=more) for i, value in enumerate(values)]
