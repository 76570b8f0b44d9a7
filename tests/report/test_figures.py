"""Pictures: what is said of a panel is drawn alike on paper and on the page, in looks that need no colour."""

import itertools
import json

import numpy as np
import pytest
from matplotlib.text import Text

from narx_sym.data.examples import STAGE_UNITS
from narx_sym.diagnosis.refit import Split
from narx_sym.report import comparison
from narx_sym.report.comparison import Comparison
from narx_sym.report.figures.describe import LOOKS, SEVERAL, TIME, Area, Line, Panel, script, thinned, traces
from narx_sym.report.figures.still import draw, new_axes
from narx_sym.report.panels.registry import Material

T = np.linspace(0, 10, 500)


@pytest.fixture(scope="module")
def compared(stage_diagnosis):
    return Comparison.of(stage_diagnosis)


def panels_of(diagnosis):
    pictures = [
        p for key in ("verdict", "compare", "experiment") for p in Material(diagnosis, STAGE_UNITS).pictures(key)
    ]
    return [panel for p in pictures for panel in p.draw]


def words_of(panel):
    """The words of a panel, each once."""
    return list(dict.fromkeys(mark.name for mark in panel.marks if mark.name))


def test_lines_of_one_panel_differ_without_colour(stage_diagnosis):
    drawn = [[mark.role for mark in panel.marks if isinstance(mark, Line)] for panel in panels_of(stage_diagnosis)]
    for roles in [*drawn, SEVERAL, ("measured", "before", "after", "candidate"), ("recorded", "setpoint")]:
        for one, other in itertools.combinations([LOOKS[role] for role in roles], 2):
            assert one.dash != other.dash or one.dot != other.dot or abs(one.width - other.width) > 0.3, roles


def test_a_picture_says_its_words(stage_diagnosis):
    for panel in panels_of(stage_diagnosis):
        figure, ax = new_axes()
        assert draw(ax, panel) is figure and (ax.get_xlabel(), ax.get_ylabel()) == (panel.x, panel.y)
        said = [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []
        assert said == words_of(panel)


def test_what_is_held_out_is_shaded_where_time_runs(stage_diagnosis, compared):
    split, t = stage_diagnosis.steps[0].base.split, compared.t
    inside = np.any([(t >= a.low) & (t <= a.high) for a in compared.aside if a.role == "held-out"], axis=0)
    assert np.array_equal(inside, split.test[0]) and inside.any() and not inside[split.train[0]].any()
    for panel in (comparison.response(compared, {}, "base"), comparison.errors(compared, {})):
        assert "validation" in words_of(panel)
    assert "validation" not in words_of(comparison.loop(compared, {}, "base"))
    part = compared.at(slice(0, 100))
    assert all(t[0] <= a.low < a.high <= t[99] for a in part.aside)


def test_where_nothing_is_held_out_nothing_is_shaded(stage_diagnosis):
    base = stage_diagnosis.steps[0].base
    whole = type("Whole", (), {"split": Split.whole(base.split.records)})
    assert comparison.kept_back(whole, 0) == ()


def test_thinned_panels_share_their_samples_and_keep_extremes():
    rng = np.random.default_rng(0)
    t, y, e = np.arange(50_000.0), rng.standard_normal(50_000), rng.standard_normal(50_000)
    y[123], e[40_000] = 9.0, -9.0
    first = traces(TIME, t, "y", {"a": ("measured", y)})
    second = traces(TIME, t, "e", {"b": ("after", e)}, Area(0, 1))
    one, two = thinned(2000, first, second)
    (a,), (_, b) = one.marks, two.marks
    assert a.x is b.x and a.x.size <= 2100
    assert a.y.max() == 9.0 and b.y.min() == -9.0 and isinstance(two.marks[0], Area)
    assert [mark.x.size for mark in thinned(50_000, first)[0].marks] == [50_000]


def test_names_are_no_formulas_and_stand_once():
    panel = Panel(
        "u [$]", "y_{$", [Line(T, T, "a$b$", "after"), Line(T, -T, "a$b$", "after"), Line(T, T, "", "before")]
    )
    figure, ax = new_axes()
    draw(ax, panel)
    figure.canvas.draw()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [r"a\$b\$"] and ax.get_xlabel() == r"u [\$]"


def test_every_mark_is_drawn():
    marks = [
        Line(np.append(T, T[::-1]), np.append(T, -T), "band", "range"), Line(T, T, "dots", "region"),
        Line(T, T, "dashed", "before"), Area(0, 0, "level", "limit"), Area(1, 1, "upright", "limit", True),
        Area(-1, 1, "floor"), Area(2, 3, "span", "held-out", True),
    ]  # fmt: skip
    _, ax = new_axes()
    draw(ax, Panel("x", "y", marks))
    assert len(ax.lines) == 4 and len(ax.patches) == 3
    assert len(ax.get_legend().get_texts()) == len(marks)
    assert [json.loads(script().split("LOOKS = ")[1].rstrip(";"))[m.role]["width"] for m in marks[:3]] == [0, 0, 1.4]


def test_panels_above_each_other_share_x_and_say_a_word_once():
    figure, ax = new_axes()
    draw(ax, *(traces(TIME, T, y, {"run": ("after", T)}, title="t" if y == "a" else "") for y in "ab"))
    figure.canvas.draw()
    above, below = figure.axes
    assert above.get_shared_x_axes().joined(above, below) and not above.xaxis.label.get_visible()
    assert above.get_legend() is not None and below.get_legend() is None and below.get_xlabel() == TIME
    (title,) = above.findobj(lambda one: isinstance(one, Text) and one.get_text() == "t")
    assert above.get_legend().get_window_extent().y1 <= title.get_window_extent().y0
