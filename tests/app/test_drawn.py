"""A reference that is drawn: what the server makes of its points, and drawing in a headless Chromium."""

import itertools
import math
import re
from types import SimpleNamespace

import live
import numpy as np
import pytest

import narx_sym as ns
from narx_sym.app import workbench
from narx_sym.app.choice import Said, points_of
from narx_sym.app.workbench import Workbench
from narx_sym.tasks.reference import MOST, MOST_POINTS

reason = live.why_no_browser()
LEFT, RIGHT, TOP, BOTTOM = 58, 8, 8, 36  # of the picture's axes [px]


# -- without a browser ---------------------------------------------------------------------------------------------


@pytest.fixture
def bench(monkeypatch):
    """A workbench with data and a model, of which nothing but that it is there is needed here."""
    monkeypatch.setattr(workbench, "signals_svg", lambda *what: "")
    made = Workbench()
    u, y = live.hidden(N=300)
    made.upload("stage.csv", live.csv(u=u, y=y))
    made.revisions = [SimpleNamespace(model=ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 0.5]))]
    yield made
    made.close()


def test_points_may_stand_in_lines_or_between_semicolons():
    expected = [(0.0, 1.5), (2.0, -0.25)]
    for text in ("0 1.5\n2 -0.25", "0 1,5; 2 -0,25", "\r\n0\t1.5\r\n\r\n2   -0.25\r\n"):
        assert points_of(text) == expected


def test_the_first_drawing_lies_within_the_outputs_and_may_run(bench):
    wanted, record = bench.wanted, bench.record
    wanted.kind = "drawn"
    with Said(bench) as said:
        made = wanted.made(said, record, "mm")()
    points = points_of(wanted.points)
    assert not bench.faults and len(points) == 5 and points[-1][0] == float(wanted.seconds)
    assert made.r == pytest.approx(np.interp(made.t, *zip(*points, strict=True))) and made.Ts == record.Ts
    assert record.y.min() < made.r.min() < made.r.max() < record.y.max()


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ("", "There are 0 points"), ("0 1\n2", "Point 2 must be a time and a level"), ("0 1 2", "Point 1 must be"),
        ("0 1\n1 two", "level of point 2 must be a number"), ("nan 1", "time of point 1 must be a number"),
        ("0 inf", "level of point 1 must be a number"), ("0 1e999", "level of point 1 must be a number"),
        ("0 1\n1 2\n1 3", "Times must increase"), ("1 1\n0 2", "Times must increase"), ("-1 0", "outside the duration"),
        ("0 1\n9 1", "The point at 9 s lies outside the duration, 0 to 8 s."), ("<b>0</b>", "Point 1 must be"),
        ("\n".join(f"{k / 100} 0" for k in range(MOST_POINTS + 1)), f"from 1 to {MOST_POINTS}"),
        ("0 " + "1" * 100_000, "must be a number"),
    ],
)  # fmt: skip
def test_bad_points_are_one_message_at_their_field(bench, points, why):
    bench.run_law(kind="drawn", points=points, seconds="8")
    assert list(bench.faults) == ["points"] and why in bench.error and not bench.busy
    assert "\n" not in bench.error and len(bench.error) < 150
    assert bench.wanted.points == points  # what was typed or drawn stays


@pytest.mark.parametrize(
    ("seconds", "why"), [("", "missing"), ("long", "number"), ("0", "positive"), ("1e9", f"{MOST} are taken")]
)
@pytest.mark.parametrize("kind", ("drawn", "sine"))
def test_a_bad_duration_is_one_message_at_its_field(bench, kind, seconds, why):
    bench.run_law(kind=kind, points="0 1", seconds=seconds)
    assert list(bench.faults) == ["seconds"] and why in bench.error and not bench.busy


# -- in a browser --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    pytest.importorskip("nicegui", reason="the extra narx-sym[app] is not installed")
    made = live.Server(cwd=tmp_path_factory.mktemp("drawn"))
    yield made
    made.stop()


