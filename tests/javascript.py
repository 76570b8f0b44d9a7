"""Runs exported JavaScript: in Node where it is, else in the browser of the live tests."""

import base64
import json
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
from live import CHROMIUM, FLAGS

NODE = shutil.which("node")
THREAD = ThreadPoolExecutor(1)
ANSWER = """
function answer(model, request) {
  const decoded = text => new Float64Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
  const n = request.length, runs = model.states.map(() => new Float64Array(n));
  const start = request.start.map(x => typeof x === "string" ? decoded(x) : x);
  const found = model.simulate(request.given.map(decoded), start, request.theta || undefined, runs);
  if (found !== runs[model.output]) throw new Error("it returns another array");
  const {inputs, states, parameters, values, rested, depth} = model;
  const rest = request.at ? model.rest(request.at, request.theta || undefined) : null;
  const shown = x => Array.from(x, v => Number.isNaN(v) ? "NaN" : v);
  return JSON.stringify({runs: runs.map(shown), inputs, states, parameters, values, rested, depth, rest});
}
"""


def why_no_javascript():
    """Why nothing runs JavaScript here; an empty text where something does."""
    if NODE:
        return ""
    import importlib.util

    missing = importlib.util.find_spec("playwright") is None or shutil.which(CHROMIUM) is None
    return "there is neither Node nor Chromium with playwright" if missing else ""


def evaluated(script):
    """Return the text that a script's last expression is."""
    if NODE:
        code = "const vm = require('vm'); let s = ''; process.stdin.setEncoding('utf8').on('data', d => s += d)"
        code += ".on('end', () => process.stdout.write(String(vm.runInNewContext(s, {atob}))))"
        ran = subprocess.run([NODE, "-e", code], input=script, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr[-2000:]
        return ran.stdout
    return THREAD.submit(lambda: _page().evaluate(script)).result()


@cache
def _page():
    """The page of the one browser of this process; its thread is its own, for its loop stands in no test's way."""
    from playwright.sync_api import sync_playwright

    browser = sync_playwright().start().chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    return browser.new_page()


def run(source, name, given, start, theta=None, length=None, at=None):
    """Run an export: what it says of itself, and "runs", the states by name."""

    def packed(x):
        return base64.b64encode(np.ascontiguousarray(x, dtype="<f8").tobytes()).decode()

    request = {
        "given": [packed(x) for x in given],
        "start": [float(x) if np.ndim(x) == 0 else packed(x) for x in start],
        "theta": None if theta is None else [float(v) for v in theta],
        "length": len(given[0]) if length is None else length,
        "at": at,
    }
    told = json.loads(evaluated(f"{source}\n{ANSWER}\nanswer({name}, {json.dumps(request)})"))
    told["runs"] = {n: np.array(x, dtype=float) for n, x in zip(told["states"], told["runs"], strict=True)}
    return told
