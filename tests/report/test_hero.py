"""The live part of the report, in a browser: what its sliders show is what Python computes."""

import base64
import json
import re
from types import SimpleNamespace

import live
import numpy as np
import pytest
from sampling import more, only

import narx_sym as ns
from narx_sym.data.examples import STAGE_UNITS
from narx_sym.engines.compile import compile
from narx_sym.fit.freerun import FreeRun
from narx_sym.report import comparison, hero
from narx_sym.report.page import material
from narx_sym.report.panels import verdict

pytestmark = pytest.mark.skipif(bool(live.why_no_browser()), reason=live.why_no_browser() or "-")
NAMES = {"backlash", "hysteresis", "coulomb_friction"}  # kinks, a memory, a sign
ROUNDS = 6
MOVING = ("left", "added")  # they change while the portrait falls
CLIPBOARD = ["clipboard-read", "clipboard-write"]
READY = "() => document.getElementById('hero').dataset.rms"


@pytest.fixture(scope="module")
def opened_once(browser, stage_report):
    """Open the report; afterwards nothing must have been complained of, or asked for."""
    said, asked = [], []
    context = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True, permissions=CLIPBOARD)
    page = context.new_page()
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: said.append(str(e)))
    page.on("request", lambda r: asked.append(r.url))
    page.goto(stage_report.as_uri())
    page.wait_for_function(READY)
    assert page.evaluate("document.documentElement.scrollHeight") < 5 * 900  # all else is folded
    assert page.locator("#hero-add").bounding_box()["y"] < 800 and len(page.query_selector_all("canvas")) == 7
    page.evaluate("document.querySelectorAll('section > details').forEach(one => one.open = true)")
    yield page, state(page)
    context.close()
    assert not said and [a for a in asked if not a.startswith("data:")] == [stage_report.as_uri()]


@pytest.fixture
def opened(opened_once):
    """The report as it was opened: what a test has moved is put back."""
    page, first = opened_once
    for switch in page.locator('input[name="switch"]').all():
        switch.check()
        page.click("#try-reset")
    page.check(f'input[name="switch"][value="{first["model"]}"]')
    page.locator("#try-time").dblclick()
    page.locator("#try-point").press("Home")
    now = state(page)
    assert all(now[name] == first[name] for name in ("rms", "held", "model", "theta"))
    return page


@pytest.fixture(scope="module")
def told(stage_report):
    found = re.search(
        r'<script type="application/json" id="hero-data">(.*?)</script>', stage_report.read_text("utf-8"), re.S
    )
    return json.loads(found[1])


@pytest.fixture(scope="module")
def tried(stage_diagnosis):
    return material(stage_diagnosis, STAGE_UNITS).once(hero.models)


@pytest.fixture(scope="module")
def gapped(tmp_path_factory):
    """A report on a record with a gap, a far level, a channel with a name that attacks, and an effect of the time."""
    rng = np.random.default_rng(1)
    n = 700
    u, other = rng.standard_normal(n), np.sin(np.arange(n) / 20)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + 0.3 * u[k - 1] * (1 + 0.5 * other[k])
    name = "</script><script>throw 1</script>"
    y += 1000 + np.arange(n) / n + 0.01 * rng.standard_normal(n)
    record = ns.Record(u, y, 5 + np.arange(n) * 0.01, 0.01, {name: other}, "gapped", (), (250,))
    catalogue = only("channel_gain", "ageing", "drift")
    base = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "1"]).fit(record)
    found = ns.diagnose(base, record, catalogue=catalogue)
    path = tmp_path_factory.mktemp("gapped") / "report.html"
    found.report(path, {"u": "V", "y": "$"})
    return found, path


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
    data = page.evaluate("() => ({...document.getElementById('hero').dataset})")
    return {name: json.loads(text) if text != "NaN" else np.nan for name, text in data.items() if name not in MOVING}


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
    assert effects >= NAMES and len(tried) == 4
    finite = 0
    for m in range(len(tried)):
        opened.check(f'input[name="switch"][value="{m}"]')
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
        opened.check(f'input[name="switch"][value="{m}"]')
        now, fitted = state(opened), one.fitted
        assert now["theta"] == list(fitted.model.theta)
        assert now["rms"] == pytest.approx(rms(error(tried, told, m, fitted.model.theta)), rel=1e-9)
        assert now["rms"] == pytest.approx(rms(fitted.errors[0]), rel=1e-4)
        assert now["held"] == pytest.approx(np.sqrt(fitted.mean_square(fitted.split.test)), rel=1e-4)
    opened.check('input[name="switch"][value="1"]')
    assert state(opened)["rms"] == pytest.approx(stage_diagnosis.ladder[-1]["train_rms"], rel=1e-4)


