"""The live page in a real headless Chromium, and its server over raw HTTP."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import live
import pytest
from sampling import more

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.files.store import load
from narx_sym.report.hero import unpacked
from narx_sym.symbolic.numbers import sized

pytest.importorskip("nicegui", reason="the extra narx-sym[app] is not installed")
reason = live.why_no_browser()
in_browser = pytest.mark.skipif(bool(reason), reason=reason)
PATIENCE = 240_000  # ms, on a busy machine
EVIL = "</title><script>document.title='evil'</script>"


@pytest.fixture(scope="module")
def data():
    return live.hidden()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    made = live.Server("--max-mb", "1", cwd=tmp_path_factory.mktemp("served"))
    yield made
    made.stop()


# -- raw HTTP ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the kernel's list of sockets is not at /proc/net/tcp")
def test_only_this_machine_is_listened_to(server):
    tables = [Path(f"/proc/net/{name}") for name in ("tcp", "tcp6")]
    rows = [line.split() for table in tables if table.exists() for line in table.read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and int(row[1].rpartition(":")[2], 16) == server.port]
    assert [address.partition(":")[0] for address in listening] == ["0100007F"]


def place(server):
    """The address of a new page."""
    return re.search(r"'(/at/[\w-]+/)'", server.ask()[1])[1]


HANDSHAKE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}  # fmt: skip
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport="


@pytest.mark.parametrize("foreign", ("evil.example", "null", None, "127.0.0.1"))
def test_what_is_foreign_is_refused(server, foreign):
    """As host; as origin of what would change something, and of a websocket. The own host has another port than 1."""
    assert server.ask()[0] == server.ask(Host=f"localhost:{server.port}")[0] == 200
    own = place(server)
    for path in ("/", f"{own}download/model.json"):
        assert server.ask(path=path, Host=foreign)[0] in (400, 403)
    given = {} if foreign is None else {"Origin": f"http://{foreign}:1" if "." in foreign else foreign}
    body = live.csv(u=[1.0, 2.0], y=[1.0, 2.0])
    assert server.ask("POST", f"{own}data?name=a.csv", body, **given)[0] == 403
    assert server.ask("POST", f"{SOCKET}polling", b"x", **given)[0] == 403
    assert server.ask(path=f"{SOCKET}websocket", **HANDSHAKE, **given)[0] == 403
    assert "a.csv" not in server.ask(path=own)[1]


def test_a_too_large_upload_is_refused(server):
    own, path = {"Origin": server.url[:-1]}, f"{place(server)}data?name=a.csv"
    status, text = server.ask("POST", path, b"x", **own, **{"Content-Length": "1000001"})
    assert status == 413 and "at most 1 MB" in text
    chunks = b"".join(b"40000\r\n" + b"x" * 0x40000 + b"\r\n" for _ in range(5)) + b"0\r\n\r\n"
    assert server.ask("POST", path, chunks, **own, **{"Transfer-Encoding": "chunked"})[0] == 413


def test_no_path_of_a_client_is_followed(server):
    for path in ("/download/../../etc/passwd", "/download/%2e%2e%2f%2e%2e%2fetc%2fpasswd", "/static/../../etc/passwd",
                 "/_nicegui/3/static/..%2f..%2f..%2fetc%2fpasswd", "/openapi.json", "/docs"):  # fmt: skip
        status, text = server.ask(path=path)
        assert status == 404 and "root:" not in text


@pytest.mark.long
@pytest.mark.parametrize("signal", (signal.SIGINT, signal.SIGTERM))
def test_ctrl_c_ends_it_with_a_message_and_leaves_nothing(tmp_path, data, signal):
    u, y = data
    (tmp_path / "own.csv").write_bytes(live.csv(u=u, y=y))
    made = live.Server("own.csv", cwd=tmp_path)
    assert made.ask()[0] == 200 and list(tmp_path.glob("narx_sym_app_*"))
    code, said = made.stop(signal)
    assert code == 0 and "stopped" in said and "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["own.csv"]


def test_a_port_that_is_taken_is_one_message(server, run):
    code, _, err = run("app", "--no-browser", "--port", server.port)
    assert code == 2 and "--port" in err and "Traceback" not in err


# -- the browser ---------------------------------------------------------------------------------------------------


@pytest.fixture
def page(browser, server):
    """A page that keeps what it complains about, and what it asks other machines for."""
    made = browser.new_page(viewport={"width": 1440, "height": 900})
    made.set_default_timeout(PATIENCE)
    made.wrong = live.wrong(made, server)
    made.goto(server.url)
    made.get_by_role("heading", name="Data").wait_for()
    yield made
    made.close()


def serious(page):
    """What axe-core finds that is serious or critical."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    found = [v for v in found if v["impact"] in ("serious", "critical")]
    return [(v["id"], v["nodes"][0]["html"][:200], v["nodes"][0]["failureSummary"]) for v in found]


