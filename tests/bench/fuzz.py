"""Terms, files of effects and model files from strangers: a million of them.

    python tests/bench/fuzz.py [--count 1000000] [--seed 0] [--parts 70 15 15] [--seconds 10] [--memory 1024]

Each input is built from the grammar, by mutation of good ones, or by splicing (see `tests/hostile.py`), and must give a result
or the documented error: `ParseError` for a term, `ModelError` for a file. Everything else counts as a failure: any other
exception, more than `--seconds` for one input, more than `--memory` MB beyond the start. Failures are printed with the
seed that gives them again. Several runs with different seeds add up. About 40 minutes on one core for a million.
"""

from __future__ import annotations

import resource
import signal
import sys
import time
from pathlib import Path
from random import Random

from common import asked
from hostile import Judge
from sympy.core.cache import clear_cache

KINDS = ("term", "effect", "model")


class TooLong(BaseException):
    """One input took more time than it may."""


def late(*_: object) -> None:
    """Stop the input that is being read."""
    raise TooLong


def main() -> int:
    """Run and count."""
    options = asked(__doc__, count=1_000_000, seed=0, parts=(70, 15, 15), seconds=10.0, memory=1024)
    judge = Judge()
    signal.signal(signal.SIGALRM, late)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit = used + options.memory * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    begin, slowest, failures = time.perf_counter(), 0.0, 0
    tally = {kind: [0, 0, 0] for kind in KINDS}  # tried, read, failed
    for seed in range(options.seed, options.seed + options.count):
        pick = Random(seed)
        kind = pick.choices(KINDS, options.parts)[0]
        given, attempt = getattr(judge, kind)(pick)
        before, start = judge.read, time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, options.seconds)
        try:
            attempt()
            fault = ""
        except TooLong:
            fault = f"more than {options.seconds:g} s"
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            fault = f"{type(error).__name__}: {str(error)[:200]}"
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        slowest = max(slowest, time.perf_counter() - start)
        tally[kind][0] += 1
        tally[kind][1] += judge.read - before
        if fault:
            failures += 1
            tally[kind][2] += 1
            print(f"FAILED seed {seed}, {kind}: {fault}\n    {given[:300]!r}", flush=True)
        if seed % 2_000 == 0:
            clear_cache()
        if seed % 20_000 == 0 and seed > options.seed:
            print(f"... {seed - options.seed}, {failures} failures", file=sys.stderr, flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for kind, (tried, read, failed) in tally.items():
        print(
            f"{kind}: {tried} tried, {read} read, {tried - read - failed} refused by the documented error, {failed} failed"
        )
    print(
        f"seeds {options.seed} to {options.seed + options.count - 1}: {options.count} inputs, {failures} failures, slowest "
        f"{slowest:.2f} s, peak {peak:.0f} MB, {time.perf_counter() - begin:.0f} s"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
