"""Independent pieces of work through joblib: serial, on all cores, or on a Dask or Ray cluster.

`with joblib.parallel_config("dask"):` around any sweep, multi-start or bootstrap spreads it over that cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import IO, Any, cast

from .journal import active, digest
from .telling import Stderr


@cache
def _pools() -> Any:
    from threadpoolctl import ThreadpoolController  # looks once which libraries are loaded

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run small matrix blocks on one thread: beside another busy process, BLAS threads wait for each other."""
    with _pools().limit(limits=1, user_api="blas"):
        yield


def sweep(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    what: str = "",
    jobs: int | None = None,
    holds: Callable[[Any], bool] = lambda result: True,
    resumed: Callable[[int], Any] = lambda done: None,
) -> list[Any]:
    """Return [function(*call) for call in calls], in order.

    Inside `with narx_sym.resuming(file):` each result is kept there, and results that are there are not computed again.

    Parameters
    ----------
    calls : iterable of argument tuples
    what : str
        A description: with it, a progress bar is shown on stderr.
    jobs : int, optional
        As `n_jobs` of joblib: -1 for all cores. By default what `joblib.parallel_config` says, else one.
    holds : function of a kept result
        Whether it is still worth something: a file that came with it may have gone since.
    resumed : callable
        Told how many calls need not be made, as their results are there.
    """
    from joblib import Parallel, delayed

    listed, journal = list(calls), active()
    keys = [digest(function, *call) for call in listed] if journal is not None else []
    done = {i: found[0] for i, key in enumerate(keys) if journal is not None and (found := journal.find(key, holds))}
    resumed(len(done))
    todo = [i for i in range(len(listed)) if i not in done]
    results: Iterable[Any] = Parallel(n_jobs=jobs, return_as="generator")(delayed(function)(*listed[i]) for i in todo)
    if what:
        from rich.console import Console
        from rich.progress import track

        results = track(results, description=what, total=len(todo), console=Console(file=cast(IO[str], Stderr())))
    for i, result in zip(todo, results, strict=True):
        if journal is not None:
            journal.keep(keys[i], result)
        done[i] = result
    return [done[i] for i in range(len(listed))]
