"""Gains that follow from parameters by a Riccati equation, solved when the FMU is initialised.

The equation is a^T P + P a - P g P + c = 0, its solution is first found by the matrix sign function
of its Hamiltonian: J. D. Roberts, Linear model reduction and solution of the algebraic Riccati
equation by use of the sign function, Int. J. Control 32 (1980) 677-687, with the determinant
scaling of R. Byers, Linear Algebra Appl. 85 (1987) 267-279. Newton's method (D. L. Kleinman, IEEE
Trans. Automat. Contr. 13 (1968) 114-115) makes it exact but for one rounding, as its residual is
computed in fractions. So these are the numbers that `congelation.theory.gains` finds, and on every
machine the same.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor, fsum, log10

from .linear_algebra import (
    definite_inverse,
    determinant,
    exact,
    identity,
    inverse,
    is_definite,
    largest,
    product,
    rounded,
    scaled,
    transpose,
)

__all__ = ["RULES", "Infeasible", "smallest_feasible_r"]

MOST_ITERATIONS = 100
# The iteration for the sign converges quadratically; past this relative change nothing is gained.
CONVERGED = 1e-14
# Largest last step of Newton's method relative to P, in floats and in fractions; the error that
# remains is smaller, as the steps shrink quadratically.
ROUGH, FINE = 2.0**-20, 2.0**-80
# Relative width at which the bisection for a smallest feasible number stops.
WIDTH = 5e-10
# The spacing of the numbers in double precision, relative to them.
ROUNDING = 2.0**-52
# Beyond it the squares in the equations exhaust double precision.
LARGEST_FEASIBLE = 1e12


class Infeasible(ValueError):
    """The gains asked for do not exist; the text names the nearest ones that do."""


def riccati(a, g, c):
    """The P = P^T, in fractions, of the equation above with a - g P Hurwitz, or None.

    None where the Hamiltonian has eigenvalues on the imaginary axis: there is no such P.
    """
    n = range(len(a))
    at = transpose(a)
    hamiltonian = [
        *([*a[i], *(-value for value in g[i])] for i in n),
        *([*(-value for value in c[i]), *(-value for value in at[i])] for i in n),
    ]
    sign = _matrix_sign(hamiltonian)
    p = None if sign is None else _stable_subspace(sign, len(a))
    p = None if p is None else newton(p, a, g, c)
    return None if p is None else newton(exact(p), a, g, c)


def newton(p, a, g, c):
    """As `riccati`, from a p with a - g p Hurwitz, in the arithmetic of p: floats or fractions.

    If g >= 0 and a stabilising solution exists, every such p leads to it: all steps stabilise, and
    from the first one on they fall towards the solution. So None means that there is none.
    """
    n = range(len(a))
    rational = isinstance(p[0][0], Fraction)
    convert, tolerance = (exact, FINE) if rational else (rounded, ROUGH)
    drift, quadratic = rounded(a), rounded(g)
    a, g, c = convert(a), convert(g), convert(c)
    for _ in range(MOST_ITERATIONS):
        taken = product(quadratic, rounded(p))
        closed = [[drift[i][j] - taken[i][j] for j in n] for i in n]
        if not _is_hurwitz(closed):
            return None
        half, lost = product(p, a), product(product(p, g), p)
        residual = [[half[i][j] + half[j][i] - lost[i][j] + c[i][j] for j in n] for i in n]
        step = _lyapunov(closed, rounded(residual))
        if step is None:
            return None
        correction = convert(step)
        p = [[p[i][j] + correction[i][j] for j in n] for i in n]
        if largest(step) <= tolerance * largest(rounded(p)):
            return p
    return None


def _lyapunov(a, q):
    """d = d^T with a^T d + d a + q = 0, or None where a is too near to the edge of Hurwitz.

    Its upper triangle is what the linear equations are in, one for each element of q's.
    """
    n = range(len(a))
    place = {}
    for i in n:
        for j in range(i, len(a)):
            place[i, j] = place[j, i] = len(set(place.values()))
    pairs = [(i, j) for i, j in place if i <= j]
    matrix = [[0.0] * len(pairs) for _ in pairs]
    for i, j in pairs:
        row = matrix[place[i, j]]
        for k in n:
            row[place[k, j]] += a[k][i]
            row[place[i, k]] += a[k][j]
    try:
        solved = product(inverse(matrix), [[-0.5 * (q[i][j] + q[j][i])] for i, j in pairs])
    except ZeroDivisionError:
        return None
    return [[solved[place[i, j]][0] for j in n] for i in n]


def _is_hurwitz(a):
    """Whether all eigenvalues of a are in the open left half-plane: its matrix sign is then -I."""
    sign = _matrix_sign(a)
    n = range(len(a))
    return sign is not None and all(abs(sign[i][j] + (i == j)) <= 1e-6 for i in n for j in n)


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
        change = fsum([abs(x - y) for r, s in zip(new, a) for x, y in zip(r, s)])
        magnitude = fsum([abs(x) for r in new for x in r])
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


def _shift(n):
    """The n x n upper shift matrix S of (27)."""
    return [[1.0 if j == i + 1 else 0.0 for j in range(n)] for i in range(n)]


def _inverse_square(value):
    """1 / value^2, infinite or 0 where a power would raise an error."""
    return (1.0 / value) * (1.0 / value)


def _filter_weight(n, epsilon):
    """Q = I / epsilon^2, and P = X^-1 of (43) for r = infinity, from which Newton's method starts.

    Raises
    ------
    ArithmeticError
        If double precision does not suffice for P.
    """
    weight = scaled(identity(n), 1.0 / (epsilon * epsilon))
    observed = [[1.0 if i == j == 0 else 0.0 for j in range(n)] for i in range(n)]
    p = riccati(scaled(_shift(n), -1.0), weight, observed)
    if p is None:
        raise ArithmeticError("the Riccati equation (43) cannot be solved in double precision")
    return weight, p


def _inverse_solution(r, weight, start, arithmetics):
    """P = X^-1 of (43), definite or not, in the last of the arithmetics; None if there is none.

    P S + S^T P + P Q P - e_1 e_1^T + I / r^2 = 0, from a solution for a larger r.
    """
    # Element (1, 1) of it is P_1 Q P_1^T = 1 - 1 / r^2, with P_1 the first row.
    if r <= 1.0:
        return None
    n = range(len(weight))
    lost = 1 / Fraction(r) ** 2
    c = [[(i == 0) - lost if i == j else Fraction(0) for j in n] for i in n]
    p = start
    for convert in arithmetics:
        p = newton(convert(p), scaled(_shift(len(weight)), -1.0), weight, c)
        if p is None:
            return None
    return p


def _solution(p):
    """X = P^-1 in floats, or None where rounding may take its definiteness (or P is not definite).

    Functions that work on X in floats need it to be further than their rounding from singular.
    """
    x = definite_inverse(p)
    if x is None:
        return None
    x = rounded(x)
    margin = Fraction(len(x) * ROUNDING * largest(x))
    kept = [[Fraction(v) - margin * (i == j) for j, v in enumerate(row)] for i, row in enumerate(x)]
    return x if is_definite(kept) else None


def iss_filter_gain(r, epsilon, n):
    """k = X e_1 / 2 of the ISS K-filter (Theorem 1), X > 0 solving (43).

    Raises
    ------
    Infeasible
        If (43) has no positive definite solution; the text names the smallest feasible r.
    ArithmeticError
        If there is one, but double precision cannot hold it.
    """
    weight, start = _filter_weight(n, epsilon)
    p = _inverse_solution(r, weight, start, (rounded, exact))
    if p is None or not is_definite(p):
        raise Infeasible(
            f"(r = {r:.6g}, epsilon = {epsilon:.6g}) is infeasible: (43) has no positive definite "
            f"solution; the smallest feasible r is {_rounded_up(smallest_feasible_r(n, epsilon))}"
        )
    x = _solution(p)
    if x is None:
        raise ArithmeticError("the solution of (43) is too near to a singular matrix")
    return [0.5 * row[0] for row in x]


def smallest_feasible_r(n, epsilon):
    """The least r for which (43) has a solution X > 0: above the infimum by at most `WIDTH` of it.

    Where double precision cannot hold X there, it is above by the least power of two times `WIDTH`
    at which it can.

    Raises
    ------
    ArithmeticError
        If no r up to `LARGEST_FEASIBLE` is feasible in double precision.
    """
    weight, start = _filter_weight(n, epsilon)

    def feasible_in_floats(r):
        p = _inverse_solution(r, weight, start, (rounded,))
        return p is not None and is_definite(exact(p))

    def feasible(r):
        p = _inverse_solution(r, weight, start, (rounded, exact))
        return p is not None and is_definite(p)

    # Floats decide fast and, as P is regular at the edge, mostly well; fractions judge the outcome.
    edge = _least(feasible_in_floats, 1.0, WIDTH / 8)
    low, r = edge * (1 - WIDTH / 2), edge * (1 + WIDTH / 4)
    if feasible(low) or not feasible(r):
        r = _least(feasible, 1.0)
    least, margin = r, WIDTH
    while r <= LARGEST_FEASIBLE:
        p = _inverse_solution(r, weight, start, (rounded, exact))
        if p is not None and _solution(p) is not None:
            return r
        r, margin = least * (1 + margin), 2 * margin
    raise _out_of_reach()


def _least(feasible, infeasible, width=WIDTH):
    """The least number that is feasible, to a relative width, above one that is not."""
    low, high = infeasible, 2.0 * infeasible
    while not feasible(high):
        low, high = high, 2.0 * high
        if high > LARGEST_FEASIBLE:
            raise _out_of_reach()
    while high - low > width * low:
        middle = 0.5 * (low + high)
        if feasible(middle):
            high = middle
        else:
            low = middle
    return high


def _out_of_reach():
    return ArithmeticError(
        f"up to {LARGEST_FEASIBLE:.0e} nothing solves the Riccati equation in double precision"
    )


def _rounded_up(value, digits=6):
    step = 10.0 ** (floor(log10(value)) + 1 - digits)
    return f"{ceil(value / step) * step:.{digits}g}"


def _filter_matrix(k):
    """A_f = S - k e_1^T."""
    a = _shift(len(k))
    for row, gain in zip(a, k):
        row[0] -= gain
    return a


def hurwitz_filter_gain(k):
    """`k` itself, if A_f = S - k e_1^T is Hurwitz.

    Raises
    ------
    Infeasible
        If it is not.
    """
    if not _is_hurwitz(_filter_matrix(k)):
        raise Infeasible(
            "A_f = S - k e_1^T is not Hurwitz; valid: the coefficients of a Hurwitz polynomial "
            "s^n + k_1 s^(n-1) + .. + k_n"
        )
    return list(k)


def filter_norm(k):
    """The least gain g for which A_f^T P + P A_f + P^2 / g^2 + I = 0 has a solution P > 0.

    It is the H-infinity norm of (40), and takes the place of r epsilon in (42).
    """
    a = _filter_matrix(hurwitz_filter_gain(k))
    one = identity(len(k))

    def feasible(gain):
        # -P is a stabilising solution in the form with a definite quadratic term, and A_f is
        # Hurwitz, so that Newton's method may start at 0. Next to the edge, where eigenvalues of
        # the Hamiltonian meet on the imaginary axis, it decides where the matrix sign cannot.
        equation = (a, scaled(one, _inverse_square(gain)), scaled(one, -1.0))
        p = newton(scaled(one, 0.0), *equation)
        p = None if p is None else newton(exact(p), *equation)
        return p is not None and is_definite(scaled(p, -1))

    # The norm of the response at frequency 0, (-A_f)^-1, bounds the gain from below, and its
    # largest element bounds that; half of it is below whatever rounding makes of it.
    return [_least(feasible, 0.5 * largest(inverse(a)))]


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
    g = scaled(product(B, transpose(B)), rho - lost)
    margin = (epsilon * delta) * (epsilon * delta) if damping else 0.0
    q = [[value + margin * (i == j) for j, value in enumerate(row)] for i, row in enumerate(Q)]
    p = riccati(A, g, q)
    if p is not None and not is_definite(p):
        p = None
    if p is None and (rho > lost or lost == float("inf")):
        raise ArithmeticError("the Riccati equation cannot be solved in double precision")
    if p is None:
        raise Infeasible(
            f"(rho = {rho:.6g}, epsilon = {epsilon:.6g}) is infeasible: the Riccati equation has "
            f"no positive definite solution; take rho > 1/epsilon^2 = {lost:.6g}"
        )
    return [float(value) for row in p for value in row]


RULES = {
    "filter_norm": filter_norm,
    "hurwitz_filter_gain": hurwitz_filter_gain,
    "iss_filter_gain": iss_filter_gain,
    "matched_riccati": matched_riccati,
}