@more
def test_gaps_channels_and_the_time(browser, gapped):
    """The longest segment is run; the channel and the time come from the record too."""
    diagnosis, path = gapped
    page, said = browser.new_page(), []
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: said.append(str(e)))
    page.goto(path.as_uri())
    page.wait_for_function(READY)
    read = set()
    for m, one in enumerate(material(diagnosis).once(hero.models)):
        page.check(f'input[name="switch"][value="{m}"]')
        drag(page, m, [0] * (len(one.fitted.model.symbols) - 1) + [40])
        now, fitted, recursion = state(page), one.fitted, one.fitted.model.recursion
        problem = FreeRun(fitted.model.replace(theta=now["theta"]), list(fitted.split.records), None)
        problem.initial = fitted.problem.initial  # a slider moves no start
        error = problem.data[1]["y"] - problem.simulate(fitted.unknowns[fitted.problem.free :], 1)
        error[: problem.depth] = 0
        assert error.size == 450 and now["rms"] == pytest.approx(rms(error), rel=1e-4)
        read |= {str(b.label) for b in recursion.inputs}
    assert {"u", "t"} < read and len(read) == 3 and not said
    page.close()


def test_reset_and_keys(opened):
    opened.check('input[name="switch"][value="1"]')
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
    opened.check('input[name="switch"][value="1"]')
    drag(opened, 1, [7])
    moved = state(opened)
    opened.check('input[name="switch"][value="0"]')
    assert opened.locator('.sliders[data-model="1"]').is_hidden() and state(opened)["model"] == 0
    opened.check('input[name="switch"][value="1"]')
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


SIZES = [pytest.param(w, c, marks=[pytest.mark.long] * ((w, c) not in ((390, "dark"), (1440, "light"))))
         for w in (390, 768, 1440) for c in ("light", "dark")]  # fmt: skip


@pytest.mark.parametrize(("width", "scheme"), SIZES)
def test_it_fits_and_is_accessible(browser, stage_report, width, scheme):
    from axe_playwright_python.sync_playwright import Axe

    context = browser.new_context(viewport={"width": width, "height": 844}, color_scheme=scheme)
    page, wrong = context.new_page(), []
    page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: wrong.append(str(e)))
    page.on("request", lambda r: None if r.url.startswith(("file:", "data:")) else wrong.append(r.url))
    page.goto(stage_report.as_uri())
    page.wait_for_function(READY)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    found = Axe().run(page).response["violations"]
    assert not found, [(v["id"], [n["html"][:90] for n in v["nodes"]]) for v in found]
    outline = page.evaluate(
        """() => { const input = document.querySelector('.sliders:not([hidden]) input'); input.focus({focusVisible: true});
        return getComputedStyle(input).outlineStyle; }"""
    )
    page.emulate_media(media="print")
    assert outline != "none" and not wrong
    context.close()


def test_without_scripts_it_is_not_there(browser, stage_report):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(stage_report.as_uri())
    assert page.locator("#try_it, canvas").first.is_hidden() and page.locator("#hero-add").is_hidden()
    assert page.locator("#verdict svg.drawn").first.is_visible() and page.locator("#compare").is_visible()
    context.close()


@pytest.mark.parametrize("level", (0.0, 1e5))
def test_samples_keep_seven_digits_of_what_moves(level):
    x = level + np.random.default_rng(0).standard_normal(1000)
    one = hero.packed(x)
    assert np.array_equal(hero.unpacked(one), samples(one))
    assert np.abs(samples(one) - x).max() < 3e-7


