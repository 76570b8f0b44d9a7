"""The report: what it tells, its pictures and the numbers behind them, equations, units, and hostile names."""

import csv
import hashlib
import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from urllib.parse import unquote

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import only

import narx_sym as ns
from narx_sym.data.examples import STAGE_UNITS
from narx_sym.models.extend import extend, variants
from narx_sym.models.info import Info
from narx_sym.report import comparison as traces
from narx_sym.report import page as report
from narx_sym.report import parameters, words
from narx_sym.report.panels import derived, verdict
from narx_sym.report.panels.registry import Material, panels
from narx_sym.report.picture import POINTS
from narx_sym.report.plots import thin
from narx_sym.symbolic.mathml import from_latex, marked, mathml

HOSTILE = '<script>alert(1)</script> & "$x_{'


@pytest.fixture(scope="module")
def page(stage_report):
    return stage_report.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def hostile():
    """A diagnosis in which every name is an attack: of the record and of a channel that matters."""
    rng = np.random.default_rng(1)
    n = 400
    u, other = rng.standard_normal(n), np.sin(np.arange(n) / 20)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + 0.3 * u[k - 1] * (1 + 0.5 * other[k])
    record = ns.Record.from_arrays(
        u, y + 0.01 * rng.standard_normal(n), Ts=0.01, channels={HOSTILE: other}, name=HOSTILE
    )
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"]).fit(record)
    found = ns.diagnose(base, record, catalogue=only("channel_gain", "bilinear_gain"))
    assert found.best.effect == f"channel_gain:{HOSTILE}"
    return found


def test_a_coefficient_of_a_candidate_has_its_unit(hostile):
    (channel,) = hostile.best.shown.model.channels
    told = parameters.candidate_parameters(hostile.best, {"u": "V", "y": "mm", channel: "A"})
    assert re.fullmatch(r"c = [\d.-]+ 1/A", told)


def downloads(html):
    """Return the files that a page holds, by name."""
    found = re.findall(r'download="([^"]+)" href="data:[^,]*,([^"]*)"', html)
    return {name: unquote(text.replace("&amp;", "&")) for name, text in found}


# ---- the story -------------------------------------------------------------------------------------------------------


def test_the_parts_stand_in_order(page, stage_parts):
    places = [page.index(f'<section id="{key}"') for key in panels()]
    assert places == sorted(places) and list(stage_parts) == list(panels())


def test_the_verdict_has_sizes_in_the_users_units(stage_diagnosis, stage_parts):
    d = stage_diagnosis
    error = d.ladder[0]["validation_rms"]
    assert f"{words.number(1e3 * error)} µm" in stage_parts["verdict"]
    assert d.verdict.replace("_", " ") in stage_parts["verdict"] and "Next." in stage_parts["verdict"]
    after = d.ladder[-1]["validation_rms"]
    assert f"{words.number(1e3 * after)} µm" in stage_parts["verdict"] and after < 0.3 * error


def test_candidates_have_intervals_equations_and_sentences(stage_diagnosis, stage_parts):
    d = stage_diagnosis
    for row, c in zip(d.table(), d.candidates, strict=True):
        most = min(100.0, 100 * row["high"])  # a share ends at all of it
        assert f"{100 * row['low']:.0f} to {most:.0f} %" in stage_parts["candidates"]
        assert c.variant.effect.sentence in stage_parts["candidates"]
    assert stage_parts["candidates"].count("<math") >= len(d.candidates)
    assert stage_parts["candidates"].count('class="candidate chosen"') == len(d.confusion_set)
    assert all(parameters.candidate_parameters(c, STAGE_UNITS) in stage_parts["candidates"] for c in d.candidates)
    assert "Detection limits" in stage_parts["candidates"]


