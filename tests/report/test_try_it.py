"""The live part of the report, in a browser: what its sliders show is what Python computes."""

import base64
import json
import re

import live
import numpy as np
import pytest

from narx_sym.engines.compile import compile
from narx_sym.report.panels import try_it

pytestmark = pytest.mark.skipif(bool(live.why_no_browser()), reason=live.why_no_browser() or "-")
NAMES = {"backlash", "hysteresis", "coulomb_friction"}  # kinks, a memory, a sign
ROUNDS = 6


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as p:
        opened = p.chromium.launch(executable_path=live.CHROMIUM, args=live.FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def opened(browser, stage_report):
    """Open the report; afterwards nothing must have been complained of, or asked for."""
    said, asked = [], []
    context = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True)
    page = context.new_page()
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: said.append(str(e)))
    page.on("request", lambda r: asked.append(r.url))
    page.goto(stage_report.as_uri())
    page.wait_for_function("document.getElementById('try_it').dataset.rms")
    yield page
    context.close()
    assert not said and [a for a in asked if not a.startswith("data:")] == [stage_report.as_uri()]


@pytest.fixture(scope="module")
def told(stage_report):
    found = re.search(
        r'<script type="application/json" id="try-data">(.*?)</script>', stage_report.read_text("utf-8"), re.S
    )
    return json.loads(found[1])


@pytest.fixture(scope="module")
def tried(stage_diagnosis):
    return try_it.models(stage_diagnosis)


def samples(one):
    return one["offset"] + np.frombuffer(base64.b64decode(one["data"]), "<f4").astype(float)


def error(tried, told, m, theta):
    """Measured minus simulated in Python, along the page's own samples and from its own start."""
    problem, recursion = tried[m].fitted.problem, tried[m].fitted.model.recursion
    y, u = (samples(one) for one in told["signals"])
    start = dict(zip(map(lambda b: str(b.label), recursion.states), told["models"][m]["start"], strict=True))
    run = compile(recursion)({"u": u}, theta, start, on_divergence="nan")["y"]
    found = y - run
    found[: problem.depth] = 0.0
    return found


def state(page):
    """What the page says after its next frame."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    data = page.evaluate("() => ({...document.getElementById('try_it').dataset})")
    return {name: json.loads(text) if text != "NaN" else np.nan for name, text in data.items()}


def drag(page, m, positions):
    page.evaluate(
        """([m, positions]) => positions.forEach((position, i) => {
          const input = document.getElementById(`try-${m}-${i}`);
          input.value = position;
          input.dispatchEvent(new Event("input", {bubbles: true}));
        })""",
        [m, positions],
    )


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_every_slider_gives_the_error_that_python_gives(opened, tried, told):
    rng = np.random.default_rng(1)
    effects = {e.effect for one in tried for e in one.fitted.model.effects}
    assert effects >= NAMES and len(tried) == 5
    finite = 0
    for m in range(len(tried)):
        opened.check(f'input[name="try-model"][value="{m}"]')
        count = len(told["models"][m]["parameters"])
        for i in range(ROUNDS):
            positions = rng.integers(-200, 201, count) // (1, 1, 4, 4, 20, 20)[i]
            drag(opened, m, positions.tolist())
            now = state(opened)
            expected = error(tried, told, m, now["theta"])
            assert now["model"] == m and now["rms"] == pytest.approx(rms(expected), rel=1e-9, nan_ok=True)
            held = np.concatenate([expected[a:b] for a, b in told["held"]])
            assert now["held"] == pytest.approx(rms(held), rel=1e-9, nan_ok=True)
            finite += np.isfinite(now["rms"])
    assert finite > 2 * len(tried)


def test_the_optimum_is_the_figure_of_the_report(opened, tried, told, stage_diagnosis):
    """The page's samples have seven digits: so has the figure."""
    for m, one in enumerate(tried):
        opened.check(f'input[name="try-model"][value="{m}"]')
        now, fitted = state(opened), one.fitted
        assert now["theta"] == list(fitted.model.theta)
        assert now["rms"] == pytest.approx(rms(error(tried, told, m, fitted.model.theta)), rel=1e-9)
        assert now["rms"] == pytest.approx(rms(fitted.errors[0]), rel=1e-4)
        assert now["held"] == pytest.approx(np.sqrt(fitted.mean_square(fitted.split.held)), rel=1e-4)
    ladder = [rung["validation"] * stage_diagnosis.steps[0].base.problem.spread for rung in stage_diagnosis.ladder]
    opened.check('input[name="try-model"][value="1"]')
    assert state(opened)["held"] == pytest.approx(ladder[-1], rel=1e-4)


