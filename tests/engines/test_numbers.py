"""Machine code does not depend on the decimal numbers of its equations."""

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.engines.numbers import lifted
from narx_sym.engines.slopes import with_slopes
from narx_sym.files import cache
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.sensitivity import sensitivities
from narx_sym.symbolic.signals import k, u, y

CORE = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"], [0.8, 0.3, 0.1])


def lag(c, d, p):
    return Recursion(
        (
            (
                y[k],
                c * y[k - 1] + d * u[k] ** 2 + sp.tanh(u[k]) / 3 + sp.Max(p, y[k - 1]) + sp.Abs(u[k]) ** sp.Float(1.5),
            ),
        )
    )


def test_decimal_numbers_become_parameters_and_nothing_else_does():
    plain, numbers = lifted(lag(*map(sp.Float, (0.25, -0.125, 0.5))))
    assert sorted(numbers) == [-0.125, 0.25, 0.5] and len(plain.parameters) == 3
    ((_, right),) = plain.updates
    assert right.atoms(sp.Float) == {sp.Float(1.5)} and sp.Rational(1, 3) in right.atoms(sp.Rational)
    same, more = lifted(lag(*[sp.Float(0.5)] * 3))
    assert list(more) == [0.5] and len(same.parameters) == 1


def test_other_numbers_need_no_other_code(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    made, keep = [], cache.keep
    monkeypatch.setattr(cache, "keep", lambda key, code: made.append(key) or keep(key, code))
    inputs = {"u": np.sin(np.arange(50.0))}
    for numbers in ((0.25, -0.125, 0.5), (0.75, 0.3, -0.2)):
        one = lag(*map(sp.Float, numbers))
        found, wanted = (compile(one, engine)(inputs, (), {"y": 0.1})["y"] for engine in ("native", "python"))
        np.testing.assert_allclose(found, wanted, rtol=1e-13)
    assert len(made) == 1


def test_every_effect_has_the_same_equations_at_any_rate_and_operating_point():
    """What is left of a record in the equations of an effect would be compiled for each record anew."""
    shifted = [
        CORE.replace(Ts=Ts, operating_point={u: u0, y: y0}) for Ts, u0, y0 in ((0.01, 1.5, -2.25), (0.2, 0.75, -3.125))
    ]
    for one, other in zip(variants(shifted[0]), variants(shifted[1]), strict=True):
        a, b = (lifted(extend(model, v).model.recursion)[0] for model, v in ((shifted[0], one), (shifted[1], other)))
        assert a == b, one


def test_slopes_are_those_of_the_numbers():
    n, parameters = 40, np.array([0.7, 0.4, 0.1])
    record = {"u": np.sin(np.arange(n) / 3.0)}
    for u0, y0 in ((0.25, 1.5), (-0.75, 2.5)):
        recursion = CORE.replace(operating_point={u: u0, y: y0}).recursion
        walk = with_slopes(recursion, (), y).over(record, {"y": y0}, ())
        walk.run(parameters)
        extended, moved = sensitivities(recursion)
        start = dict.fromkeys((str(d[y].label) for d in moved), 0.0)
        wanted = compile(extended, "python")(record, parameters, {"y": y0, **start})
        np.testing.assert_allclose(walk.states["y"], wanted["y"], rtol=1e-13)
        for column, d in zip(walk.slopes.T, moved, strict=True):
            np.testing.assert_allclose(column, wanted[str(d[y].label)], rtol=1e-12, atol=1e-13)


def test_many_shared_parts_find_names():
    a = sp.symbols("a0:1050", real=True)
    parts = [sp.tanh(b * u[k]) for b in a]
    recursion = Recursion(((y[k], sp.Add(*(p + p**2 for p in parts))),), a)
    run = compile(recursion, "python")({"u": np.ones(3)}, np.full(len(a), 0.1), {})["y"]
    np.testing.assert_allclose(run, len(a) * (np.tanh(0.1) + np.tanh(0.1) ** 2), rtol=1e-12)
