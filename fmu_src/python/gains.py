"""Gains that follow from parameters by a Riccati equation, solved when the FMU is initialised.

The equations are solved by the matrix sign function of their Hamiltonian: J. D. Roberts, Linear
model reduction and solution of the algebraic Riccati equation by use of the sign function,
Int. J. Control 32 (1980) 677-687, with the determinant scaling of R. Byers, Linear Algebra Appl.
85 (1987) 267-279.
"""

from __future__ import annotations

from .linear_algebra import cholesky, determinant, identity, inverse, product, transpose

__all__ = ["RULES", "Infeasible"]

MOST_ITERATIONS = 100
# The iteration converges quadratically; past this relative change nothing is gained.
CONVERGED = 1e-14
# What the solution of a feasible equation leaves, relative to its terms, is rounding.
LARGEST_RESIDUAL = 1e-8
# Beyond it the squares in the equations exhaust double precision.
LARGEST_FEASIBLE = 1e12


class Infeasible(ValueError):
    """The gains asked for do not exist; the text names the nearest ones that do."""


def riccati(a, g, q):
    """The stabilising X = X^T > 0 of ``a X + X a^T - X g X + q = 0``, or None.

    None where the Hamiltonian has eigenvalues on the imaginary axis, or X is not positive
    definite: the equation then has no solution that a filter or controller can use.
    """
    n = len(a)
    at = transpose(a)
    hamiltonian = [
        *([*at[i], *(-value for value in g[i])] for i in range(n)),
        *([*(-value for value in q[i]), *(-value for value in a[i])] for i in range(n)),
    ]
    sign = _matrix_sign(hamiltonian)
    if sign is None:
        return None
    x = _stable_subspace(sign, n)
    if x is None or cholesky(x) is None:
        return None
    return x if _residual(a, g, q, x) < LARGEST_RESIDUAL else None


def _matrix_sign(a):
    """lim a_(k+1) = (a_k / c + c a_k^-1) / 2, or None where it does not converge."""
    size = len(a)
    for _ in range(MOST_ITERATIONS):
        scale = abs(determinant(a)) ** (1.0 / size)
        if not 0.0 < scale < float("inf"):
            return None
        b = inverse(a)
        new = [
            [0.5 * (x / scale + y * scale) for x, y in zip(row_a, row_b)]
            for row_a, row_b in zip(a, b)
        ]
        change = sum(abs(x - y) for r, s in zip(new, a) for x, y in zip(r, s))
        magnitude = sum(abs(x) for r in new for x in r)
        a = new
        if change <= CONVERGED * magnitude:
            return a
    return a if change <= 1e-9 * magnitude else None


def _stable_subspace(sign, n):
    """X from the kernel of sign + I, which is spanned by [I; X]: a least-squares solution."""
    w11 = [[sign[i][j] + (i == j) for j in range(n)] for i in range(n)]
    w12 = [row[n:] for row in sign[:n]]
    w21 = [row[:n] for row in sign[n:]]
    w22 = [[sign[n + i][n + j] + (i == j) for j in range(n)] for i in range(n)]
    left, right = w12 + w22, w11 + w21
    normal = product(transpose(left), left)
    try:
        x = product(inverse(normal), product(transpose(left), right))
    except ZeroDivisionError:
        return None
    return [[-0.5 * (x[i][j] + x[j][i]) for j in range(n)] for i in range(n)]


def _residual(a, g, q, x):
    ax = product(a, x)
    xgx = product(product(x, g), x)
    n = range(len(a))
    size = max(abs(v) for m in (ax, xgx, q) for row in m for v in row)
    return max(abs(ax[i][j] + ax[j][i] - xgx[i][j] + q[i][j]) for i in n for j in n) / size


def _shift(n):
    """The n x n upper shift matrix S of (27)."""
    return [[1.0 if j == i + 1 else 0.0 for j in range(n)] for i in range(n)]


def _scaled(a, factor):
    return [[factor * value for value in row] for row in a]


def _inverse_square(value):
    """1 / value^2, infinite or 0 where a power would raise an error."""
    return (1.0 / value) * (1.0 / value)


def _filter_solution(n, r, epsilon):
    """X of (43) with Q = I / epsilon^2, or None."""
    lost = _inverse_square(r)
    g = [[(i == 0) - lost if i == j else 0.0 for j in range(n)] for i in range(n)]
    return riccati(_shift(n), g, _scaled(identity(n), _inverse_square(epsilon)))


