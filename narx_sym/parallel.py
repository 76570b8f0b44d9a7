"""Independent pieces of work through joblib: serial, on all cores, or on a Dask or Ray cluster.

`with joblib.parallel_config("dask"):` around any sweep, multi-start or bootstrap spreads it over that cluster.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from typing import Any


def sweep(
    function: Callable[..., Any], calls: Iterable[tuple[Any, ...]], what: str = "", jobs: int | None = None
) -> list[Any]:
    """Return [function(*call) for call in calls], in order.

    Parameters
    ----------
    calls : iterable of argument tuples
    what : str
        A description: with it, a progress bar is shown on stderr.
    jobs : int, optional
        As `n_jobs` of joblib: -1 for all cores. By default what `joblib.parallel_config` says, else one.
    """
    from joblib import Parallel, delayed

    listed = list(calls)
    results = Parallel(n_jobs=jobs, return_as="generator")(delayed(function)(*call) for call in listed)
    if not what:
        return list(results)
    from rich.console import Console
    from rich.progress import track

    return list(track(results, description=what, total=len(listed), console=Console(file=sys.stderr)))
