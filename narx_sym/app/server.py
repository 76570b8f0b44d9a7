"""The server of the page: on this machine only, behind the guard."""

from __future__ import annotations

import os
import signal
import socket
import threading
import webbrowser
from pathlib import Path
from typing import Any

from ..errors import DataError, NarxError
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
RECONNECT = 20.0  # seconds that a page may be silent: a browser may be busy with drawing
GRACE = 1  # seconds for open connections when the server ends


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


def serve(bench: Workbench, port: int | None, browser: bool) -> None:
    """Serve the page until Ctrl-C."""
    os.environ.setdefault("NICEGUI_STORAGE_PATH", str(bench.folder / "storage"))  # nothing is left behind
    import uvicorn

    with listening(port) as own:
        number = own.getsockname()[1]
        guarded = Guard(application(bench), number, bench.limit)
        config = uvicorn.Config(
            guarded, log_level="error", access_log=False, timeout_graceful_shutdown=GRACE, server_header=False,
            ws_max_size=1_000_000,
        )  # fmt: skip
        address = f"http://{HOST}:{number}/"
        print(f"narx-sym app: {address} (this machine only; Ctrl-C ends it)", flush=True)
        if browser:
            threading.Timer(1.0, webbrowser.open, (address,)).start()
        bench.worker.warm()
        for number in (signal.SIGINT, signal.SIGTERM):  # both end the server alike: uploads are removed
            signal.signal(number, signal.default_int_handler)
        try:
            uvicorn.Server(config).run(sockets=[own])
        except KeyboardInterrupt:
            pass
        finally:
            bench.close()
    print("narx-sym app: ended; what was uploaded is removed")


def application(bench: Workbench) -> Any:
    """Return the ASGI application: the page, the places for files, and the downloads."""
    from bokeh.resources import Resources
    from fastapi import FastAPI, Request
    from fastapi.concurrency import run_in_threadpool
    from fastapi.responses import PlainTextResponse, Response
    from nicegui import app as framework
    from nicegui import ui

    from .browser.page import Page

    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)

    # The annotations of the routes are read when they are made: they name what was imported just above.
    async def take_data(request: Request) -> Response:
        name, content = request.query_params.get("name", "file"), await request.body()
        await run_in_threadpool(bench.upload, name, content)
        return Response(status_code=204)

    async def take_model(request: Request) -> Response:
        name, content = request.query_params.get("name", "file"), await request.body()
        await run_in_threadpool(bench.upload_model, name, content)
        return Response(status_code=204)

    def give(request: Request) -> Response:
        try:
            name, content = bench.download(request.path_params["kind"])
        except NarxError as error:
            return PlainTextResponse(str(error), status_code=404)
        headers = {"content-disposition": f'attachment; filename="{name}"', "cache-control": "no-store"}
        return Response(content, media_type=TYPES.get(Path(name).suffix, "text/plain"), headers=headers)

    def bokeh(request: Request) -> Response:
        return Response("\n".join(Resources(mode="inline", components=["bokeh"]).js_raw), media_type="text/javascript")

    app.add_route("/bokeh.js", bokeh, methods=["GET"])
    app.add_route("/data", take_data, methods=["POST"])
    app.add_route("/model", take_model, methods=["POST"])
    app.add_route("/download/{kind}", give, methods=["GET"])

    @ui.page("/")
    def page() -> None:
        Page(bench)

    # The page says what it does; a bar on top that flashes with each request has no name for a screen reader.
    framework.config.quasar_config["loadingBar"]["skipHijack"] = True
    ui.run_with(
        app, title="narx_sym", language="en-US", dark=None, tailwind=False,
        show_welcome_message=False, reconnect_timeout=RECONNECT,
    )  # fmt: skip
    return app
