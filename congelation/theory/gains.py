"""Constant gains: the ISS K-filter of Theorem 1, the standard K-filter, the matched case.

Every function here takes numbers and returns numbers. `RULES` names the ones that a
`congelation.theory.model.Gain` may ask for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InfeasibleDesign, InvalidInput, amount, shown
from congelation.theory.riccati import (
    Exact,
    definite_inverse,
    exact,
    is_definite,
    is_hurwitz,
    newton,
    stabilising,
)

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

FEASIBLE_TOLERANCE = 5e-10
"""Relative width at which the bisection for a smallest feasible number stops: far below any use
of it. X of (43) grows with its inverse, and so does what a rounding of X leaves of (43)."""

ROUNDING = 2.0**-52
"""Spacing of the numbers in double precision, relative to them."""

SYMMETRY_TOLERANCE = 1e-12
"""Asymmetry, relative to the largest element, that passes for rounding in a given matrix."""

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
    weight = _positive_definite(Q)
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
    weight = _positive_definite(_square(Q, n, "Q"))
    unbounded = _unbounded(weight)

    # As r falls P falls, and the feasible r end where P ceases to be positive definite or to exist.
    def feasible(r: float) -> bool:
        return _inverse_solution(r, weight, unbounded) is not None

    def feasible_in_floats(r: float) -> bool:
        P = _inverse_in_floats(r, weight, unbounded)
        return P is not None and bool(np.linalg.eigvalsh(P).min() > 0)

    # Floats decide fast and, as P is regular at the edge, mostly well; fractions judge the outcome.
    edge = _least(feasible_in_floats, infeasible=1.0, width=FEASIBLE_TOLERANCE / 8)
    low, r = edge * (1 - FEASIBLE_TOLERANCE / 2), edge * (1 + FEASIBLE_TOLERANCE / 4)
    if feasible(low) or not feasible(r):
        r = _least(feasible, infeasible=1.0)
    least, margin = r, FEASIBLE_TOLERANCE
    while r <= LARGEST_FEASIBLE:
        P = _inverse_solution(r, weight, unbounded)
        if P is not None and _solution(P) is not None:
            return r
        r, margin = least * (1 + margin), 2 * margin
    raise _out_of_reach()


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
    return np.array([_least(lambda g: filter_riccati(gain, g) is not None, float(at_rest) / 2)])


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
            f"the smallest feasible r is {_rounded_up(smallest_feasible_r(n, Q)):.6g}"
        )
    return X[:, 0] / 2


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


def _least(
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


def _out_of_reach() -> InfeasibleDesign:
    return InfeasibleDesign(
        f"the Riccati equation has no solution for any gain up to {LARGEST_FEASIBLE:.0e} that "
        "double precision could hold: its weights are too far apart"
    )


def _game_riccati(A: Matrix, B: Matrix, Q: Matrix, weight: float) -> Matrix | None:
    """P > 0 with A^T P + P A - weight P B B^T P + Q = 0 and A - weight B B^T P Hurwitz."""
    P = stabilising(A, weight * B @ B.T, Q)
    return P.astype(float) if P is not None and is_definite(P) else None


def _square(value: ArrayLike, n: int, name: str) -> Matrix:
    array = np.asarray(value, dtype=float)
    if array.shape != (n, n):
        raise InvalidInput(f"{name} = {shown(array)} is not valid; give {amount((n, n))}")
    return array


def _positive_definite(Q: ArrayLike) -> Matrix:
    """Q, made symmetric to the last digit."""
    given = np.asarray(Q, dtype=float)
    if given.ndim == 2 and given.shape[0] == given.shape[1] and np.isfinite(given).all():
        weight: Matrix = (given + given.T) / 2
        symmetric = np.abs(given - weight).max() <= SYMMETRY_TOLERANCE * np.abs(given).max()
        if symmetric and is_definite(exact(weight)):
            return weight
    raise InvalidInput(f"Q = {shown(given)}; valid: symmetric and positive definite")


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