def test_the_new_term_is_marked_and_deleted_parameters_are_listed(stage_diagnosis, stage_parts):
    before, after = stage_parts["model"].split("<h3>After")
    assert 'class="new"' not in before and 'class="new"' in after
    rows = {
        r.name: r
        for r in parameters.parameters(
            stage_diagnosis.steps[0].base.model, stage_diagnosis.model, STAGE_UNITS,
            parameters.shape_units(stage_diagnosis, STAGE_UNITS),
        )
    }  # fmt: skip
    assert rows["r_backlash"].status == "new" and rows["r_backlash"].unit == "rad"
    kept = {str(s) for s in stage_diagnosis.model.symbols}
    assert all((r.status == "deleted") == (name not in kept) for name, r in rows.items())


def test_a_parameter_of_the_base_is_known_again_beside_a_force():
    """acting[k] is the input that has arrived: its coefficient is that of u[k-2], not of u[k]."""
    before = ns.NARX.from_terms(["y[k-1]", "u[k-2]", "u[k-3]"], [0.7, 0.4, 0.2], Ts=0.01)
    found = next(v for v in variants(before) if (v.id, v.where) == ("hardening_spring", "force"))
    after = extend(before, found).model.replace(theta=[0.7, 0.4, 0.2, -0.1])
    rows = {r.name: r for r in parameters.parameters(before, after, {}, {})}
    assert {name: r.status for name, r in rows.items()} == {
        "theta_1": "", "theta_2": "", "theta_3": "", "c_hardening_spring": "new",
    }  # fmt: skip


def test_the_sets_of_an_added_play_are_derived(stage_parts):
    assert "Quasi-static sets and attracting condition" in stage_parts["derived"] and "turn" in stage_parts["derived"]
    assert "The law with numbers" in stage_parts["derived"]


def test_what_comes_from_where(stage_diagnosis, tmp_path):
    file = tmp_path / "data.csv"
    file.write_text("t,u,y\n")
    wanted = ["provenance", "compare"]
    made = report.sections(stage_diagnosis, STAGE_UNITS, [file], {"base": "linear"}, keys=wanted)
    html = {s.key: s.html for s in made}
    told = html["provenance"]
    assert hashlib.sha256(file.read_bytes()).hexdigest() in told and "base = linear" in told and "seed = 0" in told
    assert ns.__version__ in told and "numpy" in told and "<script" not in html["compare"]


def test_no_address_and_no_foreign_script(page):
    links = re.findall(r'(?:src|href)="([^"]*)"', re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL))
    assert links and all(link.startswith(("#", "data:")) for link in links)
    assert not re.search(
        r"<script[^>]+src|<link|@import|url\(\s*['\"]?http", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    )
    assert len(page.encode()) < 2.5e6


# ---- pictures and numbers ----------------------------------------------------------------------------------------


def test_every_picture_has_a_text_alternative_and_ids_are_unique(page):
    still = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    pictures = re.findall(r"<svg [^>]*>", still)
    assert len(pictures) > 10
    for tag in pictures:
        assert 'role="img"' in tag and len(re.search(r'aria-label="([^"]*)"', tag)[1]) > 20
    ids = re.findall(r'\sid="([^"]+)"', still)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"url\(#([^)]+)\)", still)) <= set(ids)
    assert {h for h in re.findall(r'href="#([^"]+)"', still)} <= set(ids)


def test_the_numbers_behind_the_pictures(stage_diagnosis, page):
    files = downloads(page)
    rows = list(csv.DictReader(io.StringIO(files["ladder.csv"])))
    assert [row["model"] for row in rows] == [*stage_diagnosis.rungs, "noise floor"]
    assert float(rows[0]["validation"]) == pytest.approx(stage_diagnosis.ladder[0]["validation"], rel=1e-4)
    time = np.genfromtxt(io.StringIO(files["time.csv"]), delimiter=",", names=True)
    record = stage_diagnosis.steps[0].base.split.records[0]
    assert time["measured"].max() == pytest.approx(record.y.max(), rel=1e-4)
    assert time["measured"].min() == pytest.approx(record.y.min(), rel=1e-4)
    following = np.genfromtxt(io.StringIO(files["next.csv"]), delimiter=",", names=True)
    assert following.dtype.names == ("t", "u") and len(following) == stage_diagnosis.experiment.u.size


