"""The server of the page: on this machine only, behind the guard."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import threading
import webbrowser
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from ..errors import DataError, NarxError
from ..report import notebook
from .guard import Guard
from .workbench import Workbench

HOST, PORT = "127.0.0.1", 8537
TYPES = {
    ".json": "application/json",
    ".html": "text/html",
    ".tex": "text/x-tex",
    ".c": "text/x-c",
    ".csv": "text/csv",
    ".fmu": "application/zip",
}
FRAME = Path(notebook.__file__).with_name("live.js")  # what shows the first screen in a frame
RECONNECT = 20.0  # seconds that a page may be silent: a browser may be busy with drawing
GRACE = 1  # seconds for open connections when the server ends


class Sessions:
    """A workbench for each page that was opened: none shows what another one has. A page is found again by its key.

    Parameters
    ----------
    make : function that returns a new workbench
    most : int
        Workbenches that are kept; the one that was opened first and has no page any more goes.
    """

    def __init__(self, make: Callable[[], Workbench], most: int = 24):
        self.make, self.most = make, most
        self.benches: dict[str, Workbench] = {}
        self.pages: Counter[str] = Counter()

    def new(self) -> tuple[str, Workbench]:
        """Return a new key with its workbench."""
        if len(self.benches) >= self.most:
            left = next((key for key in self.benches if not self.pages[key]), None)
            if left is None:
                raise NarxError("Too many pages are open: close one, and load this one again.")
            self.benches.pop(left).close()
        key = secrets.token_urlsafe(16)
        self.benches[key] = self.make()
        return key, self.benches[key]

    def entered(self, key: str) -> None:
        """Take note of a page."""
        self.pages[key] += 1

    def left(self, key: str) -> None:
        """Take note that a page is gone: without one the process of an idle workbench ends."""
        self.pages[key] -= 1
        bench = self.benches.get(key)
        if bench is not None and not self.pages[key] and not bench.busy:
            bench.worker.stop()

    def close(self) -> None:
        """Close every workbench."""
        while self.benches:
            self.benches.popitem()[1].close()


def listening(port: int | None) -> socket.socket:
    """Return a socket on this machine's loopback; without a wish any free port will do where the usual one is taken."""
    for wanted in [port] if port is not None else [PORT, 0]:
        made = socket.socket()
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((HOST, wanted))
            made.listen()  # who comes before the server runs waits
            return made
        except OSError as error:
            made.close()
            reason = error.strerror or str(error)
    raise DataError(f"The port {port} cannot be used ({reason}); choose another with --port.")


def serve(sessions: Sessions, port: int | None, browser: bool) -> None:
    """Serve the page until Ctrl-C."""
    first = next(iter(sessions.benches.values()))
    sessions.entered(next(iter(sessions.benches)))  # it stays: the framework's files are in its folder
    os.environ.setdefault("NICEGUI_STORAGE_PATH", str(first.folder / "storage"))  # nothing is left behind
    import uvicorn

    with listening(port) as own:
        number = own.getsockname()[1]
        guarded = Guard(application(sessions), number, first.limit)
        config = uvicorn.Config(
            guarded, log_level="error", access_log=False, timeout_graceful_shutdown=GRACE, server_header=False,
            ws_max_size=1_000_000,
        )  # fmt: skip
        address = f"http://{HOST}:{number}/"
        print(f"narx-sym app: {address} (this machine only; Ctrl-C ends it)", flush=True)
        if browser:
            threading.Timer(1.0, webbrowser.open, (address,)).start()
        for number in (signal.SIGINT, signal.SIGTERM):  # both end the server alike: uploads are removed
            signal.signal(number, signal.default_int_handler)
        try:
            uvicorn.Server(config).run(sockets=[own])
        except KeyboardInterrupt:
            pass
        finally:
            sessions.close()
    print("narx-sym app: stopped; uploaded files were deleted")


def application(sessions: Sessions) -> Any:
    """Return the ASGI application: the page, the places for files, and the downloads."""
    from fastapi import FastAPI
    from nicegui import app as framework
    from nicegui import ui

    from .browser.page import Page

    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    _files(app, sessions)

    @ui.page("/")
    @ui.page("/at/{key}/")
    def page(key: str = "") -> None:
        if key not in sessions.benches:
            try:
                key, _ = sessions.new()
            except NarxError as error:
                ui.label(str(error))
                return
        bench, client = sessions.benches[key], ui.context.client
        sessions.entered(key)
        client.on_connect(bench.worker.warm)
        client.on_delete(lambda: sessions.left(key))
        Page(bench, f"/at/{key}/")

    # The page says what it does; a bar on top that flashes with each request has no name for a screen reader.
    framework.config.quasar_config["loadingBar"]["skipHijack"] = True
    ui.run_with(
        app, title="narx_sym", language="en-US", dark=None, tailwind=False,
        show_welcome_message=False, reconnect_timeout=RECONNECT,
    )  # fmt: skip
    return app


def _files(app: Any, sessions: Sessions) -> None:
    """Add the places for files, and the downloads."""
    from fastapi import HTTPException, Request
    from fastapi.concurrency import run_in_threadpool
    from fastapi.responses import PlainTextResponse, Response

    def bench_of(request: Request) -> Workbench:
        try:
            return sessions.benches[request.path_params["key"]]
        except KeyError:
            raise HTTPException(404, "This page has expired: load it again.") from None

    def taking(take: Callable[[Workbench, str, bytes], None]) -> Callable[[Request], Awaitable[Response]]:
        async def taken(request: Request) -> Response:
            bench = bench_of(request)
            name, content = request.query_params.get("name", "file"), await request.body()
            await run_in_threadpool(take, bench, name, content)
            return Response(status_code=204)

        return taken

    def give(request: Request) -> Response:
        try:
            name, content = bench_of(request).download(request.path_params["kind"])
        except NarxError as error:
            return PlainTextResponse(str(error), status_code=404)
        headers = {"content-disposition": f'attachment; filename="{name}"', "cache-control": "no-store"}
        return Response(content, media_type=TYPES.get(Path(name).suffix, "text/plain"), headers=headers)

    def first(request: Request) -> Response:
        bench = bench_of(request)
        shown = bench.early or (bench.current.page if bench.current else "")
        # As text: it is shown in a frame of its own origin only.
        return PlainTextResponse(shown, headers={"cache-control": "no-store"})

    def frame(request: Request) -> Response:
        return Response(FRAME.read_text(encoding="utf-8"), media_type="text/javascript")

    app.add_route("/live.js", frame, methods=["GET"])
    app.add_route("/at/{key}/live", first, methods=["GET"])
    takers = {"data": Workbench.upload, "model": Workbench.upload_model, "reference": Workbench.upload_reference}
    for name, take in takers.items():
        app.add_route(f"/at/{{key}}/{name}", taking(take), methods=["POST"])
    app.add_route("/at/{key}/download/{kind}", give, methods=["GET"])