def upload(page, name, content):
    page.set_input_files("#data-file", files=[{"name": name, "mimeType": "text/csv", "buffer": content}])


def fits(page):
    """Whether nothing stands beyond the right edge, wide and narrow."""
    beyond = []
    for width in (768, 390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(300)
        beyond.append(page.evaluate("document.documentElement.scrollWidth - window.innerWidth"))
    return max(beyond) <= 0


@pytest.mark.long
@in_browser
def test_the_whole_way(page, data, tmp_path):
    """Upload, diagnose, cancel, add, the error falls, step back, law, download, load from the command line."""
    u, y = data
    assert serious(page) == [] and fits(page)
    upload(page, "stage.csv", live.csv(u=u, y=y))
    page.get_by_text("Read: 2000 samples").wait_for()
    assert serious(page) == [] and fits(page)
    start = page.get_by_role("button", name="Diagnose")
    start.click()
    page.get_by_text("identifying a linear base").wait_for()
    assert serious(page) == []
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Cancel").wait_for(state="detached")
    assert page.locator("#found").count() == 0
    start.click()
    grows_while_it_searches(page)
    page.locator("#found").wait_for()
    assert page.locator("#found").inner_text() == "Dead zone is probably missing."
    assert page.evaluate("document.activeElement.id") == "found"
    assert serious(page) == [] and fits(page)
    before, first = ladder(page), first_screen(page)
    assert shown(page)["models"][0]["errors"]["validation"]["nrmse"] == pytest.approx(before[0], rel=0.01)
    assert "Probably missing: dead zone" in first.locator("#verdict").text_content()
    first.get_by_role("radio", name="+ dead zone").check()  # seen before it is added
    first.get_by_role("button", name="Add dead zone").click()
    page.locator(".steps [aria-current]").get_by_text("+ dead zone").wait_for()
    stays_in_sight(page)
    after = ladder(page)
    assert [one["name"] for one in shown(page)["models"]][:2] == ["base", "+ dead zone"]
    assert shown(page)["chosen"] == 1
    assert len(after) == len(before) + 1 and after[1] < 0.2 * after[0]  # the last row is the noise floor
    drawn = first_screen(page).locator("svg.drawn")
    assert drawn.evaluate_all("all => all.filter(s => s.getAttribute('aria-label')).length") == drawn.count() > 5
    assert serious(page) == [] and fits(page)

    page.get_by_role("tab", name="Export").focus()
    for name in ("diagnosis", "law"):
        page.keyboard.press("ArrowRight")
        assert page.evaluate("document.activeElement.id") == f"tab-{name}"
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(300)
    assert serious(page) == []
    page.emulate_media(color_scheme="light")
    page.get_by_role("tab", name="Diagnosis").click()
    moved = moves_a_slider(page)

    page.get_by_role("tab", name="Law").click()
    page.locator(".doing").wait_for(state="detached")
    ran = runs_the_law(page, tmp_path)
    assert serious(page) == [] and fits(page)
    page.get_by_role("tab", name="Export").click()
    page.get_by_role("link", name="Law (C99 source)").wait_for()
    assert serious(page) == [] and fits(page)

    files = {}
    for title in (
        "Model (JSON)",
        "Model (C99 source)",
        "Law (C99 source)",
        "Law (LaTeX)",
        "Derivation (LaTeX)",
        "Report (HTML)",
    ):
        with page.expect_download() as waiting:
            page.get_by_role("link", name=title, exact=True).click()
        files[title] = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(files[title])
        assert files[title].stat().st_size > 100
    assert load(files["Model (JSON)"]).effects[0].effect == "dead_zone"
    (tmp_path / "new.csv").write_bytes(live.csv(**dict(zip("uy", live.hidden(seed=7), strict=True))))
    code = "import sys; from narx_sym.cli.main import main; sys.argv[0] = 'narx-sym'; main()"
    arguments = ["compare", str(files["Model (JSON)"]), str(tmp_path / "new.csv"), "--no-plot"]
    made = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    model = load(files["Model (JSON)"])
    check_slider(moved, model)
    check_run(ran, model)
    assert ns.evaluate(model, ns.read(tmp_path / "new.csv")).free_run_nrmse < 0.1 * before[0] + 0.02

    page.get_by_role("tab", name="Law").click()
    undone_and_done_again(page, before, after)
    page.get_by_text("Columns, rows, units").click()
    rows = page.get_by_label("Rows A:B, from 0")
    rows.fill("0:1500")
    rows.press("Tab")
    page.get_by_text("With other data, units").wait_for()
    page.wait_for_timeout(500)  # it fades in
    assert serious(page) == []
    page.get_by_role("button", name="Keep them").click()
    page.get_by_role("dialog").wait_for(state="detached")
    assert ladder(page) == after and rows.input_value() == ""
    assert page.wrong == []


def grows_while_it_searches(page):
    """The base, its loop and portrait are there before the end, and bars of what was found so far."""
    frame = first_screen(page)
    assert "Searching" in frame.locator("#verdict-title").inner_text() and page.locator("#found").count() == 0
    assert frame.locator("canvas:visible").count() == 3 and frame.locator(".switch:not(.found)").count() == 1
    frame.locator(".switch.found").first.wait_for()
    assert "+ dead zone" in frame.locator(".switch.found").first.inner_text() and page.locator("#found").count() == 0
    assert page.get_by_role("button", name="Take the best so far").is_visible() and serious(page) == []


def described(field):
    """The message that stands at a field; "" where nothing is wrong."""
    if field.get_attribute("aria-invalid") != "true":
        return ""
    return field.page.locator(f"#{field.get_attribute('aria-describedby')}").inner_text()


def moves_a_slider(page):
    """Move a parameter in the frame; return what it says, and what it computes with."""
    frame = first_screen(page)
    frame.locator("#try_it > details > summary").click()
    frame.locator("#try-rms").get_by_text(".").wait_for()
    slider = frame.locator(".sliders:not([hidden]) fieldset input[type=range]").first
    slider.focus()
    before = frame.locator("#hero").evaluate("e => e.dataset.rms")
    for _ in range(5):
        slider.press("ArrowRight")
    page.wait_for_timeout(100)
    assert serious(page) == [] and serious(page.frames[-1]) == []
    found, told = frame.locator("#hero").evaluate("e => ({...e.dataset})"), shown(page)
    assert float(found["rms"]) > float(before) and fits(page)
    return found, told


def check_slider(moved, model):
    """The error that the frame shows is what Python computes with the parameters that it says."""
    found, told = moved
    y, u = (unpacked(one) for one in told["signals"])
    one = told["models"][int(found["model"])]
    start = dict(zip((str(b.label) for b in model.recursion.states), one["start"], strict=True))
    error = y - compile(model.recursion)({"u": u}, json.loads(found["theta"]), start)["y"]
    error[: one["skip"]] = 0.0
    assert float(found["rms"]) == pytest.approx(float(live.np.sqrt(live.np.mean(error**2))), rel=1e-9)


def runs_the_law(page, folder):
    """A wrong number is one line; then a sine within limits: return the sentence, and the file with the run."""
    page.get_by_role("radio", name="Sine").click()
    fields = {"Offset": "0.1", "Amplitude": "1", "Frequency": "fast", "Duration": "4"}
    for title, text in ({"Smallest input": "-1.5", "Largest input": "1.5"} | fields).items():
        page.get_by_role("textbox", name=title).fill(text)
    run = page.get_by_role("button", name="Run the law")
    run.click()
    page.get_by_text("The frequency must be a number, not 'fast'.").wait_for()
    assert described(page.get_by_role("textbox", name="Frequency")).startswith("The frequency must be")
    assert page.locator(".ran").count() == 0
    page.get_by_role("textbox", name="Frequency").fill("0.5")
    run.click()
    page.locator(".ran").wait_for()
    assert page.get_by_role("img", name="Run of the law").is_visible()
    assert page.get_by_role("textbox", name="Frequency").input_value() == "0.5"  # what was typed stays
    said = page.locator(".ran").inner_text()
    page.get_by_role("tab", name="Export").click()
    with page.expect_download() as waiting:
        page.get_by_role("link", name="Run of the law (CSV)").click()
    waiting.value.save_as(folder / "run.csv")
    page.get_by_role("tab", name="Law").click()
    return said, folder / "run.csv"


def check_run(ran, model):
    """The figures and the file are what Python gives for the same reference."""
    said, path = ran
    r = 0.1 - live.np.cos(live.np.pi * live.np.arange(400) * live.TS)
    law, limits = model.compensator(), (-1.5, 1.5)
    with pytest.warns(UserWarning, match="a limit of the actuator"):
        m = law.run(r, limits=limits)
    y = model.simulate(m, r[0], u0=law.rest_input(r[0], limits), warn=False)
    held = law.follow(r, limits=limits).held.mean()
    rms, most = (sized(float(x), "") for x in (live.np.sqrt(live.np.mean((y - r) ** 2)), abs(y - r).max()))
    assert f"with the law {rms} rms, {most} at most" in said and f"in {held:.1%} of the samples" in said
    columns = live.np.loadtxt(path, delimiter=",", skiprows=1).T
    for found, expected in zip(columns[1:], (r, m, y), strict=True):
        assert live.np.allclose(found, expected, rtol=1e-9, atol=1e-9)


def first_screen(page):
    """The frame with the first screen, once its script has run."""
    frame = page.frame_locator("[data-live] iframe")
    frame.locator("#hero[data-rms]").wait_for(state="attached")
    return frame


def shown(page):
    """The JSON of the first screen."""
    return json.loads(first_screen(page).locator("#hero-data").text_content())


def stays_in_sight(page):
    """The rail is on the screen wherever the page is."""
    page.evaluate("window.scrollTo(0, document.documentElement.scrollHeight / 2)")
    page.wait_for_timeout(200)
    assert 0 <= page.locator(".rail").bounding_box()["y"] + 1 < 500
    page.evaluate("window.scrollTo(0, 0)")


def undone_and_done_again(page, before, after):
    """Undo and redo by the list and by keys bring the ladders back, and nothing is under way meanwhile."""
    step = page.locator(".steps [aria-current]")
    first, last = page.locator(".steps .step").all()
    for undone, redone in (
        (first.click, last.click),
        (lambda: page.keyboard.press("Control+z"), lambda: page.keyboard.press("Control+y")),
    ):
        for do, name, rungs in ((undone, "linear base", before), (redone, "+ dead zone", after)):
            do()
            step.get_by_text(name).wait_for()
            assert ladder(page) == rungs and page.locator(".doing").count() == 0
            assert page.locator(".ran").count() == (rungs == after)  # a run belongs to its model
    assert serious(page) == [] and fits(page)


def ladder(page):
    """The held-out errors that the page shows, the noise floor last."""
    rows = first_screen(page).locator("[aria-label='Errors, step by step'] tbody tr").all()
    return [float(row.locator("td").nth(1).text_content()) for row in rows]


@more
@in_browser
def test_two_pages_do_not_see_each_other_and_each_is_found_again(page, browser, server, data):
    u, y = data
    other = browser.new_context().new_page()
    other.goto(server.url)
    upload(page, "mine.csv", live.csv(u=u[:200], y=y[:200]))
    page.get_by_text("mine.csv: 200 rows").wait_for()
    upload(other, "theirs.csv", live.csv(u=u[:300], y=y[:300]))
    other.get_by_text("theirs.csv: 300 rows").wait_for()
    assert "theirs" not in page.inner_text("body") and "mine" not in other.inner_text("body")
    assert page.url != other.url and page.url.startswith(server.url)
    page.reload()
    page.get_by_text("mine.csv: 200 rows").wait_for()
    assert "theirs" not in page.inner_text("body") and page.wrong == []
    other.context.close()
    own = {"Origin": server.url[:-1]}
    assert server.ask("POST", "/at/nobody/data?name=a.csv", b"t,u,y\n", **own)[0] == 404
    assert server.ask(path="/at/nobody/download/model.json")[0] == 404


@in_browser
def test_a_too_large_file_is_refused_before_it_is_sent(page):
    upload(page, "large.csv", b"t,u,y\n" + b"0,1,2\n" * 200_000)
    page.get_by_role("alert").get_by_text("at most 1 MB").wait_for()
    assert page.wrong == []


@in_browser
def test_a_file_is_dropped(page, data):
    u, y = data
    text = live.csv(u=u[:200], y=y[:200]).decode()
    page.evaluate(
        """text => {
            const dropped = new DataTransfer();
            dropped.items.add(new File([text], "dropped.csv"));
            const event = new DragEvent("drop", {dataTransfer: dropped, bubbles: true, cancelable: true});
            document.querySelector(".drop .what").dispatchEvent(event);
        }""",
        text,
    )
    page.get_by_text("dropped.csv: 200 rows").wait_for()
    assert page.wrong == []


@in_browser
def test_the_units_of_the_header_stand_in_their_fields(page, data):
    u, y = (x[:400] for x in data)
    upload(page, "units.csv", live.csv("t,u [V],y [mm],w [<b>K</b>]", u=u, y=y, w=2 * u))
    page.locator("input[placeholder='mm']").wait_for()
    output = page.get_by_role("textbox", name="Unit of the output")
    assert output.get_attribute("placeholder") == "mm" and output.input_value() == ""
    page.get_by_role("combobox", name="Output").click()
    page.get_by_role("option", name="w [").click()
    page.locator("input[placeholder='<b>K</b>']").wait_for()
    assert page.wrong == []


@in_browser
def test_names_from_data_are_text(page, data):
    u, y = data
    upload(page, f"{EVIL}.csv", live.csv(f'"u","y","t","{EVIL}"', u=y, y=live.np.arange(len(u)) * live.TS, c=u))
    page.get_by_text(f"columns u, y, t, {EVIL}").wait_for()
    page.get_by_label("Further channels").click()
    option = page.get_by_role("option", name=EVIL)
    option.click()
    page.get_by_text("is the channel").wait_for()  # drawn behind the list, which stays open
    assert option.get_attribute("aria-selected") == "true" and option.is_visible()
    page.keyboard.press("Escape")
    assert page.title() == "narx_sym" and page.wrong == []


@in_browser
def test_an_error_stands_at_its_field_until_that_is_right(page, data):
    u, y = data
    upload(page, "stage.csv", live.csv(u=u[:300], y=y[:300]))
    page.get_by_text("Read: 300 samples").wait_for()
    rows, Ts = page.get_by_label("Rows A:B, from 0"), page.get_by_label("Sampling time [s]")
    Ts.fill("fast")
    Ts.press("Tab")
    page.get_by_text("must be a number").wait_for()
    assert "must be a number" in described(Ts) and described(rows) == "" and page.locator(".wrong").count() == 0
    assert rows.evaluate("it => it === document.activeElement") and serious(page) == []
    rows.fill("all")
    rows.press("Tab")
    page.get_by_text("Cannot read the rows").wait_for()
    assert described(rows) and described(Ts) and (rows.input_value(), Ts.input_value()) == ("all", "fast")
    assert page.get_by_role("button", name="Diagnose").is_disabled()
    Ts.fill("")
    Ts.press("Tab")
    page.get_by_text("must be a number").wait_for(state="detached")
    assert described(rows) and not described(Ts)
    rows.fill("0:200")
    rows.press("Tab")
    page.get_by_text("Read: 200 samples").wait_for()
    assert not described(rows) and page.wrong == [] and fits(page)


@in_browser
def test_progress_is_told_in_steps(page, data):
    """A bar and counts for who looks; a reader hears of the steps alone."""
    u, y = data
    upload(page, "stage.csv", live.csv(u=u[:600], y=y[:600]))
    page.get_by_text("Read: 600 samples").wait_for()
    assert all(page.locator(".rail .file").nth(i).bounding_box()["height"] < 30 for i in range(2))  # a line each
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text(re.compile(r"Step [34] of 7: ")).wait_for()
    bar = page.get_by_role("progressbar", name="Working")
    assert 2 / 7 <= float(bar.get_attribute("aria-valuenow")) < 1
    heard = page.locator(".doing [role=status]").inner_text()
    assert re.fullmatch(r"Step \d of 7: .*\.", heard) and not re.search(r"\d s\b", heard)
    assert re.search(r"\d s\b", page.locator(".done").inner_text()) and serious(page) == []
    page.get_by_role("button", name="Cancel").click()
    page.locator(".doing").wait_for(state="detached")
    assert page.wrong == []


@in_browser
def test_an_error_of_the_data_is_one_message(page):
    upload(page, "words.csv", b"t,u,y\n0,1,a\n1,2,b\n")
    page.get_by_role("alert").get_by_text("has text").wait_for()
    assert "Traceback" not in page.inner_text("body") and serious(page) == [] and page.wrong == []


def test_what_a_page_asks_for_is_here(server):
    """Every address in the page leads to this server."""
    text = server.ask()[1]
    found = re.findall(r"""(?:src|href|url\()=?["'(]?(https?://[^"')\s]+)""", text)
    assert [a for a in found if not a.startswith(server.url)] == []
    assert json.loads(re.search(r'"imports": (\{.*?\})', text)[1])
