"""Stabilising solutions of Riccati equations, exact but for one rounding at the end.

The equation is A^T P + P A - P G P + C = 0, and P stabilises if A - G P is Hurwitz. Newton's method
(D. L. Kleinman, IEEE Trans. Automat. Contr. 13 (1968) 114-115) corrects P by Lyapunov equations.
Their right-hand side, the residual, is computed in rational numbers without rounding, and P is kept
in them. So the error of P is far below double precision, whatever the condition of the equation,
and questions such as "is P positive definite?" have an answer that no rounding can change.
"""

from __future__ import annotations

import warnings
from fractions import Fraction
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Exact",
    "definite_inverse",
    "exact",
    "is_definite",
    "is_hurwitz",
    "newton",
    "stabilising",
]

Matrix = NDArray[np.float64]
Exact = NDArray[np.object_]
"""A matrix of `fractions.Fraction`."""

MOST_STEPS = 100
"""Newton's method converges quadratically; where it needs more steps, P is next to not existing."""

ROUGH, FINE = 2.0**-20, 2.0**-80
"""Largest last step relative to P, in floats and in fractions. The error that remains is smaller,
as the steps shrink quadratically: in fractions far below the 2^-53 of double precision."""


def exact(values: ArrayLike) -> Exact:
    """The same numbers as fractions."""
    return np.array(np.vectorize(Fraction, otypes=[object])(np.asarray(values)), dtype=object)


def stabilising(A: ArrayLike, G: ArrayLike, C: ArrayLike) -> Exact | None:
    """P = P^T with A^T P + P A - P G P + C = 0 and A - G P Hurwitz, or None where there is none.

    Parameters
    ----------
    A, G, C : array_like, shapes (n, n)
        G and C symmetric, definite or not.

    Returns
    -------
    P : ndarray of Fraction, shape (n, n), or None
    """
    drift, quadratic, constant = (np.asarray(value, dtype=float) for value in (A, G, C))
    eigenvalues, vectors = np.linalg.eigh(quadratic)  # G = B R^-1 B^T, as scipy has it
    B = vectors * np.sqrt(np.abs(eigenvalues))
    R = np.diag(np.where(eigenvalues < 0, -1.0, 1.0))
    try:
        P = scipy.linalg.solve_continuous_are(drift, B, constant, R)
    except (
        np.linalg.LinAlgError,
        ValueError,
    ):  # the second: eigenvalues too close to be told apart
        return None
    P = newton(P, A, G, C)
    return None if P is None else newton(exact(P), A, G, C)


def newton(P: Exact | Matrix, A: ArrayLike, G: ArrayLike, C: ArrayLike) -> Any:
    """As `stabilising`, from a P with A - G P Hurwitz, in the arithmetic of P: floats or fractions.

    If G >= 0 and a stabilising solution exists, every such P leads to it: all steps stabilise, and
    from the first one on they fall towards the solution. So None means that there is none.
    """
    drift, quadratic = np.asarray(A, dtype=float), np.asarray(G, dtype=float)
    rational = P.dtype == object
    equation = [exact(M) if rational else np.asarray(M, dtype=float) for M in (A, G, C)]
    for _ in range(MOST_STEPS):
        closed = drift - quadratic @ P.astype(float)
        if not is_hurwitz(closed):
            return None
        step = _lyapunov(closed, _residual(P, *equation).astype(float))
        P = P + (exact(step) if rational else step)
        if np.abs(step).max() <= (FINE if rational else ROUGH) * np.abs(P.astype(float)).max():
            return P
    return None


def _residual(P: Any, A: Any, G: Any, C: Any) -> Any:
    half = P @ A
    return half + half.T - P @ G @ P + C


def _lyapunov(A: Matrix, Q: Matrix) -> Matrix:
    """D = D^T with A^T D + D A + Q = 0 for a Hurwitz A."""
    with warnings.catch_warnings():
        # "Nearly singular": the next residual tells what the step was worth.
        warnings.simplefilter("ignore", RuntimeWarning)
        D = scipy.linalg.solve_continuous_lyapunov(A.T, -Q)
    return np.asarray((D + D.T) / 2)


def is_hurwitz(A: Matrix) -> bool:
    """Whether all eigenvalues of A have negative real parts; False if A is not finite."""
    return bool(np.isfinite(A).all() and np.linalg.eigvals(A).real.max() < 0)


def is_definite(P: Exact) -> bool:
    """Whether P = P^T is positive definite: all pivots of the elimination are positive."""
    rest = P
    while rest.size:
        if not rest[0, 0] > 0:
            return False
        rest = rest[1:, 1:] - np.outer(rest[1:, 0], rest[0, 1:] / rest[0, 0])
    return True


def definite_inverse(P: Exact) -> Exact | None:
    """P^-1, or None where P = P^T is not positive definite."""
    n = len(P)
    rows = np.hstack([P, exact(np.eye(n))])
    for i in range(n):
        if not rows[i, i] > 0:
            return None
        rows[i] = rows[i] / rows[i, i]
        for j in range(n):
            if j != i:
                rows[j] = rows[j] - rows[j, i] * rows[i]
    return rows[:, n:]