def test_reset_and_keys(opened):
    begun = state(opened)
    slider = opened.locator(".sliders:not([hidden]) input").first
    slider.focus()
    opened.keyboard.press("ArrowRight")
    moved = state(opened)
    assert moved["theta"] != begun["theta"] and moved["rms"] != begun["rms"]
    opened.keyboard.press("ArrowLeft")
    assert state(opened) == begun
    opened.keyboard.press("End")
    assert state(opened)["rms"] > begun["rms"]
    opened.click("#try-reset")
    assert state(opened) == begun and slider.input_value() == "0"


def test_the_switch_keeps_what_was_moved(opened):
    drag(opened, 1, [7])
    moved = state(opened)
    opened.check('input[name="try-model"][value="0"]')
    assert opened.locator('.sliders[data-model="1"]').is_hidden() and state(opened)["model"] == 0
    opened.check('input[name="try-model"][value="1"]')
    assert state(opened) == moved


def test_zoom(opened, told):
    box = opened.locator("#try-time").bounding_box()
    opened.locator("#try-time").scroll_into_view_if_needed()
    box = opened.locator("#try-time").bounding_box()
    opened.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 50)
    opened.mouse.down()
    opened.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 60, steps=4)
    opened.mouse.up()
    now = state(opened)
    assert 0 < now["from"] < now["to"] < told["n"] and 0.1 < (now["to"] - now["from"]) / told["n"] < 0.3
    opened.click("#try-later")
    assert state(opened)["from"] > now["from"]
    opened.locator("#try-time").dblclick()
    assert (state(opened)["from"], state(opened)["to"]) == (0, told["n"])
    opened.click("#try-worst")
    assert [state(opened)["from"], state(opened)["to"]] == told["worst"]
    assert state(opened)["rms"] == now["rms"]


@pytest.mark.parametrize("scheme", ("light", "dark"))
@pytest.mark.parametrize("width", (390, 1280))
def test_it_fits_and_is_accessible(browser, stage_report, scheme, width):
    from axe_playwright_python.sync_playwright import Axe

    context = browser.new_context(viewport={"width": width, "height": 844}, color_scheme=scheme)
    page = context.new_page()
    page.goto(stage_report.as_uri())
    page.wait_for_function("document.getElementById('try_it').dataset.rms")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate("document.querySelectorAll('#try_it details').forEach(d => d.open = true)")
    found = Axe().run(page, context="#try_it").response["violations"]
    assert not found, [(v["id"], [n["html"][:90] for n in v["nodes"]]) for v in found]
    outline = page.evaluate(
        """() => { const input = document.querySelector('.sliders:not([hidden]) input'); input.focus({focusVisible: true});
        return getComputedStyle(input).outlineStyle; }"""
    )
    assert outline != "none"
    context.close()


def test_without_scripts_it_is_not_there(browser, stage_report):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(stage_report.as_uri())
    assert page.locator("#try_it").is_hidden() and page.locator('nav a[href="#try_it"]').is_hidden()
    assert page.locator("#compare").is_visible()
    context.close()


@pytest.mark.parametrize("level", (0.0, 1e5))
def test_samples_keep_seven_digits_of_what_moves(level):
    x = level + np.random.default_rng(0).standard_normal(1000)
    one = try_it.packed(x)
    assert np.array_equal(try_it.unpacked(one), samples(one))
    assert np.abs(samples(one) - x).max() < 3e-7


def test_a_long_record_is_cut_and_said_so(stage_diagnosis, monkeypatch):
    from narx_sym.report import page

    monkeypatch.setattr(try_it, "MOST_SAMPLES", 500)
    (part,) = page.sections(stage_diagnosis, keys=["try_it"])
    assert "its first 500 of 2000 samples" in part.html
    found = json.loads(re.search(r'id="try-data">(.*?)</script>', part.html, re.S)[1])
    assert found["n"] == 500 and all(samples(one).size == 500 for one in found["signals"])
    assert all(b <= 500 for _, b in found["held"]) and found["worst"][1] <= 500
