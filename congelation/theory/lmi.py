"""The Riccati inequality (41) as a linear matrix inequality, with cvxpy (the extra ``lmi``).

With P = X^-1, (41) multiplied by P from both sides is, by a Schur complement,

    [ P S + S^T P - e_1 e_1^T + I/r^2    P Q^{1/2} ]
    [ Q^{1/2} P                          -I        ]  <= 0,    P > 0,

linear in P and in 1/r^2. Of its many solutions the least is the stabilising one of (43), so this
is an independent way to the filters of `congelation.theory.gains`, and the place to start from
where further conditions on the filter are convex in P.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InfeasibleDesign, InvalidInput
from congelation.theory.matrices import upper_shift

__all__ = ["iss_lmi", "smallest_feasible_r_lmi"]

Matrix = NDArray[np.float64]


def iss_lmi(r: float, Q: ArrayLike) -> Matrix:
    """The least X > 0 that satisfies the inequality (41), by least trace; k = X e_1 / 2.

    Parameters
    ----------
    r : float
        Positive.
    Q : array_like, shape (n, n)
        Symmetric positive definite.

    Returns
    -------
    X : ndarray, shape (n, n)

    Raises
    ------
    InfeasibleDesign
        If there is none for this r.
    InvalidInput
        If cvxpy is not installed.
    """
    cp = _cvxpy()
    weight = np.asarray(Q, dtype=float)
    n = weight.shape[0]
    P, Z = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
    inverse = cp.bmat([[P, np.eye(n)], [np.eye(n), Z]])  # Z >= P^-1
    constraints = [_inequality(cp, P, weight, 1 / r**2) << 0, inverse >> 0]
    if not _solved(cp.Problem(cp.Minimize(cp.trace(Z)), constraints)):
        raise InfeasibleDesign(
            f"r = {r:.9g} is infeasible: (41) has no solution X > 0; the smallest feasible r is "
            f"{smallest_feasible_r_lmi(weight):.6g}"
        )
    X = np.linalg.inv(P.value)
    return np.asarray((X + X.T) / 2, dtype=float)


def smallest_feasible_r_lmi(Q: ArrayLike) -> float:
    """The least r for which (41) has a solution, by one semidefinite programme.

    An independent way to what `smallest_feasible_r` of `congelation.theory.iss_riccati` finds by
    bisection.
    """
    cp = _cvxpy()
    weight = np.asarray(Q, dtype=float)
    n = weight.shape[0]
    P, s = cp.Variable((n, n), symmetric=True), cp.Variable()
    problem = cp.Problem(cp.Maximize(s), [_inequality(cp, P, weight, s) << 0, P >> 0])
    if not _solved(problem):
        raise InfeasibleDesign("(41) has no solution for any r; valid: Q positive definite")
    return 1 / math.sqrt(s.value)


def _inequality(cp: Any, P: Any, Q: Matrix, s: Any) -> Any:
    """The block matrix above, with s for 1/r^2, made symmetric for the solver's sake."""
    n = Q.shape[0]
    S, root, identity = upper_shift(n), np.real(scipy.linalg.sqrtm(Q)), np.eye(n)
    corner = P @ S + S.T @ P - np.outer(identity[0], identity[0]) + s * identity
    block = cp.bmat([[corner, P @ root], [root @ P, -identity]])
    return (block + block.T) / 2


def _solved(problem: Any) -> bool:
    problem.solve(solver="CLARABEL")
    return problem.status in {"optimal", "optimal_inaccurate"}


def _cvxpy() -> Any:
    try:
        return importlib.import_module("cvxpy")
    except ImportError as error:
        raise InvalidInput(
            "the inequality (41) needs cvxpy: pip install 'congelation[lmi]'"
        ) from error