def test_a_long_record_is_cut_and_said_so(stage_diagnosis, monkeypatch):
    from narx_sym.report import page

    monkeypatch.setattr(hero, "MOST_SAMPLES", 500)
    of = material(stage_diagnosis)
    (part,) = page.sections(stage_diagnosis, keys=["try_it"])
    assert "its first 500 of 2000 samples" in part.html
    found = json.loads(hero.data(of))
    assert found["n"] == 500 and all(samples(one).size == 500 for one in found["signals"])
    assert all(b <= 500 for _, b in found["held"]) and found["worst"][1] <= 500


def test_a_bad_cell_zooms_to_where_it_is_worst(opened, told, stage_diagnosis):
    misfit = stage_diagnosis.misfit
    marks = opened.locator("#where .cell")
    assert marks.count() > 10
    seen = set()
    for i in range(0, marks.count(), 7):
        mark = marks.nth(i)
        if not mark.is_visible():  # among what is folded
            continue
        mark.dispatch_event("click")
        now = state(opened)
        a, b = map(int, mark.get_attribute("data-stretch").split(","))
        assert now["from"] <= a < b <= now["to"] and now["to"] - now["from"] <= max(20, b - a)
        opened.wait_for_function("() => document.getElementById('hero').getBoundingClientRect().top < 400")
        seen.add((a, b))
    assert len(seen) > 2
    button = opened.locator("#where button.stretch").first
    button.press("Enter")
    a, b = map(int, button.get_attribute("data-stretch").split(","))
    first = max(misfit.table(), key=lambda r: max(r["share"], np.nan_to_num(r["share_missing"])))["panel"]
    inside = [np.any(p.cell[a:b] == p.worst) for p in (*misfit.panels, *misfit.panels_missing) if p.name == first]
    assert any(inside) and state(opened)["from"] <= a


def test_dots_stand_on_the_means_of_their_cells(opened, stage_diagnosis):
    """The picture is drawn twice, once for the page and once for the places: both must be the same."""
    from narx_sym.report.panels.registry import Material
    from narx_sym.report.panels.where import failures

    for failure in failures(Material(stage_diagnosis, {"u": "rad", "y": "mm"}))[:2]:
        for picture in failure.pictures[:1]:
            found = re.findall(r'<use xlink:href="#[^"]*" x="([\d.]+)" y="([\d.]+)"', picture.svg)
            marks = np.array(found, dtype=float) / np.array(picture.size) / 72 * 100
            for cell in failure.cells[picture.key]:
                assert np.abs(marks - (cell.left, cell.top)).sum(axis=1).min() < 0.5


def test_the_point_runs_along_the_loops(opened, told):
    opened.locator("#try-point").focus()
    opened.keyboard.press("End")
    assert state(opened)["point"] == told["n"] - 1 and opened.locator(".dot.run").is_visible()
    opened.keyboard.press("Home")
    opened.click("#try-play")
    opened.wait_for_function("() => Number(document.getElementById('hero').dataset.point) > 0")
    opened.click("#try-play")
    stopped = state(opened)["point"]
    opened.wait_for_timeout(80)
    assert state(opened)["point"] == stopped


def test_nothing_moves_by_itself_where_motion_is_not_wanted(browser, stage_report):
    context = browser.new_context(reduced_motion="reduce")
    page = context.new_page()
    page.goto(stage_report.as_uri())
    page.wait_for_function(READY)
    page.evaluate("document.querySelector('#try_it > details').open = true")
    assert page.locator("#try-play").is_hidden() and page.locator("#try-point").is_visible()
    assert page.evaluate("getComputedStyle(document.documentElement).scrollBehavior") == "auto"
    context.close()


