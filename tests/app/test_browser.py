"""The report in a real Chromium, Debian's: it opens from disk without errors or requests, and can be read by all."""

import re
import shutil
from urllib.parse import unquote

import pytest

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt-get install chromium)"),
]
OPTIONS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
PATIENCE = 180_000  # [ms] on a machine that does much else at the same time
WIDE, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        # A profile of its own, which is deleted afterwards.
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS, headless=True)
        yield started
        started.close()


def new_page(browser, **options):
    """Return a page of a profile of its own."""
    context = browser.new_context(**options)
    context.set_default_timeout(PATIENCE)
    return context.new_page()


@pytest.fixture(scope="module")
def opened(browser, stage_report):
    """The report on a wide screen: the page, and what it complained about or asked for."""
    page, said = new_page(browser, accept_downloads=True, permissions=["clipboard-read", "clipboard-write"]), []
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda r: said.append(r.url) if not r.url.startswith(("file:", "data:", "blob:")) else None)
    page.on("dialog", lambda dialog: said.append("a dialog"))
    page.set_viewport_size(WIDE)
    page.goto(stage_report.as_uri())
    page.wait_for_function("window.Bokeh && Bokeh.documents.length >= 2 && Bokeh.documents.every(d => d.is_idle)")
    return page, said


def test_opens_from_disk_without_errors_or_requests(opened):
    page, said = opened
    assert said == [] and page.title()


def test_equations_have_a_size(opened):
    page, _ = opened
    boxes = [e.bounding_box() for e in page.locator("math").all()]
    assert len(boxes) > 10
    assert all(box and box["width"] > 20 and box["height"] > 10 for box in boxes)


def test_pictures_are_drawn(opened):
    page, _ = opened
    shown = [e for e in page.locator("svg.drawn").all() if e.is_visible()]
    assert len(shown) > 6
    for picture in shown:
        box = picture.bounding_box()
        assert box["width"] > 200 and box["height"] > 100 and picture.locator("path").count() > 5
    painted = page.evaluate(
        """() => Bokeh.documents.flatMap(d => d.roots()).map(root => {
            const canvas = Bokeh.index.get_by_id(root.id).canvas_view.primary.canvas;
            const seen = new Set(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
            return seen.size;
        })"""
    )
    assert len(painted) == 6 and min(painted) > 10  # four of the comparison, two of the experiment


def test_the_ladder_falls(opened):
    page, _ = opened
    cells = page.locator("#ladder table").first.locator("tbody tr").all()
    held = [float(row.locator("td").nth(1).inner_text()) for row in cells]
    assert len(held) == 3 and held[1] < 0.3 * held[0] and held[2] <= held[1] * 1.05
    alt = page.locator("#ladder svg").get_attribute("aria-label")
    said = [float(x) for x in re.findall(r"(?<![\w.])0\.\d+", alt)]
    assert said[0] > said[1] and said[0] == pytest.approx(held[0], rel=0.05)


def test_copy_buttons_copy(opened):
    page, _ = opened
    for name in ("model-latex", "model-python", "law-latex", "law-python"):
        details = page.locator(f"details:has(#{name})")
        details.locator("summary").click()
        button = details.locator("button")
        button.click()
        expected = page.locator(f"#{name}").text_content()
        sync_api.expect(button).to_have_text("Copied", timeout=20_000)
        assert page.evaluate("navigator.clipboard.readText()").strip() == expected.strip() != ""


def test_files_download(opened, tmp_path):
    page, _ = opened
    for name, start in (
        ("next.csv", "t,u\n"),
        ("ladder.csv", "model,training,held out,sealed\nbase,"),
        ("model.json", "{"),
    ):
        with page.expect_download() as waiting:
            page.locator(f'a[download="{name}"]').click()
        waiting.value.save_as(tmp_path / name)
        assert waiting.value.suggested_filename == name
        assert (tmp_path / name).read_text(encoding="utf-8").startswith(start)
    link = page.locator('a[download="next.csv"]').get_attribute("href")
    assert unquote(link).endswith((tmp_path / "next.csv").read_text(encoding="utf-8"))


def test_pointing_shows_values(opened):
    page, _ = opened
    plot = page.locator(".plot.time")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector(".bk-Tooltip, .bk-tooltip", state="visible")


@pytest.mark.parametrize(("scheme", "size"), [("light", WIDE), ("dark", PHONE)], ids=["wide light", "phone dark"])
def test_accessible(browser, stage_report, scheme, size):
    page = new_page(browser)
    page.set_viewport_size(size)
    page.emulate_media(color_scheme=scheme)
    page.goto(stage_report.as_uri())
    page.wait_for_function("window.Bokeh && Bokeh.documents.length >= 2 && Bokeh.documents.every(d => d.is_idle)")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert dark == (scheme == "dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    found = axe.Axe().run(page).response["violations"]
    serious = [(v["id"], v["nodes"][0]["html"][:200]) for v in found if v["impact"] in ("serious", "critical")]
    assert serious == []
    page.context.close()


def test_readable_without_scripts(browser, stage_report):
    page = new_page(browser, java_script_enabled=False)
    page.goto(stage_report.as_uri())
    assert page.locator("#compare svg.drawn").first.is_visible() and not page.locator(".plot.time").is_visible()
    page.locator("#model details summary").first.click()
    assert page.locator("#model-latex").is_visible() and not page.locator("details button").first.is_visible()
    page.context.close()


def test_prints_still_pictures(browser, stage_report, tmp_path):
    page = new_page(browser)
    page.goto(stage_report.as_uri())
    page.emulate_media(media="print")
    assert page.locator("#compare svg.drawn").first.is_visible() and not page.locator(".plot.time").is_visible()
    page.pdf(path=tmp_path / "r.pdf")
    assert (tmp_path / "r.pdf").stat().st_size > 50_000
    page.context.close()