@pytest.fixture(scope="module")
def page(server, browser):
    """The Law tab of a diagnosed page; it is stepped on by the tests below, and must not complain of anything."""
    u, y = live.hidden(N=400)
    made = browser.new_page(viewport={"width": 1280, "height": 900})
    wrong = live.wrong(made, server)
    made.set_default_timeout(240_000)
    made.goto(server.url)
    upload = {"name": "stage.csv", "mimeType": "text/csv", "buffer": live.csv("t,u [V],y [mm]", u=u, y=y)}
    made.set_input_files("#data-file", files=[upload])
    made.get_by_text("Read: 400 samples").wait_for()
    upload = {"name": "base.json", "mimeType": "application/json", "buffer": live.linear_model(u, y)}
    made.set_input_files("#model-file", files=[upload])
    made.get_by_text("Model file base.json").wait_for()
    made.get_by_role("button", name="Diagnose").click()
    made.locator("#found").wait_for()
    made.get_by_role("tab", name="Law").click()
    made.get_by_role("radio", name="Drawn").click()
    made.get_by_role("slider", name="Point 1 of 5").wait_for()
    yield made
    made.close()
    assert wrong == []


def text(page):
    return page.locator(".field-points textarea").input_value()


def levels(page, times):
    """The levels of the points as they stand, (N,) array [mm]."""
    return np.interp(times, *zip(*points_of(text(page)), strict=True))


def at(page, across, up):
    """A place on the screen, from shares of the axes."""
    canvas = page.locator(".drawing canvas")
    canvas.evaluate("one => one.scrollIntoView({block: 'end'})")
    box = canvas.bounding_box()
    x = box["x"] + LEFT + across * (box["width"] - LEFT - RIGHT)
    return x, box["y"] + TOP + (1 - up) * (box["height"] - TOP - BOTTOM)


def draw(page, places):
    page.mouse.move(*places[0])
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*place)
    page.mouse.up()


def runs(page):
    """Run the law; return the sentence of the run."""
    before = page.locator(".ran").inner_text() if page.locator(".ran").count() else ""
    page.get_by_role("button", name="Run the law").click()
    page.wait_for_function("old => (document.querySelector('.ran')?.innerText ?? old) !== old", arg=before)
    return page.locator(".ran").inner_text()


long = pytest.mark.long
in_browser = pytest.mark.skipif(bool(reason), reason=reason)


@long
@in_browser
def test_a_curve_is_drawn_with_the_mouse_and_followed(page, tmp_path):
    """What runs is what was drawn: to a pixel, straight between points, at the record's rate, within limits."""
    seconds = float(page.get_by_role("textbox", name="Duration").input_value())
    begun, wave = text(page), [(s, 0.5 + 0.2 * math.sin(12 * s)) for s in np.linspace(0.25, 0.75, 80)]
    draw(page, [at(page, *place) for place in wave])
    drawn = points_of(text(page))
    inner = [(time, level) for time, level in drawn if 0.3 * seconds < time < 0.7 * seconds]
    assert 5 < len(inner) < 40 and all(a[0] < b[0] for a, b in itertools.pairwise(drawn))
    low, high = (float(page.get_by_role("slider").first.get_attribute(f"aria-value{end}")) for end in ("min", "max"))
    for time, level in inner:
        share = (time / seconds + 0.015) / 1.03
        assert abs((level - low) / (high - low) - 0.5 - 0.2 * math.sin(12 * share)) < 0.02
    for title, limit in (("Smallest input", "-2"), ("Largest input", "2")):
        page.get_by_role("textbox", name=title).fill(limit)
    said = runs(page)
    assert re.search(r"with the law [\d.e-]+ mm rms", said) and text(page) != begun
    assert page.get_by_role("button", name="Run the law").evaluate("one => one.contains(document.activeElement)")
    with page.expect_download() as waiting:
        page.get_by_role("link", name="Run of the law (CSV)").first.click()
    waiting.value.save_as(tmp_path / "run.csv")
    t, r, m, _ = np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1).T
    assert r == pytest.approx(levels(page, t)) and t == pytest.approx(live.TS * np.arange(round(seconds / live.TS)))
    assert np.abs(m).max() <= 2


@long
@in_browser
def test_a_click_sets_a_point_and_a_point_is_dragged(page):
    count = len(points_of(text(page)))
    page.mouse.click(*at(page, 0.1, 0.8))
    focused = page.locator(".drawing-point:focus")
    assert len(points_of(text(page))) == count + 1
    before = float(focused.get_attribute("aria-valuenow"))
    draw(page, [at(page, 0.1, 0.8), at(page, 0.1, 0.5), at(page, 0.1, 0.3)])
    assert float(focused.get_attribute("aria-valuenow")) < before and len(points_of(text(page))) == count + 1