def iss_filter_gain(r, epsilon, n):
    """k = X e_1 / 2 of the ISS K-filter (Theorem 1), X > 0 solving (43).

    Raises
    ------
    Infeasible
        If (43) has no positive definite solution; the text names the smallest feasible r.
    """
    x = _filter_solution(n, r, epsilon)
    if x is None:
        least = _least(lambda value: _filter_solution(n, value, epsilon) is not None, r)
        raise Infeasible(
            f"(r = {r:.6g}, epsilon = {epsilon:.6g}) is infeasible: (43) has no positive definite "
            f"solution; the smallest feasible r is about {least:.4g}"
        )
    return [0.5 * row[0] for row in x]


def _least(feasible, infeasible, width=1e-4):
    """The least number that is feasible, to a relative width, above one that is not."""
    low, high = infeasible, 2.0 * infeasible
    while not feasible(high):
        if high > LARGEST_FEASIBLE:
            raise ArithmeticError(
                f"up to {LARGEST_FEASIBLE:.0e} nothing solves the Riccati equation in double "
                "precision"
            )
        low, high = high, 2.0 * high
    while high - low > width * high:
        middle = 0.5 * (low + high)
        if feasible(middle):
            high = middle
        else:
            low = middle
    return high


def _filter_matrix(k):
    """A_f = S - k e_1^T."""
    a = _shift(len(k))
    for row, gain in zip(a, k):
        row[0] -= gain
    return a


def hurwitz_filter_gain(k):
    """`k` itself, if A_f = S - k e_1^T is Hurwitz: its matrix sign is then -I.

    Raises
    ------
    Infeasible
        If it is not.
    """
    sign = _matrix_sign(_filter_matrix(k))
    n = range(len(k))
    if sign is None or any(abs(sign[i][j] + (i == j)) > 1e-6 for i in n for j in n):
        raise Infeasible(
            "A_f = S - k e_1^T is not Hurwitz; valid: the coefficients of a Hurwitz polynomial "
            "s^n + k_1 s^(n-1) + .. + k_n"
        )
    return list(k)


def filter_norm(k):
    """The least gain g for which A_f^T P + P A_f + P^2 / g^2 + I = 0 has a solution P > 0.

    It is the H-infinity norm of (40), and takes the place of r epsilon in (42).
    """
    a = transpose(_filter_matrix(hurwitz_filter_gain(k)))
    one = identity(len(k))

    def feasible(gain):
        return riccati(a, _scaled(one, -_inverse_square(gain)), one) is not None

    # |A_f^-1| is a lower bound of the norm; a thousandth of |k_n|^-1 is below that.
    return [_least(feasible, 1e-3 / max(1.0, abs(k[-1])), width=1e-9)]


def matched_riccati(rho, epsilon, delta, damping, Q, A, B):
    """P of the matched case, row by row; see the remark after (8).

    A^T P + P A - (rho - 1/epsilon^2) P B B^T P + epsilon^2 delta^2 I + Q = 0, without the two
    terms of epsilon for Controller 2.

    Raises
    ------
    Infeasible
        If there is no P > 0.
    ArithmeticError
        If there is one, too large or small to be found.
    """
    lost = _inverse_square(epsilon) if damping else 0.0
    g = _scaled(product(B, transpose(B)), rho - lost)
    margin = (epsilon * delta) * (epsilon * delta) if damping else 0.0
    q = [[value + margin * (i == j) for j, value in enumerate(row)] for i, row in enumerate(Q)]
    p = riccati(transpose(A), g, q)
    if p is None and (rho > lost or lost == float("inf")):
        raise ArithmeticError("the Riccati equation cannot be solved in double precision")
    if p is None:
        raise Infeasible(
            f"(rho = {rho:.6g}, epsilon = {epsilon:.6g}) is infeasible: the Riccati equation has "
            f"no positive definite solution; take rho > 1/epsilon^2 = {lost:.6g}"
        )
    return [value for row in p for value in row]


RULES = {
    "filter_norm": filter_norm,
    "hurwitz_filter_gain": hurwitz_filter_gain,
    "iss_filter_gain": iss_filter_gain,
    "matched_riccati": matched_riccati,
}