def test_the_python_of_the_page_runs(stage_diagnosis, page, tmp_path, monkeypatch):
    import html

    (tmp_path / "model.json").write_text(downloads(page)["model.json"])
    record = stage_diagnosis.steps[0].base.split.records[0]
    rows = "\n".join(f"{t},{u},{y}" for t, u, y in zip(record.t, record.u, record.y, strict=True))
    (tmp_path / "data.csv").write_text(f"t,u,y\n{rows}\n")
    monkeypatch.chdir(tmp_path)
    code = {name: html.unescape(re.search(rf'<pre id="{name}"[^>]*>(.*?)</pre>', page, flags=re.DOTALL)[1])
            for name in ("model-python", "law-python", "model-latex")}  # fmt: skip
    known = {}
    exec(code["model-python"], known)
    expected = ns.free_run(stage_diagnosis.model, record)
    np.testing.assert_allclose(known["simulated"], expected, rtol=1e-9, atol=1e-12)
    assert f"# {stage_diagnosis.ladder[-1]['train']:.6g}" in code["model-python"]  # the number that the page shows
    known = {"r": 0.5 * record.y}
    exec(code["law-python"], known)
    assert np.isfinite(known["m"]).all() and code["model-latex"] == stage_diagnosis.model.latex()


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 3000), st.integers(2, 200), st.integers(0, 2**32 - 1))
def test_thinning_keeps_the_extremes(size, most, seed):
    x = np.random.default_rng(seed).standard_normal(size)
    kept = thin(x, most)
    assert np.all(np.diff(kept) > 0) and kept[0] == 0 and kept[-1] == size - 1
    assert x[kept].max() == x.max() and x[kept].min() == x.min()
    if size > 2 * most:
        assert kept.size <= most + 2
        for a, b in zip(edges := np.linspace(0, size, most // 2 + 1).astype(int), edges[1:], strict=False):
            inside = kept[(kept >= a) & (kept < b)]
            assert x[inside].max() == x[a:b].max() and x[inside].min() == x[a:b].min()


def test_a_long_record_is_thinned_for_all_lines_together():
    rng = np.random.default_rng(0)
    n = 50_000
    t, y = np.arange(n) * 1e-3, np.cumsum(rng.standard_normal(n))
    runs = {"base": y + rng.standard_normal(n), "base + drift": y + 0.1 * rng.standard_normal(n)}
    c = traces.Comparison(t, rng.standard_normal(n), y, runs, {"base": 1.0, "base + drift": 0.1}, 0.1, "long", None)
    assert c.keep.size <= POINTS + 10
    for error in c.errors.values():
        assert np.abs(error[c.keep]).max() == np.abs(error).max()


def test_pictures_from_python(stage_diagnosis):
    from narx_sym.report.plots import new_axes

    d = stage_diagnosis
    figure, ax = new_axes()
    assert d.plot_ladder(ax=ax, units=STAGE_UNITS) is figure and ax.get_ylabel()
    assert [t.get_text() for t in ax.get_xticklabels()] == d.rungs
    figure, ax = new_axes()
    assert d.plot_candidates(ax=ax) is figure and ax.get_xlabel() and ax.get_legend() is not None
    shown = d.plot_comparison(units=STAGE_UNITS)
    labels = {a.get_xlabel() for a in shown.axes} | {a.get_ylabel() for a in shown.axes}
    assert {"time [s]", "u [rad]", "y [mm]", "measured - simulated [mm]"} <= labels
    assert shown.axes[0].get_ylim() == shown.axes[2].get_ylim()  # before and after
    with pytest.raises(ns.NarxError, match="5 axes"):
        d.plot_comparison(axes=[ax])
    assert d.plot_where_it_fails(STAGE_UNITS).axes
    paper = ns.NARX.from_terms(["y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"],
                               theta=[1.0, 0.77, 1.44e-2, -1e-2])  # fmt: skip
    paper = paper.replace(info=Info(ranges={"u": (-40.0, 40.0)}))
    _, ax = new_axes()
    paper.plot_quasi_static(ax=ax, units={"u": "V", "y": "um"})
    assert ax.get_xlabel() == "u [V]" and ax.get_ylabel() == "y [um]" and len(ax.lines) > 2
    drawn = derived.quasi_static(paper, {"u": "V"})
    assert drawn is not None and "attracting" in drawn.svg


def test_a_picture_never_guesses_the_inputs(tmp_path):
    """The range is that of the fit, else of a record; a model that nobody has used anywhere is not drawn."""
    from narx_sym.report.plots import plot_reversal_curves, reversal_curves

    n = np.arange(2000)
    source, slow = 1.8 + 1.8 * np.sin(2 * np.pi * n / 500), ns.NARX.from_terms(["y[k-1]", "phi1[k-1]"], [1.0, 12.0])
    record = ns.Record.from_arrays(source, slow.simulate(source, -118.0), Ts=0.01)
    for draw in (slow.plot_quasi_static, lambda: plot_reversal_curves(slow), lambda: reversal_curves(slow)):
        with pytest.raises(ns.NarxError, match="range of u is not known"):
            draw()
    ns.save(slow, tmp_path / "m.json")
    axes = slow.plot_quasi_static(record=record).axes[0], slow.fit(record).plot_quasi_static().axes[0]
    for ax in axes:
        drawn = np.concatenate([line.get_xdata() for line in ax.lines])
        assert drawn.min() == pytest.approx(0.0, abs=1e-3) and drawn.max() == pytest.approx(3.6, abs=1e-3)
        loop = next(line for line in ax.lines if line.get_label() == "loop of the model").get_ydata()
        assert np.allclose([loop.min(), loop.max()], [record.y.min(), record.y.max()], atol=1.0)
    assert all(0 <= u.min() and u.max() <= 3.6 + 1e-9 for u, _ in reversal_curves(slow, record=record))
    assert derived.quasi_static(slow, {}) is None and derived.quasi_static(slow, {}, record=record) is not None


# ---- hostile names, notebooks -------------------------------------------------------------------------------------


def test_hostile_names_stay_text(hostile, tmp_path):
    path = tmp_path / "r.html"
    hostile.report(path, {"u": "<b>V", "y": "</title>$"})
    text = path.read_text(encoding="utf-8")
    assert "<script>alert" not in text and "<b>V" not in text and "</title>$" not in text
    assert "&lt;script&gt;alert(1)" in text
    # What the JSON and the recursions hold of it cannot end their script.
    assert len(re.findall(r"<script\b", text)) == len(re.findall(r"</script>", text)) == 3


def test_what_notebooks_show(hostile, stage_diagnosis):
    for thing in (hostile, hostile.model, stage_diagnosis, stage_diagnosis.model, stage_diagnosis.model.compensator()):
        shown = thing._repr_html_()
        assert "<script" not in shown and shown.count("<table") == shown.count("</table>")
        assert "<math" in shown or "<svg" in shown or 'class="latex"' in shown
    assert "<math" in stage_diagnosis.model._repr_html_() and "<svg" in stage_diagnosis._repr_html_()


# ---- equations, numbers, units ------------------------------------------------------------------------------------


def test_equations_of_candidates_speak_of_their_own_signals(stage_diagnosis):
    """What the first effect at the input acts on is u: there is no sequence that another one lets through."""
    shown = [c for s in stage_diagnosis.steps for c in s.candidates]
    assert any(c.where == "input" for c in shown)
    for c in shown:
        known = {s.left.base.name for s in c.shown.model.states}
        assert ("passed" in c.latex) == ("passed" in known), (c.effect, c.latex)
        assert all(f"{p}_{{" not in c.latex.replace("_{k", "") for p in c.variant.shape)  # by their short names


def test_equations_are_mathml_not_latex(page):
    assert 'class="latex"' not in page
    for block in re.findall(r"<math .*?</math>", page, flags=re.DOTALL):
        assert len(list(ET.fromstring(block).iter())) > 3


@pytest.mark.parametrize(
    "text", [r"\text{if <script>alert(1)</script> & b}", r"\frac{", r"\href{javascript:alert(1)}{x}"]
)
def test_odd_latex_is_harmless(text):
    shown = from_latex(text)
    assert "<script" not in shown and "href" not in re.sub(r"<code.*?</code>", "", shown)
    ET.fromstring(shown)


def test_digits_and_marks():
    assert "0.3027" in from_latex(r"y_{k} = 0.30272786 u_{k}", 4) and "0.30272786" in from_latex(r"0.30272786 u_{k}")
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], theta=[0.5, 2.0])
    assert 'class="new"' in marked(model, [model.symbols[1]]) and 'class="new"' not in marked(model)
    assert mathml(model.sigma_y).startswith("<math")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (0.0203, "0.0203"),
        (1234.56, "1235"),
        (1.5e-7, "1.50e-7"),
        (-2.5e8, "-2.50e8"),
        (np.nan, "-"),
        (9.996, "10.0"),
    ],
)
def test_numbers_are_short(value, shown):
    assert words.number(value) == shown