@long
@in_browser
def test_keys_alone_draw_and_run(page):
    """A point has a visible focus; it is moved, set, taken away and taken back, and the law is run: no pointer."""
    first = page.get_by_role("slider", name=re.compile("Point 2 of"))
    page.get_by_role("textbox", name="Duration").focus()
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert first.evaluate("one => one === document.activeElement && getComputedStyle(one).outlineStyle") == "solid"
    begun, steps = points_of(text(page)), page.locator(".steps .step").count()
    for key in ("ArrowUp", "ArrowUp", "ArrowRight"):
        page.keyboard.press(key)
    time, level = points_of(text(page))[1]
    assert time > begun[1][0] and level > begun[1][1]
    assert first.get_attribute("aria-valuetext") == page.locator(".drawing-said").inner_text().partition(": ")[2]
    page.keyboard.press("Enter")
    assert len(points_of(text(page))) == len(begun) + 1
    page.keyboard.press("Delete")
    assert len(points_of(text(page))) == len(begun)
    for _ in range(3):
        page.keyboard.press("Control+z")
    assert points_of(text(page)) == begun and page.locator(".steps .step").count() == steps
    page.keyboard.press("Control+y")
    assert points_of(text(page))[1] == (time, level) and page.locator(".wrong").count() == 0
    page.keyboard.press("Escape")
    said = page.locator(".ran").inner_text()
    while page.evaluate("document.activeElement.innerText.trim()") != "Run the law":
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_function("old => document.querySelector('.ran').innerText !== old", arg=said)


@long
@in_browser
def test_points_typed_are_drawn_and_what_is_wrong_stands_there(page):
    good = text(page)
    page.get_by_text("The points as text").click()
    field = page.get_by_role("textbox", name="Time [s] and level [mm]")
    field.fill("0 0\n1 2 3")
    assert page.get_by_role("slider").count() == 0 and "cannot be read" in page.locator(".drawing-warned").inner_text()
    page.get_by_role("button", name="Run the law").click()
    page.get_by_role("alert").get_by_text("Point 2 must be a time and a level").wait_for()
    assert field.get_attribute("aria-invalid") == "true" and page.locator(".wrong").count() == 0
    field.fill("0 0; 0.5 1; 1 0")
    assert page.get_by_role("slider").count() == 3
    runs(page)
    assert field.get_attribute("aria-invalid") is None
    field.fill(good)
    field.press("Tab")


@long
@in_browser
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_it_fits_and_is_accessible(page, width, scheme):
    from axe_playwright_python.sync_playwright import Axe

    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)
    page.wait_for_timeout(400)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page).response["violations"]
    assert not [(v["id"], v["nodes"][0]["html"][:200]) for v in found if v["impact"] in ("serious", "critical")]
    page.set_viewport_size({"width": 1280, "height": 900})
    page.emulate_media(color_scheme="light")


@long
@in_browser
def test_another_kind_and_back_keeps_the_drawing(page):
    drawn = text(page)
    page.get_by_role("radio", name="A file").click()
    upload = {"name": "wanted.csv", "mimeType": "text/csv", "buffer": b"t,r\n0,0\n0.01,1\n"}
    page.set_input_files("#reference-file", files=[upload])
    page.get_by_text("Taken: wanted.csv.").wait_for()
    page.get_by_role("radio", name="Drawn").click()
    page.get_by_role("slider").first.wait_for()
    assert text(page) == drawn and page.get_by_role("slider").count() == len(points_of(drawn))


@long
@in_browser
def test_what_the_laws_limits_hold_is_marked_and_a_drawing_is_found_again(page):
    assert page.get_by_text("let the model rest").count() == 0
    page.get_by_role("button", name="Open the compensator").click()
    page.get_by_text("let the model rest").wait_for()
    drawn, said = text(page), page.locator(".ran").inner_text()
    page.reload()
    page.get_by_role("tab", name="Law").click()
    page.get_by_text("let the model rest").wait_for()
    assert page.get_by_role("radio", name="Drawn").is_checked()
    assert text(page) == drawn and page.locator(".ran").inner_text() == said
    assert page.get_by_role("slider").count() == len(points_of(drawn))