def test_the_law_follows_a_dragged_reference(opened, told, stage_diagnosis):
    """By pointer and by keys; the input is what Python computes, for the parameters that the sliders say."""
    law, one = stage_diagnosis.model.compensator(), told["law"]
    canvas = opened.locator("#try-reference")

    def check():
        now = state(opened)["law"]
        turn = 2 * np.pi * np.maximum(np.arange(one["n"] + one["ahead"]) - one["lead"], 0) / now["period"]
        grows = np.where(turn < np.pi, (1 - np.cos(turn)) / 2, 1)
        r = one["middle"] + now["amplitude"] * grows * np.sin(turn)
        start = dict(zip([str(b.label) for b in law.exported().states], one["start"], strict=True))
        m = compile(law.exported())({"r": r}, now["theta"], start)["m"][one["lead"] : one["n"]]
        assert [now["low"], now["high"]] == pytest.approx([m.min(), m.max()], rel=1e-9)
        assert now["beyond"] == np.sum((m < one["limits"][0]) | (m > one["limits"][1]))
        return now

    first = check()
    assert first["amplitude"] == one["amplitude"] and first["period"] == one["period"]
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    opened.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.3 * box["height"])
    opened.mouse.down()
    opened.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.1 * box["height"], steps=3)
    opened.mouse.up()
    second = check()
    assert second["amplitude"] > first["amplitude"] and second["period"] > first["period"]
    opened.locator("#try-amplitude").press("Home")
    assert check()["amplitude"] == 0
    opened.locator("#try-amplitude").press("End")
    opened.locator("#try-period").press("Home")
    assert check()["beyond"] > 0 and "outside the measured range" in opened.inner_text("#try-law-said")
    drag(opened, one["model"], [3, -5])
    assert check()["theta"] != first["theta"]


def test_a_switch_moves_bars_loop_and_portrait(opened, told):
    """What is missing falls to what is left, in steps; the button throws the switch that the verdict names."""
    assert state(opened)["model"] == told["chosen"] == 0 and opened.inner_text("#hero-add") == "Show with backlash"
    opened.wait_for_timeout(700)
    before = left(opened)
    opened.click("#hero-add")
    opened.wait_for_function("most => Number(document.getElementById('hero').dataset.left) < most", arg=0.3 * before)
    now = state(opened)
    assert now["model"] == told["add"] == 1 and now["rms"] < 0.3 * told["models"][0]["errors"]["train"]["rms"]
    opened.check('input[name="switch"][value="2"]')
    assert opened.inner_text("#hero-add") == f"Show with {told['models'][2]['name'].removeprefix('+ ')}"


def test_the_brush_chooses_what_the_loop_shows(opened, told):
    canvas = opened.locator("#hero-strip")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    y, x = box["y"] + 20, [box["x"] + 58 + share * (box["width"] - 66) for share in (0.2, 0.4, 0.7)]
    opened.mouse.move(x[0], y)
    opened.mouse.down()
    opened.mouse.move(x[1], y, steps=3)
    opened.mouse.up()
    one = state(opened)
    assert [one["from"] / told["n"], one["to"] / told["n"]] == pytest.approx([0.2, 0.4], abs=0.02)
    opened.mouse.click(x[2], y)
    other = state(opened)
    assert other["to"] - other["from"] == pytest.approx(one["to"] - one["from"], abs=1)
    assert (other["from"] + other["to"]) / 2 / told["n"] == pytest.approx(0.7, abs=0.02)


def test_an_axis_shows_force_against_velocity():
    t = np.arange(50) * 0.1
    assert comparison.rate(t**2, 2, 0.1)[2:-2] == pytest.approx(2 * t[2:-2])
    assert comparison.rate(3 * t, 4, 0.1) == pytest.approx(np.full(50, 3.0))  # at the ends too


