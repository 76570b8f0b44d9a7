"""Which sequence reads which, at which lags."""

import narx_sym as ns
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.graph import Graph, read
from narx_sym.symbolic.signals import k, phi2, signal, u, v, x, y

a, b, c = (signal(n) for n in "abc")


def test_lags_are_those_of_the_written_out_expression():
    assert read(a[k - 2] * a[k] + b[k - 1]) == {a: (0, 2), b: (1,)}
    assert read(phi2[k - 1]) == {u: (1, 2)} and read(3) == {}


def test_what_returns_to_itself_through_others():
    graph = Graph.of([(a[k], b[k - 1] + u[k]), (b[k], a[k] / 2), (c[k], a[k] + c[k - 1]), (y[k], c[k])])
    assert graph.reached(y) == {a, b, c, u} and graph.reached(u) == set()
    assert graph.recurrent == {a, b, c}
    assert graph.without(b).recurrent == {c} and b not in graph.without(b).reached(y)


def test_delays_and_the_ways_on_which_the_input_comes_first():
    graph = Graph.of(
        [(a[k], u[k - 2]), (b[k], a[k] + u[k - 3]), (c[k], c[k - 1]), (y[k], y[k - 1] + b[k - 1] + u[k - 4])]
    )
    assert graph.delays(u) == {a: 2, b: 2, c: None, y: 3}
    assert graph.fastest(u).reads == {a: {u: (2,)}, b: {a: (0,)}, c: {}, y: {b: (1,)}}
    early = Graph.of([(y[k], a[k - 1] + u[k]), (a[k], y[k - 1])])
    assert early.delays(u) == {y: 0, a: 1} and early.fastest(u).reached(y) == {u}


def test_the_graph_of_a_model_with_effects():
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0], Ts=0.01)
    model = base
    for wanted, where in (("backlash", "input"), ("creep", "output")):
        model = extend(model, next(o for o in variants(model) if o.id == wanted and o.where == where)).model
    graph = model.recursion.graph
    held = {s.left.base for s in model.recurrent}
    assert x not in held and v not in held and len(held) == 4 == len(model.memory)  # creep remembers in three
    assert held < graph.recurrent and x in graph.recurrent and v not in graph.recurrent
    assert u in graph.reached(y) and graph.delays(u)[v] == 0
    assert base.recursion.graph.reads == {y: {y: (1,), u: (1,)}}
