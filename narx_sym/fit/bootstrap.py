"""How sure a free-run fit is: parameter sets that other noise of the same kind would have given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data.metrics import correlation_length
from ..data.record import Record
from ..errors import FitError
from ..files.parallel import sweep
from ..models.model import Model
from .constraints import constraint_equations
from .ensemble import Bands, bands
from .freerun import FreeRun
from .simulate import Records

Array = np.ndarray


@dataclass(frozen=True)
class Bootstrap:
    """Parameter sets of a moving-block bootstrap.

    Attributes
    ----------
    model : Model
    thetas : (draws, n_theta) array
    block : int
        Block length [samples].
    """

    model: Model
    thetas: Array
    block: int

    @property
    def std(self) -> Array:
        """Standard errors for coloured residuals too, of records many correlation lengths long, (n_theta,)."""
        return np.asarray(self.thetas.std(axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Lower and upper quantiles of each parameter, (2, n_theta)."""
        tail = (1 - level) / 2
        return np.asarray(np.quantile(self.thetas, [tail, 1 - tail], axis=0))

    def bands(self, record: Record) -> Bands:
        """Mean, lowest and highest free run of the parameter sets along a record."""
        return bands(self.model, self.thetas, record)


def block_length(x: Array, most: int) -> int:
    """Return a length of blocks that keeps the correlation of a series: three correlation lengths, at most `most`."""
    return int(min(max(10, 3 * correlation_length(x)), max(2, most)))


def as_large(residual: Array, parameters: int) -> Array:
    """Return a residual as large as the noise was: so many parameters have taken their part of it.

    What counts are independent samples, a few in a short record of coloured noise.
    """
    independent = max(residual.size / (2 * correlation_length(residual) - 1), parameters + 2.0)
    return np.asarray(residual * np.sqrt(independent / (independent - parameters - 1)))


def moving_blocks(x: Array, block: int, draws: int, rng: np.random.Generator) -> Array:
    """Return series made of blocks of another one, (draws, N), the blocks drawn with replacement (Kunsch 1989)."""
    n = x.size
    starts = rng.integers(0, n - block + 1, size=(draws, -(-n // block)))
    return np.asarray(x[(starts[:, :, None] + np.arange(block)).reshape(draws, -1)[:, :n]])


def fresh_blocks(x: Array, block: int, draws: int, size: int, rng: np.random.Generator) -> Array:
    """Return series as new records might show them, (draws, size): blocks drawn from those of a resampled record.

    Each has a record of its own. So they also differ by what one record does not tell of its own noise.
    """
    starts = rng.integers(0, x.size - block + 1, size=(draws, -(-x.size // block)))
    drawn = rng.integers(0, starts.shape[1], size=(draws, -(-size // block)))
    own = np.take_along_axis(starts, drawn, axis=1)
    return np.asarray(x[(own[:, :, None] + np.arange(block)).reshape(draws, -1)[:, :size]])


def block_bootstrap(
    model: Model, records: Records, draws: int = 200, block: int | None = None, seed: int = 0, steps: int = 2
) -> Bootstrap:
    """Resample the free-run residual in blocks and refit (Kunsch 1989).

    Parameters
    ----------
    model : Model, fitted in free run
    draws : int
    block : int, optional
        At least three correlation lengths of the residual by default [samples].
    seed : int
        Each draw has its own generator: serial and parallel runs give the same sets.
    steps : int
        Gauss-Newton steps per draw from the fitted parameters.
    """
    problem = FreeRun(model, records, constraint_equations(model, None))
    z = problem.start(model.theta)
    residual = problem.run(z)[0].copy()
    if not np.all(np.isfinite(residual)):
        raise FitError("The free run of the model diverges on these records.")
    size = block or block_length(residual, residual.size // 4)
    noise = as_large(residual, problem.free)
    calls = [(problem, z, residual, noise, size, seed, i, steps) for i in range(draws)]
    return Bootstrap(model, np.array(sweep(_draw, calls)), size)


def _draw(
    problem: FreeRun, z: Array, residual: Array, noise: Array, block: int, seed: int, number: int, steps: int
) -> Array:
    rng = np.random.default_rng([seed, number])
    noise = moving_blocks(noise, block, 1, rng)[0]
    noise = noise - noise.mean() + residual.mean()
    moved = z.copy()
    for _ in range(steps):
        # The data of this draw are the model's own run plus resampled noise.
        now, slopes = problem.run(moved)
        gap = now - residual + noise
        moved = moved - np.linalg.lstsq(slopes, gap, rcond=None)[0]
        if not np.all(np.isfinite(problem.run(moved)[0])):
            break
    return problem.theta(moved)
