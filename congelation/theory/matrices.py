"""The matrices S and A_f of the plants and filters, and checks of matrices that are given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput, amount, shown
from congelation.theory.riccati import exact, is_definite

__all__ = [
    "SYMMETRY_TOLERANCE",
    "Matrix",
    "filter_matrix",
    "positive_definite",
    "square",
    "upper_shift",
]

Matrix = NDArray[np.float64]

SYMMETRY_TOLERANCE = 1e-12
"""Asymmetry, relative to the largest element, that passes for rounding in a given matrix."""


def upper_shift(n: int) -> Matrix:
    """The n x n upper shift matrix S of (9) and (27)."""
    return np.eye(n, k=1)


def filter_matrix(k: ArrayLike) -> Matrix:
    """A_f = S - k e_1^T, the matrix of the K-filter (28)-(29).

    Parameters
    ----------
    k : array_like, shape (n,)
        The vector of injection gains.
    """
    gain = np.asarray(k, dtype=float).ravel()
    A_f = upper_shift(gain.size)
    A_f[:, 0] -= gain
    return A_f


def square(value: ArrayLike, n: int, name: str) -> Matrix:
    """`value` as an array of shape (n, n); `name` is for the message of another shape."""
    array = np.asarray(value, dtype=float)
    if array.shape != (n, n):
        raise InvalidInput(f"{name} = {shown(array)} is not valid; give {amount((n, n))}")
    return array


def positive_definite(Q: ArrayLike) -> Matrix:
    """Q, made symmetric to the last digit."""
    given = np.asarray(Q, dtype=float)
    if given.ndim == 2 and given.shape[0] == given.shape[1] and np.isfinite(given).all():
        weight: Matrix = (given + given.T) / 2
        symmetric = np.abs(given - weight).max() <= SYMMETRY_TOLERANCE * np.abs(given).max()
        if symmetric and is_definite(exact(weight)):
            return weight
    raise InvalidInput(f"Q = {shown(given)}; valid: symmetric and positive definite")
