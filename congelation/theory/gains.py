"""Constant gains: of the ISS K-filter of Theorem 1, of the standard K-filter, of the matched case.

Every function here takes numbers and returns numbers. `RULES` names the ones that a
`congelation.theory.model.Gain` may ask for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from congelation.errors import InfeasibleDesign, InvalidInput, shown
from congelation.theory.iss_riccati import (
    iss_riccati,
    iss_weight,
    least_feasible,
    smallest_feasible_r,
)
from congelation.theory.matrices import Matrix, filter_matrix, square
from congelation.theory.riccati import is_definite, is_hurwitz, stabilising

__all__ = [
    "RULES",
    "filter_norm",
    "filter_riccati",
    "hurwitz_filter_gain",
    "iss_filter_gain",
    "iss_filter_gain_varying_b",
    "matched_riccati",
    "placed_filter_gain",
]


def iss_filter_gain(r: float, epsilon: float, *, n: int) -> Matrix:
    """The injection gain k = X e_1 / 2 of the ISS K-filter (Theorem 1), b constant.

    Parameters
    ----------
    r, epsilon : float
        Gain of the filter from F^T Delta to the estimation error, and Young's weight, of (42).
    n : int
        Order of the plant.

    Returns
    -------
    k : ndarray, shape (n,)

    Raises
    ------
    InfeasibleDesign
        If (43) has no solution X > 0 for Q = I / epsilon^2; the text names the smallest feasible r.
    """
    _check_positive(r=r, epsilon=epsilon)
    return _filter_gain(r, iss_weight(n, epsilon), f"epsilon = {epsilon:.9g}")


def iss_filter_gain_varying_b(
    r: float, epsilon_a: float, epsilon_b: float, *, n: int, rho: int
) -> Matrix:
    """As `iss_filter_gain`, for b(t) time-varying: the Q printed with (41).

    Only the filter of Theorem 1 admits a time-varying b; Proposition 2 wants it constant.
    """
    _check_positive(r=r, epsilon_a=epsilon_a, epsilon_b=epsilon_b)
    if not 1 <= rho <= n:
        raise InvalidInput(f"rho = {rho} is not a relative degree of order {n}; valid: 1 .. {n}")
    given = f"epsilon_a = {epsilon_a:.9g}, epsilon_b = {epsilon_b:.9g}, rho = {rho}"
    return _filter_gain(r, iss_weight(n, epsilon_a, epsilon_b, rho), given)


def placed_filter_gain(poles: Sequence[complex]) -> Matrix:
    """The gain k of the standard K-filter whose A_f = S - k e_1^T has the given poles.

    The characteristic polynomial of A_f is s^n + k_1 s^{n-1} + .. + k_n.

    Parameters
    ----------
    poles : sequence of complex, length n
        In the open left half-plane, complex ones in conjugate pairs.
    """
    coefficients = np.poly(np.asarray(poles))
    if np.iscomplexobj(coefficients):
        raise InvalidInput(f"poles {list(poles)}: complex poles must come in conjugate pairs")
    return hurwitz_filter_gain(coefficients[1:])


def hurwitz_filter_gain(k: ArrayLike) -> Matrix:
    """`k` itself, if it makes A_f = S - k e_1^T Hurwitz, as every K-filter needs."""
    gain = np.asarray(k, dtype=float).ravel()
    if not np.isfinite(gain).all() or not is_hurwitz(filter_matrix(gain)):
        raise InvalidInput(
            f"k = {_listed(gain)} does not make A_f = S - k e_1^T Hurwitz; "
            "valid: the coefficients of a Hurwitz polynomial s^n + k_1 s^(n-1) + .. + k_n"
        )
    return gain


def filter_riccati(k: ArrayLike, gain: float) -> Matrix | None:
    """P > 0 with A_f^T P + P A_f + P^2 / gain^2 + I = 0, or None where there is none.

    Then V = x_tilde^T P x_tilde obeys V' <= -|x_tilde|^2 + gain^2 |F^T Delta|^2 along (40), for any
    Hurwitz A_f: the bounded real lemma. For the ISS filter r^2 X^-1 is a solution for the gain
    r epsilon, which makes (42) a special case.

    Parameters
    ----------
    k : array_like, shape (n,)
        With A_f = S - k e_1^T Hurwitz.
    gain : float
        Positive.
    """
    A_f = filter_matrix(k)
    identity = np.eye(A_f.shape[0])
    # -P is a stabilising solution in the form with a definite quadratic term.
    negative = stabilising(A_f, identity / gain**2, -identity)
    return None if negative is None or not is_definite(-negative) else (-negative).astype(float)


def filter_norm(k: ArrayLike) -> Matrix:
    """The least gain for which `filter_riccati` has a solution: the H-infinity norm of (40).

    Returns
    -------
    gain : ndarray, shape (1,)
        At least the norm of (s I - A_f)^-1, by no more than `FEASIBLE_TOLERANCE` of it.
    """
    gain = hurwitz_filter_gain(k)
    # The response at frequency 0, (-A_f)^-1, bounds the norm from below; half of it is below
    # whatever rounding makes of it.
    at_rest = np.linalg.norm(np.linalg.inv(filter_matrix(gain)), 2)
    return np.array(
        [least_feasible(lambda g: filter_riccati(gain, g) is not None, float(at_rest) / 2)]
    )


def matched_riccati(
    rho: float,
    epsilon: float,
    delta: float,
    damping: float,
    Q: ArrayLike,
    *,
    A: ArrayLike,
    B: ArrayLike,
) -> Matrix:
    """P = P^T > 0 of the matched case, the Riccati equation that stands for (8).

    A^T P + P A - (rho - 1/epsilon^2) P B B^T P + epsilon^2 delta^2 I + Q = 0, by completing squares
    in 2 x^T P B Delta^T x <= |B^T P x|^2 / epsilon^2 + epsilon^2 delta^2 |x|^2.

    Parameters
    ----------
    rho : float
        Weight of the feedback -(rho/2) B^T P x.
    epsilon, delta : float
        Young's weight, and the radius of theta(t).
    damping : float
        1: Controller 1. 0: Controller 2, without the two terms that hold epsilon.
    Q : array_like, shape (n, n)
        Symmetric positive definite: V' <= -x^T Q x.
    A, B : array_like, shapes (n, n), (n, 1)
        The known part of the plant.

    Returns
    -------
    P : ndarray, shape (n, n)

    Raises
    ------
    InfeasibleDesign
        If there is no such P; the text names a rho that is enough, or says that (A, B) cannot be
        stabilised.
    """
    _check_positive(rho=rho, epsilon=epsilon)
    n = np.asarray(A).shape[0]
    state, column, weight = square(A, n, "A"), np.reshape(B, (n, 1)), square(Q, n, "Q")
    lost = damping / epsilon**2
    constant = weight + damping * epsilon**2 * delta**2 * np.eye(n)
    P = _game_riccati(state, column, constant, rho - lost)
    if P is not None:
        return P
    if _game_riccati(state, column, np.eye(n), 1.0) is None:
        raise InfeasibleDesign("the pair (A, B) of the matched plant cannot be stabilised")
    if rho > lost:
        raise InfeasibleDesign(
            "the Riccati equation for P cannot be solved in double precision with "
            f"rho = {rho:.9g}, epsilon = {epsilon:.9g}, delta = {delta:.9g}, "
            f"Q = {shown(weight)}; give values closer together"
        )
    raise InfeasibleDesign(
        f"rho = {rho:.9g} is infeasible with epsilon = {epsilon:.9g}, delta = {delta:.9g}: the "
        f"Riccati equation has no solution P > 0; valid: any rho > 1/epsilon^2 = {lost:.9g}"
    )


def _filter_gain(r: float, Q: Matrix, given: str) -> Matrix:
    if not 0 < Q[0, 0] < math.inf:
        raise InfeasibleDesign(f"{given}: the weight Q of (41) leaves the range of floats")
    X = iss_riccati(r, Q)
    if X is None:
        n = Q.shape[0]
        raise InfeasibleDesign(
            f"r = {r:.9g} is infeasible with {given}, n = {n}: (43) has no solution X > 0; "
            f"the smallest feasible r is {_rounded_up(smallest_feasible_r(n, Q)):.6g} "
            "(docs/theory.md, 'The ISS K-filter')"
        )
    return X[:, 0] / 2


def _game_riccati(A: Matrix, B: Matrix, Q: Matrix, weight: float) -> Matrix | None:
    """P > 0 with A^T P + P A - weight P B B^T P + Q = 0 and A - weight B B^T P Hurwitz."""
    P = stabilising(A, weight * B @ B.T, Q)
    return P.astype(float) if P is not None and is_definite(P) else None


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise InvalidInput(f"{name} = {value:.9g}; valid: positive and finite")


def _rounded_up(value: float, digits: int = 6) -> float:
    step = 10.0 ** (math.floor(math.log10(value)) + 1 - digits)
    return math.ceil(value / step) * step


def _listed(values: Matrix) -> str:
    return "[" + ", ".join(f"{v:.9g}" for v in values) + "]"


RULES: Mapping[str, Callable[..., Matrix]] = MappingProxyType(
    {
        "filter_norm": filter_norm,
        "hurwitz_filter_gain": hurwitz_filter_gain,
        "iss_filter_gain": iss_filter_gain,
        "iss_filter_gain_varying_b": iss_filter_gain_varying_b,
        "matched_riccati": matched_riccati,
    }
)
"""Every rule by name; called as ``rule(*values of the parameters, **constants)``."""