def test_three_places_show_the_numbers_of_evaluate(stage_diagnosis, told):
    """Report, notebook and app: the same JSON, and its errors are those of `evaluate`."""
    from narx_sym.app.story import shown
    from narx_sym.tasks.revise import Revision

    pages = [stage_diagnosis.live(STAGE_UNITS).page]
    bare = Revision("linear base", stage_diagnosis, stage_diagnosis.model)
    pages.append(shown((), bare, STAGE_UNITS).page)
    of = material(stage_diagnosis, STAGE_UNITS)
    for text in pages:
        found = json.loads(re.search(r'id="hero-data">(.*?)</script>', text, re.S)[1])
        assert found["models"][0] == told["models"][0] and found["portrait"]["x"] == told["portrait"]["x"]
        assert {one["name"]: one["errors"] for one in found["models"]} == {
            one["name"]: one["errors"] for one in told["models"]
        }
        assert re.findall(r"<b>([\d.]+ %)</b> <small>([^<]*)", text) == bars_of(of)
    (record,) = stage_diagnosis.steps[0].base.split.records
    for one, tried in zip(told["models"], of.once(hero.models), strict=True):
        error = ns.evaluate(tried.fitted.model, record)
        assert one["errors"]["train"] == pytest.approx({"rms": error.free_run_rms, "nrmse": error.free_run_nrmse})


def left(page):
    """The largest mean that the portrait shows."""
    return float(page.evaluate("document.getElementById('hero').dataset.left"))


def bars_of(of):
    """Share and size of every bar."""
    return [(share, size) for row in verdict.bars(of) for _, size, share, *_ in row["parts"]]


def test_what_is_folded_is_there_when_it_is_opened(opened):
    boxes = [one.bounding_box() for one in opened.locator("math").all() if one.is_visible()]
    assert len(boxes) > 10 and all(box["width"] > 20 and box["height"] > 10 for box in boxes)
    drawn = [one for one in opened.locator("svg.drawn").all() if one.is_visible()]
    assert len(drawn) > 6 and all(one.bounding_box()["width"] > 200 for one in drawn)
    held = [float(row.locator("td").nth(1).inner_text()) for row in opened.locator("#ladder tbody tr").all()]
    assert len(held) == 3 and held[1] < 0.3 * held[0]
    opened.evaluate("document.querySelector('#experiment > details').open = false; location.hash = 'experiment'")
    opened.locator("#experiment svg.drawn").first.wait_for()  # a link opens what it leads to


@pytest.mark.parametrize("name", ("model-latex", "model-python", "law-latex", "law-python"))
def test_copy_buttons_copy(opened, name):
    details = opened.locator(f"details.source:has(#{name})")
    details.evaluate("one => one.open = true")
    details.locator("button").click()
    details.get_by_text("Copied").wait_for()
    copied = opened.evaluate("navigator.clipboard.readText()").strip()
    assert copied == opened.locator(f"#{name}").text_content().strip() != ""


@pytest.mark.parametrize(("name", "begins"), [("next.csv", "t,u\n"), ("ladder.csv", "model,"), ("model.json", "{")])
def test_files_download(opened, tmp_path, name, begins):
    with opened.expect_download() as waiting:
        opened.locator(f'a[download="{name}"]').click()
    waiting.value.save_as(tmp_path / name)
    assert waiting.value.suggested_filename == name and (tmp_path / name).read_text().startswith(begins)


def test_paper_has_still_pictures_and_all_that_is_folded(browser, stage_report, tmp_path):
    page = browser.new_page()
    page.goto(stage_report.as_uri())
    page.wait_for_function(READY)
    page.evaluate("document.querySelector('#derived .equation').style.fontSize = '200px'")  # a long formula
    page.emulate_media(media="print")
    assert page.locator("#verdict svg.drawn").first.is_visible() and page.locator("canvas:visible").count() == 0
    wide = page.evaluate("[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().width)")
    assert page.locator("#derived math").first.is_visible() and max(wide) <= 690  # A4 less its margins
    page.pdf(path=tmp_path / "r.pdf")
    assert (tmp_path / "r.pdf").stat().st_size > 50_000
    page.close()


def test_a_candidate_of_a_part_of_the_record_is_fitted_over_all_of_it(stage_diagnosis):
    base = stage_diagnosis.steps[0].base
    for records, said in ((base.split.records, "shown"), ([r[:100] for r in base.split.records], "fitted")):
        shown = SimpleNamespace(split=SimpleNamespace(records=records))
        one = SimpleNamespace(likely=False, shown=shown, fitted="fitted")
        assert hero.fitted_of(one, base) is (shown if said == "shown" else one.fitted)
