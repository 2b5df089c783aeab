"""The Riccati equation (43) of the ISS K-filter: its solution, and the smallest r that has one.

Both are found in fractions (`congelation.theory.riccati`), so that "is there a solution X > 0?" has
an answer that rounding cannot change, next to the smallest r, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from congelation.errors import InfeasibleDesign
from congelation.theory.matrices import Matrix, positive_definite, square, upper_shift
from congelation.theory.riccati import (
    Exact,
    definite_inverse,
    exact,
    is_definite,
    newton,
    stabilising,
)

__all__ = [
    "FEASIBLE_TOLERANCE",
    "LARGEST_FEASIBLE",
    "iss_riccati",
    "iss_weight",
    "least_feasible",
    "smallest_feasible_r",
]

FEASIBLE_TOLERANCE = 5e-10
"""Relative width at which the bisection for a smallest feasible number stops: far below any use
of it. X of (43) grows with its inverse, and so does what a rounding of X leaves of (43)."""

ROUNDING = 2.0**-52
"""Spacing of the numbers in double precision, relative to them."""

LARGEST_FEASIBLE = 1e12
"""Where the bisection gives up: beyond it the squares in the equation exhaust double precision."""


def iss_weight(
    n: int, epsilon_a: float, epsilon_b: float = math.inf, rho: int | None = None
) -> Matrix:
    """The weight Q of (41).

    Parameters
    ----------
    n : int
        Order of the plant (27).
    epsilon_a, epsilon_b : float
        Young's weights of the variations of a(t) and b(t); an infinite `epsilon_b`, the default,
        stands for constant b, where Q = I / epsilon_a^2.
    rho : int, optional
        Relative degree, which only time-varying b needs.

    Returns
    -------
    Q : ndarray, shape (n, n)
        diag(I_{rho-1} / epsilon_a^2, (1 / epsilon_a^2 + 1 / epsilon_b^2) I_{m+1}), m = n - rho.
        (The paper prints I_{p-1} for I_{rho-1}.)
    """
    first = n if rho is None else rho
    varies = np.arange(1, n + 1) >= first
    # Products, as inside the FMUs: a power may round differently, and then X differs.
    return np.diag(1.0 / (epsilon_a * epsilon_a) + varies / (epsilon_b * epsilon_b))


def iss_riccati(r: float, Q: ArrayLike) -> Matrix | None:
    """The positive definite, stabilising solution of (43), or None where there is none.

    (43) is S X + X S^T - X (e_1 e_1^T - I / r^2) X + Q = 0, the Riccati equation (44) of H-infinity
    filtering. It is solved as the equation of P = X^-1,
    P S + S^T P + P Q P - e_1 e_1^T + I / r^2 = 0, which stays regular where X grows beyond bounds.

    Parameters
    ----------
    r : float
        Positive.
    Q : array_like, shape (n, n)
        Symmetric positive definite.

    Returns
    -------
    X : ndarray, shape (n, n), or None
        Each element is the exact one, rounded to double precision. So the residual of (43) is a few
        roundings of S X, X e_1 e_1^T X, X X / r^2 or Q, whichever is largest. Next to the smallest
        feasible r the last two nearly cancel: at r = (1 + d) times it they leave about d of either.

    Raises
    ------
    InfeasibleDesign
        If X > 0 exists but is not positive definite any more when rounded to double precision.
    """
    weight = positive_definite(Q)
    P = _inverse_solution(r, weight, _unbounded(weight))
    if P is None:
        return None
    X = _solution(P)
    if X is None:
        raise InfeasibleDesign(
            f"the solution X > 0 of (43) for r = {r:.9g} is too near to a singular matrix for "
            "double precision; give a larger r, or a Q of eigenvalues closer together"
        )
    return X


def smallest_feasible_r(n: int, Q: ArrayLike) -> float:
    """The least r for which (43) has a solution X > 0, by bisection.

    Parameters
    ----------
    n : int
        Order of the plant.
    Q : array_like, shape (n, n)
        Symmetric positive definite.

    Returns
    -------
    r : float
        Above the infimum of the feasible r, which itself is not feasible, by at most
        `FEASIBLE_TOLERANCE` of it, and by enough for `iss_riccati` to find X: where double
        precision cannot hold X so near to the infimum, by the least power of two times
        `FEASIBLE_TOLERANCE` at which it can.

    Raises
    ------
    InfeasibleDesign
        If no r up to `LARGEST_FEASIBLE` is feasible in double precision.
    """
    weight = positive_definite(square(Q, n, "Q"))
    unbounded = _unbounded(weight)

    # As r falls P falls, and the feasible r end where P ceases to be positive definite or to exist.
    def feasible(r: float) -> bool:
        return _inverse_solution(r, weight, unbounded) is not None

    def feasible_in_floats(r: float) -> bool:
        P = _inverse_in_floats(r, weight, unbounded)
        return P is not None and bool(np.linalg.eigvalsh(P).min() > 0)

    # Floats decide fast and, as P is regular at the edge, mostly well; fractions judge the outcome.
    edge = least_feasible(feasible_in_floats, infeasible=1.0, width=FEASIBLE_TOLERANCE / 8)
    low, r = edge * (1 - FEASIBLE_TOLERANCE / 2), edge * (1 + FEASIBLE_TOLERANCE / 4)
    if feasible(low) or not feasible(r):
        r = least_feasible(feasible, infeasible=1.0)
    least, margin = r, FEASIBLE_TOLERANCE
    while r <= LARGEST_FEASIBLE:
        P = _inverse_solution(r, weight, unbounded)
        if P is not None and _solution(P) is not None:
            return r
        r, margin = least * (1 + margin), 2 * margin
    raise _out_of_reach()


def least_feasible(
    feasible: Callable[[float], bool], infeasible: float, width: float = FEASIBLE_TOLERANCE
) -> float:
    """The lower end of a half-line of feasible positive numbers, from its feasible side."""
    low, high = infeasible, 2.0 * infeasible
    while not feasible(high):
        low, high = high, 2.0 * high
        if high > LARGEST_FEASIBLE:
            raise _out_of_reach()
    while high - low > width * low:
        middle = (low + high) / 2.0
        if feasible(middle):
            high = middle
        else:
            low = middle
    return high


def _unbounded(Q: Matrix) -> Exact:
    """P of `_inverse_solution` for r = infinity, which exists and is positive definite."""
    n = len(Q)
    P = stabilising(-upper_shift(n), Q, np.diag(np.eye(n)[0]))
    if P is None or not is_definite(P):
        raise _out_of_reach()
    return P


def _inverse_solution(r: float, Q: Matrix, start: Exact) -> Exact | None:
    """P = X^-1 > 0 of (43), from a solution for a larger r; None where there is none."""
    P = _inverse_in_floats(r, Q, start)
    if P is None:
        return None
    P = newton(exact(P), -upper_shift(len(Q)), Q, _observed(r, len(Q)))
    return P if P is not None and is_definite(P) else None


def _inverse_in_floats(r: float, Q: Matrix, start: Exact) -> Matrix | None:
    """P = X^-1 of (43), definite or not, roughly."""
    # Element (1, 1) of the equation of P is P_1 Q P_1^T = 1 - 1 / r^2, with P_1 the first row.
    if r <= 1:
        return None
    P: Matrix | None = newton(start.astype(float), -upper_shift(len(Q)), Q, _observed(r, len(Q)))
    return P


def _observed(r: float, n: int) -> Exact:
    """e_1 e_1^T - I / r^2."""
    weight: Exact = exact(-np.eye(n)) / Fraction(r) ** 2
    weight[0, 0] += 1
    return weight


def _solution(P: Exact) -> Matrix | None:
    """X = P^-1 in double precision, or None where rounding may take its definiteness.

    X has to be more than `ROUNDING` of its size away from singular matrices: what functions that
    work on X in double precision, a Cholesky decomposition or eigenvalues, need to find X > 0.
    """
    inverse = definite_inverse(P)
    if inverse is None:
        return None
    X: Matrix = inverse.astype(float)
    n = len(X)
    margin = exact(np.eye(n)) * Fraction(n * ROUNDING * float(np.abs(X).max()))
    return X if is_definite(exact(X) - margin) else None


def _out_of_reach() -> InfeasibleDesign:
    return InfeasibleDesign(
        f"the Riccati equation has no solution for any gain up to {LARGEST_FEASIBLE:.0e} that "
        "double precision could hold: its weights are too far apart"
    )
