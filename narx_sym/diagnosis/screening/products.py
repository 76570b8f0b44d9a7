"""Lengths and angles of directions and of a residual along the samples, after what a refit absorbs is taken out.

That is all the gate asks of them, so that thousands of rows are read once.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular, toeplitz

from ..settings import BLOCK, CHUNK, TINY

Array = np.ndarray


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of columns; what is below rounding is left out."""
    if columns.shape[1] == 0:
        return columns
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0, size, 1.0)
    if columns.shape[1] == 1:
        length = float(np.linalg.norm(scaled))
        return scaled / length if length**2 > TINY else scaled[:, :0]
    Q, R, _ = qr(scaled, mode="economic", pivoting=True)
    return np.asarray(Q[:, np.abs(np.diag(R)) ** 2 > TINY])


@dataclass(frozen=True)
class Left:
    """What a refit of the model leaves of a residual and of directions.

    Attributes
    ----------
    energy : (M,) array
        Of each column before.
    columns : (M, M) array
        Inner products of the columns with each other.
    residual : (M,) array
        And with the residual.
    power : float
        Of the residual with itself.
    rank : int
        How many directions the refit has.
    count : int
        Samples.
    """

    energy: Array
    columns: Array
    residual: Array
    power: float
    rank: int
    count: int

    @classmethod
    def of(
        cls, own: Array, residual: Array, directions: Array, edges: Array, rows: Array, a: Array | None = None
    ) -> Left:
        """Take a refit out, after filtering each segment by A(q); see `score` for the arguments."""
        a = np.ones(1) if a is None else a
        seen = np.concatenate(list(whitened(np.column_stack([residual, own]), a, edges, rows)))
        Q = orthonormal(seen[:, 1:])
        e = seen[:, 0] - Q @ (Q.T @ seen[:, 0])
        m, at = directions.shape[1], 0
        whole, along, with_e = np.zeros((m, m)), np.zeros((Q.shape[1], m)), np.zeros(m)
        for part in whitened(directions, a, edges, rows):
            here = slice(at, at := at + len(part))
            whole += part.T @ part
            along += Q[here].T @ part
            with_e += e[here] @ part
        return cls(whole.diagonal().copy(), whole - along.T @ along, with_e, float(e @ e), Q.shape[1], int(rows.sum()))

    @cached_property
    def usable(self) -> Array:
        """Which columns a refit leaves more of than rounding, (M,)."""
        return self.columns.diagonal() > 1e-6 * self.energy

    def without(self, column: int) -> Left:
        """Take out what one of the columns explains too."""
        own = self.columns[column] / np.sqrt(self.columns[column, column])
        part = self.residual[column] / np.sqrt(self.columns[column, column])
        return Left(
            self.energy, self.columns - np.outer(own, own), self.residual - part * own, self.power - part**2,
            self.rank + 1, self.count,
        )  # fmt: skip

    @property
    def gains(self) -> Array:
        """What each column explains of the residual's power, (M,)."""
        return np.where(self.usable, self.residual**2 / np.where(self.usable, self.columns.diagonal(), 1.0), 0.0)

    def basis(self, groups: Sequence[slice]) -> tuple[Array, Array]:
        """Return orthonormal sums of each group's columns, (M, sums), and the group that each belongs to, (sums,)."""
        return bases(self.columns, self.energy, groups)

    def shares(self, groups: Sequence[slice]) -> tuple[Array, Array]:
        """Return what each group explains of the residual's energy, and what a refit absorbs of the group's."""
        basis, owner = self.basis(groups)
        share = np.bincount(owner, (basis.T @ self.residual) ** 2, len(groups)) / (self.power or 1.0)
        left = np.array([[x[c].sum() for c in groups] for x in (self.columns.diagonal(), self.energy)])
        return share, 1 - left[0] / np.where(left[1] > 0, left[1], 1.0)


def bases(products: Array, energy: Array, groups: Sequence[slice]) -> tuple[Array, Array]:
    """Return orthonormal sums of the columns of each group, (M, sums), and the group that each belongs to, (sums,).

    Parameters
    ----------
    products : (M, M) array
        Inner products of the columns.
    energy : (M,) array
        A sum below rounding of it is left out.
    groups : slices of columns
    """
    size = np.sqrt(np.where(energy > 0, energy, 1.0))
    made, owner = [], []
    for i, group in enumerate(groups):
        scaled = products[group, group] / np.outer(size[group], size[group])
        R, order, rank, _ = lapack.dpstrf(scaled, tol=TINY)
        rank = int(rank) if scaled.max() > TINY else 0
        sums = np.zeros((products.shape[0], rank))
        at = group.start + order[:rank] - 1
        sums[at] = solve_triangular(np.triu(R[:rank, :rank]), np.eye(rank)) / size[at, None]
        made.append(sums)
        owner.append(np.full(rank, i))
    return np.column_stack(made), np.concatenate(owner)


def told(groups: Sequence[slice], products: Array, basis: Array, owner: Array) -> Array:
    """Return how much energy of each group's columns (row) each group's basis has (column), (groups, groups)."""
    energy = np.zeros((len(groups), len(products)))
    np.add.at(energy, owner, (basis.T @ products) ** 2)
    return np.array([energy[:, columns].sum(axis=1) for columns in groups])


def filtered(x: Array, a: Array) -> Array:
    """Filter columns, (N, M), by A(q) where all of the past is there, (N - p, M): products with a banded matrix."""
    past = a.size - 1
    if not past:
        return x * a[0]
    band = toeplitz(np.r_[a[-1], np.zeros(BLOCK - 1)], np.r_[a[::-1], np.zeros(BLOCK - 1)])
    out = np.empty((max(0, len(x) - past), x.shape[1]))
    for at in range(0, len(out), BLOCK):
        n = min(BLOCK, len(out) - at)
        np.matmul(band[:n, : n + past], x[at : at + n + past], out=out[at : at + n])
    return out


def whitened(columns: Array, a: Array, edges: Array, rows: Array) -> Iterator[Array]:
    """Filter each segment by A(q); yield the rows that count, some at a time, without the first, which have no past."""
    past = a.size - 1
    for begin, end in itertools.pairwise(edges):
        for at in range(begin + past, end, CHUNK):
            to = min(at + CHUNK, end)
            yield filtered(columns[at - past : to], a)[rows[at:to]]