def test_moved_parameters_are_named():
    rows = [parameters.Parameter("a", "", "", (1.0, 0.1), (2.0, 0.1)), parameters.Parameter("b", "", "", (1.0, 0.5), (1.2, 0.5)),
            parameters.Parameter("c", "", "", (1.0, 0.1), None)]  # fmt: skip
    said = parameters.moved(rows)
    assert "a from 1.00 to 2.00" in said and "b from" not in said and said.endswith("redundant: c.")


def test_an_experiment_gets_its_units(stage_diagnosis):
    e = stage_diagnosis.experiment
    for name, told in (
        ("sine of 2 Hz with growing amplitude, amplitude 0.5", "sine of 2 Hz with growing amplitude, amplitude 0.5 V"),
        ("random levels, a new one every 1 s, moving at 42.1 per s", "random levels, a new one every 1 s, moving at 42.1 V/s"),
        ("rest at -1.5 V for 3 s", None),
        ("sine of 3 Hz, 10 % of the amplitude and then all of it, full range", None),
    ):  # fmt: skip
        step = replace(stage_diagnosis.steps[0], experiment=replace(e, name=name))
        found = words.with_units(replace(stage_diagnosis, steps=[step]), {"u": "V"})
        assert found.experiment.name == (told or name)


def test_a_minus_is_not_between_factors():
    c, s = sp.symbols("c s", real=True)
    model = ns.Model(ns.y[ns.k - 1] + c * sp.tanh((ns.u[ns.k] - ns.u[ns.k - 1]) / s), (c, s), [5.72, 0.2486612])
    for numbers in (False, True):
        assert "5.72 " not in (shown := model.latex(numbers=numbers)) or r"5.72\,\tanh" in shown, shown
        assert "- 1" not in shown and "-1 " not in shown
    shown = marked(model.replace(info=replace(model.info, digits=4)), values=True)
    assert "4.02" in shown and not re.search(r"\d\.\d{4}", shown)  # four digits are enough, also inside a function


def test_the_scale_that_was_given_is_that_of_the_page(stage_diagnosis, monkeypatch):
    asked = []
    monkeypatch.setattr(verdict, "physical", lambda *given: asked.append(given[2]) or "")
    for chosen in ({}, {"scale": "u=3N/V"}):
        verdict.verdict(Material(stage_diagnosis, STAGE_UNITS, [], chosen))
    assert asked == [None, "u=3N/V"]
