"""The verdict is a function of the table alone: prices, fewer effects first, and what cannot be told apart."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from narx_sym.diagnosis.table.candidates import suffices, won
from narx_sym.diagnosis.table.verdict import (
    ALIKE,
    LEFT,
    PER_EFFECT,
    PER_PARAMETER,
    ROUNDING,
    TEMPERATURE,
    VERDICTS,
    alike,
    cheapest,
    nothing_named,
    price,
    probabilities,
    verdict,
    winner,
)


@dataclass
class Entry:
    ids: tuple
    held: float
    parameters: int = 3
    wobble: float = 0.0
    becomes: frozenset = frozenset()
    blocks: np.ndarray = field(init=False)

    def __post_init__(self):
        self.blocks = self.held * (1 + self.wobble * (-1.0) ** np.arange(12))

    @property
    def count(self):
        return len(self.ids)

    @property
    def charged(self):
        return self.count

    @property
    def price(self):
        return price(self.held, self.parameters, self.charged)


BASE = Entry((), 1.0)


def test_the_price_of_parameters_and_effects():
    assert price(1.0, 0, 0) == 0
    assert price(0.5, 3, 1) == pytest.approx(np.log(0.5) + 3 * PER_PARAMETER + PER_EFFECT)


def test_below_rounding_all_errors_are_the_same():
    few, many = Entry(("a",), 1e-27, 3), Entry(("b",), 1e-31, 6)
    assert winner([BASE, few, many], BASE) is few
    assert [r.ids for r in alike([few, Entry(("c",), 1e-25, 3)], few)] == [("a",), ("c",)]
    assert price(ROUNDING**2, 1, 0) < price(4 * ROUNDING**2, 1, 0)


def test_nothing_wins_that_is_not_worth_its_price():
    assert winner([BASE, Entry(("a",), 0.72, 4)], BASE) is None
    assert winner([BASE, Entry(("a",), 0.65, 4)], BASE).ids == ("a",)


def test_fewer_effects_win_where_they_remove_nearly_all():
    pair, single = Entry(("a", "b"), 0.01, 5), Entry(("a",), 0.02, 4)
    assert winner([BASE, pair, single], BASE) is single
    assert winner([BASE, pair, Entry(("a",), 0.2, 4)], BASE) is pair


def test_the_same_effects_in_any_order_are_one():
    rows = [Entry(("a", "b"), 0.02), Entry(("b", "a"), 0.01), Entry(("a",), 0.5)]
    assert [r.ids for r in cheapest(rows)] == [("b", "a"), ("a",)]


def test_what_cannot_be_told_apart():
    best = Entry(("a",), 0.10)
    near, far, uneven = Entry(("b",), 0.105), Entry(("c",), 0.2), Entry(("e",), 0.13, wobble=0.99)
    rich, richer = Entry(("d",), 0.101, 5), Entry(("f",), 0.101, 6)  # parameters cost; their number alone bars none
    found = alike([best, near, far, rich, richer, uneven], best)
    assert [r.ids for r in found] == [("a",), ("b",), ("d",), ("e",)]


def test_what_the_best_leaves_says_how_small_a_difference_counts():
    best, near = Entry(("a",), 0.10), Entry(("b",), 0.105)
    assert alike([best, near], best) == alike([best, near], best, 0.06) == [best, near]
    assert alike([best, near], best, 0.02) == [best]
    # Its blocks scatter: a difference below twice the standard error of their mean counts as none.
    scattered = [Entry(("b",), 0.105, wobble=w) for w in (0.05, 0.15)]
    errors = [np.log(r.blocks / best.blocks) for r in scattered]
    assert [bool(e.mean() < 2 * e.std() / np.sqrt(e.size)) for e in errors] == [False, True]
    assert [len(alike([best, r], best, 0.0)) for r in scattered] == [1, 2]
    assert len(alike([best, Entry(("c",), 0.12, wobble=0.3)], best, 0.0)) == 1  # but never more than ALIKE for this


@dataclass
class Told(Entry):
    more = 0

    def beyond(self, known):
        return self.ids[len(known.ids) :]


class Sum(Entry):
    charged = 2  # weights of both signs: one effect against another


def test_what_pays_for_two_wins_as_two():
    one, two, pair = Entry(("a",), 0.0009, 7), Sum(("a",), 0.0009, 8), Entry(("b", "c"), 0.0004, 8)
    assert winner([BASE, one, pair], BASE) is one  # it removes most of what two remove
    assert winner([BASE, two, pair], BASE) is pair
    assert winner([BASE, Entry(("a",), 0.0009, 8), pair], BASE) is pair  # not by being fewer: it needs as many


def test_pairs_are_asked_where_one_effect_would_not_be_named():
    def enough(row, left):
        return suffices(SimpleNamespace(left=lambda row, known: left), row, BASE)

    one = Entry(("a",), 0.05, 4)
    assert enough(one, LEFT) and not enough(one, 2 * LEFT)  # something is left of it
    assert enough(Entry(("a",), 0.005, 4), 2 * LEFT)  # hardly any of what there was
    assert not enough(Sum(("a",), 0.05, 4), 0.0)


def test_nothing_is_named_that_cannot_be_told_from_nothing():
    base, close, clear = Told((), 1.0), Told(("a",), 0.65, 4), Told(("a",), 0.55, 4)
    assert winner([base, close], base) is close  # worth its price, by less than data can tell
    assert won([base, close], base) == (base, None)
    assert won([base, clear], base) == (base, clear)
    wavering = Told(("a",), 0.55, 4, wobble=0.9)  # so do its blocks
    assert won([base, wavering], base) == (base, None)


class Resonant(Told):
    more, count = 2, 2  # two further resonances, each priced as an effect


def test_an_effect_stands_for_a_core_only_where_it_explains_as_much():
    base, core = Told((), 0.12, 7), Resonant((), 0.02, 15)
    as_well, less = Told(("a",), 0.021, 18), Told(("a", "b"), 0.044, 8)
    assert as_well.price - core.price < PER_EFFECT and less.price - core.price < ALIKE
    assert won([base, core, as_well], base) == (base, as_well)
    assert won([base, core, less], base) == (core, None)  # it costs the same, but leaves twice as much


def test_what_is_dearer_but_costs_the_same_is_in_the_set():
    best = Entry(("a",), 0.10, 7)
    simple, simpler = Entry(("b",), 0.125, 5), Entry(("c",), 0.125, 7)
    assert [r.ids for r in alike([best, simple, simpler], best)] == [("a",), ("b",)]


def test_what_becomes_the_best_at_a_limit_is_no_rival():
    best, wider = Entry(("a",), 0.01, 4), Entry(("b",), 0.01, 5, becomes=frozenset("a"))
    assert alike([best, wider], best) == [best]
    assert alike([best, Entry(("b",), 0.01, 5)], best)[1:] and alike([best, Entry(("b",), 0.01, 4)], best)[1:]
    assert alike([best, wider], wider) == [wider, best]  # the simpler one stays a rival of it
    pair = Entry(("c", "a"), 0.01, 6)
    assert alike([pair, Entry(("c", "b"), 0.01, 7, becomes=frozenset("a"))], pair) == [pair]


def test_the_five_verdicts():
    said = [nothing_named(0.0, 0.0), verdict(0.95, 0.0, 1), verdict(0.95, 0.0, 2), verdict(0.7, 0.4, 1)]
    assert [*said, nothing_named(0.6, 0.0)] == list(VERDICTS[:5])
    assert verdict(0.2, 0.0, 1) == "outside_library"


def test_what_an_effect_of_the_catalogue_removes_is_not_outside_it():
    """Too little to be worth its price, but most of what follows from the signals."""
    assert nothing_named(0.4, 0.25) == "nothing_detectable"
    assert nothing_named(0.9, 0.25) == "outside_library"


def test_what_leaves_a_tenth_of_the_rms_is_not_all():
    """A relative of the truth removes most as well; what it leaves still follows from the signals."""
    assert verdict(0.97, 0.4, 1) == "helps_but_incomplete"
    assert verdict(0.97, 0.05, 1) == "named"
    assert verdict(0.995, 0.4, 1) == "named"  # all but a tenth of its rms, on a record with little noise


def test_prices_give_probabilities():
    """Two that cost the same share one half each; a price that is lower by d is exp(6 d) times as probable, of 12 blocks."""
    a, b, dear, pair = Entry(("a",), 0.1), Entry(("b",), 0.1), Entry(("c",), 0.1 * np.e), Entry(("a", "b"), 1e-3)
    found = probabilities([BASE, a, b, dear, pair, Entry(("a",), 0.3)], BASE)
    both = probabilities([BASE, a, b, dear, pair], BASE, 2)
    assert set(both) == {*found, tuple(sorted(pair.ids))} and sum(both.values()) == pytest.approx(1)
    assert sum(found.values()) == pytest.approx(1) and ("a", "b") not in found
    assert found["a",] == found["b",] == pytest.approx(np.exp(6 / TEMPERATURE) * found["c",])
    assert 0 < found[()] < found["c",]
