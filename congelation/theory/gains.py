"""Constant gains: the ISS K-filter of Theorem 1, the standard K-filter, the matched case.

Every function here takes numbers and returns numbers. `RULES` names the ones that a
`congelation.theory.model.Gain` may ask for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, solve_continuous_are

from congelation.errors import InfeasibleDesign, InvalidInput

__all__ = [
    "RULES",
    "filter_matrix",
    "filter_norm",
    "filter_riccati",
    "hurwitz_filter_gain",
    "iss_filter_gain",
    "iss_filter_gain_varying_b",
    "iss_riccati",
    "iss_weight",
    "matched_riccati",
    "placed_filter_gain",
    "smallest_feasible_r",
    "upper_shift",
]

Matrix = NDArray[np.float64]

RESIDUAL_TOLERANCE = 1e-8
"""Largest residual of a Riccati equation, relative to its largest term, that counts as solved."""

FEASIBLE_TOLERANCE = 1e-9
"""Relative width at which the bisection for a smallest feasible number stops: far below any use
of it, far above the rounding of the Riccati solver next to the infeasible edge."""

LARGEST_FEASIBLE = 1e12
"""Where the bisection gives up: beyond it the squares in the equation exhaust double precision."""


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
    return np.diag(1.0 / epsilon_a**2 + varies / epsilon_b**2)


def iss_riccati(r: float, Q: ArrayLike) -> Matrix | None:
    """The positive definite, stabilising solution of (43), or None where there is none.

    (43) is S X + X S^T - X (e_1 e_1^T - I / r^2) X + Q = 0, the Riccati equation (44) of H-infinity
    filtering; here it is solved as a game equation with the indefinite weight diag(1, -r^2 I).

    Parameters
    ----------
    r : float
        Positive.
    Q : array_like, shape (n, n)
        Symmetric positive definite.

    Returns
    -------
    X : ndarray, shape (n, n), or None
    """
    weight = np.asarray(Q, dtype=float)
    n = weight.shape[0]
    S, e_1 = upper_shift(n), np.eye(n)[:, :1]
    inputs = np.hstack([e_1, np.eye(n)])
    indefinite = np.diag([1.0] + [-(r**2)] * n)
    X = _riccati(S.T, inputs, weight, indefinite)
    if X is None:
        return None
    closed = S - X @ (e_1 @ e_1.T - np.eye(n) / r**2)
    A_f = filter_matrix(X[:, 0] / 2)
    return X if _hurwitz(closed) and _hurwitz(A_f) else None


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
        Feasible, and within `FEASIBLE_TOLERANCE` of an infeasible value.
    """
    weight = _square(Q, n, "Q")
    # The feasible r form a half-line: if X solves (41) for r, it solves it for every larger r.
    return _least(lambda r: iss_riccati(r, weight) is not None)


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
    if not np.isfinite(gain).all() or not _hurwitz(filter_matrix(gain)):
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
    return _riccati(A_f, identity, identity, -(gain**2) * identity)


def filter_norm(k: ArrayLike) -> Matrix:
    """The least gain for which `filter_riccati` has a solution: the H-infinity norm of (40).

    Returns
    -------
    gain : ndarray, shape (1,)
        At least the norm of (s I - A_f)^-1, by no more than `FEASIBLE_TOLERANCE` of it.
    """
    gain = hurwitz_filter_gain(k)
    return np.array([_least(lambda g: filter_riccati(gain, g) is not None)])


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
    state, column, weight = _square(A, n, "A"), np.reshape(B, (n, 1)), _square(Q, n, "Q")
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
            f"Q = {weight.tolist()}; give values closer together"
        )
    raise InfeasibleDesign(
        f"rho = {rho:.9g} is infeasible with epsilon = {epsilon:.9g}, delta = {delta:.9g}: the "
        f"Riccati equation has no solution P > 0; valid: any rho > 1/epsilon^2 = {lost:.9g}"
    )


def _filter_gain(r: float, Q: Matrix, given: str) -> Matrix:
    X = iss_riccati(r, Q)
    if X is None:
        n = Q.shape[0]
        least = _rounded_up(smallest_feasible_r(n, Q))
        if r >= least:
            raise InfeasibleDesign(
                f"r = {r:.9g} is too large with {given}, n = {n}, to solve (43) in double "
                f"precision; give one nearer to the smallest feasible r, {least:.6g}"
            )
        raise InfeasibleDesign(
            f"r = {r:.9g} is infeasible with {given}, n = {n}: (43) has no solution X > 0; "
            f"the smallest feasible r is {least:.6g}"
        )
    return X[:, 0] / 2


def _least(feasible: Callable[[float], bool]) -> float:
    """The lower end of a half-line of feasible positive numbers, from its feasible side."""
    high = 1.0
    while not feasible(high):
        high *= 2.0
        if high > LARGEST_FEASIBLE:
            raise InfeasibleDesign(
                f"the Riccati equation has no solution for any gain up to {LARGEST_FEASIBLE:.0e}: "
                "its weights are too far apart for double precision"
            )
    low = high / 2.0
    while feasible(low):
        low, high = low / 2.0, low
    while high - low > FEASIBLE_TOLERANCE * high:
        middle = (low + high) / 2.0
        if feasible(middle):
            high = middle
        else:
            low = middle
    return high


def _game_riccati(A: Matrix, B: Matrix, Q: Matrix, weight: float) -> Matrix | None:
    """P > 0 with A^T P + P A - weight P B B^T P + Q = 0 and A - weight B B^T P Hurwitz."""
    if weight == 0:
        P = _riccati(A, 0 * B, Q, np.eye(1))
    else:
        P = _riccati(A, B, Q, np.array([[1.0 / weight]]))
    return P if P is not None and _hurwitz(A - weight * B @ B.T @ P) else None


def _riccati(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> Matrix | None:
    """X = X^T > 0 with A^T X + X A - X B R^-1 B^T X + Q = 0, R indefinite or not; else None."""
    try:
        X = solve_continuous_are(A, B, Q, R)
    except (LinAlgError, ValueError):  # the second: eigenvalues too close to be told apart
        return None
    quadratic = X @ B @ np.linalg.solve(R, B.T @ X)
    residual = A.T @ X + X @ A - quadratic + Q
    scale = max(np.abs(Q).max(), np.abs(quadratic).max(), np.abs(A.T @ X).max())
    solved = np.abs(residual).max() <= RESIDUAL_TOLERANCE * scale
    return X if solved and np.linalg.eigvalsh(X).min() > 0 else None


def _hurwitz(A: Matrix) -> bool:
    return bool(np.linalg.eigvals(A).real.max() < 0)


def _square(value: ArrayLike, n: int, name: str) -> Matrix:
    array = np.asarray(value, dtype=float)
    if array.shape != (n, n):
        raise InvalidInput(f"{name} has shape {array.shape}; valid: ({n}, {n})")
    return array


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
