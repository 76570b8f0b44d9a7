"""What the tests of the live page share: a record with a hidden effect, work for a process, a server, a browser."""

import http.client
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import warnings

import numpy as np

import narx_sym as ns

TS, DEAD = 0.01, 0.6
CHROMIUM = "/usr/bin/chromium"
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
).split()


def hidden(N=2000, seed=1):
    """Input and output of a second-order lag behind a dead zone, with noise; nothing of the package."""
    rng = np.random.default_rng(seed)
    white, noise = rng.standard_normal(N), 0.01 * rng.standard_normal(N)
    u, y = np.zeros(N), np.zeros(N)
    for k in range(1, N):
        u[k] = 0.9 * u[k - 1] + 0.6 * white[k]
    x = np.sign(u) * np.maximum(np.abs(u) - DEAD, 0)
    for k in range(2, N):
        y[k] = 1.3 * y[k - 1] - 0.4 * y[k - 2] + 0.08 * x[k - 1]
    return u, y + noise


def csv(names="t,u,y", **columns):
    """A CSV file as bytes, with the time first."""
    listed = list(columns.values())
    rows = np.column_stack([np.arange(len(listed[0])) * TS, *listed])
    return (names + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n").encode()


def linear_model(u, y):
    """A fitted linear base, as the content of a model file."""
    from narx_sym.files.store import to_text

    model = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "1"])
    return to_text(model.fit(ns.Record.from_arrays(u, y, Ts=TS), method="free_run")).encode()


# -- work for a process: functions of a module, which a new process can import ------------------------------------


def count(n, progress):
    """Report, and return a number."""
    progress(f"counting to {n}")
    return n


def fail(error, progress):
    """Fail in one of several ways."""
    if error == "said":
        raise ns.errors.DataError("what is wrong, in one sentence")
    if error == "unexpected":
        raise KeyError("x")
    os._exit(3)


def warn(progress):
    """Warn."""
    warnings.warn("this is worth a look", stacklevel=1)
    return "done"


def forever(path, progress):
    """Say which process this is, and never end."""
    with open(path, "w") as file:
        file.write(str(os.getpid()))
    progress("never ends")
    while True:
        time.sleep(0.05)


# -- server and browser ------------------------------------------------------------------------------------------


class Server:
    """`narx-sym app` in a process of its own."""

    def __init__(self, *arguments, cwd=None):
        code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        code += "from narx_sym.cli.main import main; sys.argv = ['narx-sym', 'app', *sys.argv[1:]]; main()"
        root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
        path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, "--no-browser", "--port", "0", *map(str, arguments)], cwd=cwd, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=os.environ | {"PYTHONPATH": path, "TMPDIR": str(cwd)},
            start_new_session=True,
        )  # fmt: skip
        self.said = []
        while not (found := re.search(r"http://127\.0\.0\.1:(\d+)/", "".join(self.said))):
            line = self.process.stdout.readline()
            assert line, f"the server ended: {''.join(self.said)}"
            self.said.append(line)
        self.port, self.url = int(found[1]), found[0]
        self.reader = threading.Thread(target=lambda: self.said.extend(self.process.stdout), daemon=True)
        self.reader.start()

    def stop(self, signal=2):
        """Press Ctrl-C; return the exit code and all that was said."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal)  # a terminal sends it to the workers too
        code = self.process.wait(30)
        self.reader.join(5)
        return code, "".join(self.said)

    def ask(self, method="GET", path="/", body=None, **headers):
        """Ask over raw HTTP: status and text. The Host is the server's own unless it is given."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in ({"Host": f"127.0.0.1:{self.port}"} | headers).items():
            if value is not None:
                connection.putheader(name, value)
        if body is not None and "Transfer-Encoding" not in headers and "Content-Length" not in headers:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders()
        if body is not None:
            try:
                connection.send(body)
            except (BrokenPipeError, ConnectionResetError):
                pass  # refused before all was sent
        answer = connection.getresponse()
        text = answer.read().decode("utf-8", "replace")
        connection.close()
        return answer.status, text


def why_no_browser():
    """Why the tests in a browser are skipped; an empty text where they are not."""
    import importlib.util

    missing = [n for n in ("nicegui", "playwright", "axe_playwright_python") if importlib.util.find_spec(n) is None]
    if missing:
        return f"not installed: {', '.join(missing)}"
    return "" if shutil.which(CHROMIUM) else f"there is no {CHROMIUM} (Debian's package chromium)"


def wrong(page, server):
    """Return a list that gets what a page of a server complains about, and what it asks other machines for."""
    found, own = [], (server.url, server.url.replace("http", "ws"), "data:", "blob:")
    page.on("console", lambda m: found.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on("request", lambda r: None if r.url.startswith(own) else found.append(f"asked for {r.url}"))
    return found
