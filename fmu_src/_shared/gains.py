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


def _filter_solution(n, r, epsilon):
    """X of (43) with Q = I / epsilon^2, or None."""
    shift = [[1.0 if j == i + 1 else 0.0 for j in range(n)] for i in range(n)]
    g = [[(i == j) * ((i == 0) - 1.0 / r**2) for j in range(n)] for i in range(n)]
    q = [[value / epsilon**2 for value in row] for row in identity(n)]
    return riccati(shift, g, q)


def iss_filter_gain(r, epsilon, n):
    """k = X e_1 / 2 of the ISS K-filter (Theorem 1), X > 0 solving (43).

    Raises
    ------
    Infeasible
        If (43) has no positive definite solution; the text names the smallest feasible r.
    """
    x = _filter_solution(n, r, epsilon)
    if x is None:
        raise Infeasible(
            f"(r = {r:.6g}, epsilon = {epsilon:.6g}) is infeasible: (43) has no positive definite "
            f"solution; the smallest feasible r is about {_smallest_r(n, r, epsilon):.4g}"
        )
    return [0.5 * row[0] for row in x]


def _smallest_r(n, r, epsilon):
    """The smallest feasible r to four digits; r itself is known to be infeasible."""
    low, high = r, 2.0 * r
    while _filter_solution(n, high, epsilon) is None:
        low, high = high, 2.0 * high
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        if _filter_solution(n, middle, epsilon) is None:
            low = middle
        else:
            high = middle
    return high


RULES = {"iss_filter_gain": iss_filter_gain}
