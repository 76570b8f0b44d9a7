"""The live part of the report as a widget: what its sliders say comes back to Python."""

import json
import sys

import live
import numpy as np
import pytest

import narx_sym as ns
from narx_sym.fit.evaluate import free_run

anywidget = pytest.importorskip("anywidget")
SHOW = """async ([source, page]) => {
  const url = URL.createObjectURL(new Blob([source], {type: "text/javascript"}));
  const {default: widget} = await import(url);
  window.kept = {page};
  window.saved = 0;
  const model = {get: name => kept[name], set: (name, value) => { kept[name] = value; }, save_changes: () => saved++};
  window.stop = widget.render({model, el: document.body});
}"""
DRAG = """position => {
  const input = document.querySelector(".sliders:not([hidden]) input");
  input.value = position;
  input.dispatchEvent(new Event("input", {bubbles: true}));
}"""


@pytest.fixture(scope="module")
def widget(stage_diagnosis):
    return stage_diagnosis.live({"u": "rad", "y": "mm"})


@pytest.mark.skipif(bool(live.why_no_browser()), reason=live.why_no_browser() or "-")
def test_a_slider_moves_the_model_in_python(widget, stage_diagnosis, browser):
    said = []
    page = browser.new_page(viewport={"width": 1000, "height": 800})
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: said.append(str(e)))
    page.evaluate(SHOW, [widget._esm, widget.page])
    page.wait_for_function("() => window.kept.rms > 0")
    best = page.evaluate("() => window.kept")
    page.frames[1].click("#hero-add")
    added = "before => window.kept.chosen === 1 && window.kept.rms < before"  # a page that is busy says it in turn
    page.wait_for_function(added, arg=best["rms"])
    best = page.evaluate("() => ({...window.kept})")
    page.frames[1].evaluate(DRAG, 100)
    page.wait_for_function("before => window.kept.rms !== before", arg=best["rms"])
    moved = page.evaluate("() => window.kept")
    height = page.evaluate("() => document.querySelector('iframe').clientHeight")
    page.close()
    assert not said and height > 400
    for kept in (best, moved):
        widget.chosen, widget.theta, widget.rms = kept["chosen"], kept["theta"], kept["rms"]
        record = stage_diagnosis.steps[0].base.split.records[0]
        error = np.sqrt(np.mean((record.y - free_run(widget.model, record)) ** 2))
        assert kept["rms"] == pytest.approx(error, rel=0.02)  # its start states are those of the fit
    assert moved["rms"] > best["rms"] and moved["added"] == "backlash"
    assert np.sum(np.array(moved["theta"]) != best["theta"]) == 1


def test_without_sliders_the_model_is_that_of_the_diagnosis(stage_diagnosis):
    made = stage_diagnosis.live()
    assert made.model.equation in [m.equation for m in (stage_diagnosis.steps[0].base.model, stage_diagnosis.model)]
    assert json.loads(json.dumps(made.get_state(["chosen", "theta", "rms"])))["theta"] == []


def test_without_the_extra_it_says_what_to_install(stage_diagnosis, monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "narx_sym.report.notebook.widget", raising=False)
    with pytest.raises(ns.ModelError, match=r"narx-sym\[notebook\]"):
        stage_diagnosis.live()
