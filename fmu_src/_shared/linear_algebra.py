"""Small dense matrices as lists of rows: what the Riccati equations need, without numpy.

Sums of floats are those of `math.fsum`, which are the same in all versions of Python.
"""

from __future__ import annotations

from fractions import Fraction
from math import fsum, sqrt

__all__ = [
    "cholesky",
    "definite_inverse",
    "determinant",
    "exact",
    "identity",
    "inverse",
    "is_definite",
    "largest",
    "product",
    "rounded",
    "scaled",
    "transpose",
]


def identity(n):
    """The n x n identity matrix."""
    return [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]


def transpose(a):
    """The transpose of a."""
    return [list(column) for column in zip(*a)]


def product(a, b):
    """The matrix product a b, both of floats or both of fractions."""
    columns = transpose(b)
    add = sum if isinstance(a[0][0], Fraction) else fsum
    return [[add([x * y for x, y in zip(row, column)]) for column in columns] for row in a]


def scaled(a, factor):
    """The matrix ``factor a``."""
    return [[factor * value for value in row] for row in a]


def largest(a):
    """The largest magnitude of an element of a."""
    return max(abs(value) for row in a for value in row)


def exact(a):
    """a in fractions."""
    return [[Fraction(value) for value in row] for row in a]


def rounded(a):
    """a in floats."""
    return [[float(value) for value in row] for row in a]


def is_definite(a):
    """Whether a = a^T, of fractions, is positive definite: all pivots are positive."""
    rest = a
    while rest:
        head, *rows = rest
        if not head[0] > 0:
            return False
        factors = [row[0] / head[0] for row in rows]
        rest = [
            [x - factor * y for x, y in zip(row[1:], head[1:])]
            for factor, row in zip(factors, rows)
        ]
    return True


def definite_inverse(a):
    """The inverse of a = a^T, of fractions, or None where a is not positive definite."""
    n = len(a)
    rows = [row + unit for row, unit in zip(a, exact(identity(n)))]
    for i in range(n):
        head = rows[i][i]
        if not head > 0:
            return None
        rows[i] = [x / head for x in rows[i]]
        for j in range(n):
            if j != i:
                factor = rows[j][i]
                rows[j] = [x - factor * y for x, y in zip(rows[j], rows[i])]
    return [row[n:] for row in rows]


def inverse(a):
    """The inverse of a, by Gauss-Jordan elimination with partial pivoting.

    Raises
    ------
    ZeroDivisionError
        If a is singular.
    """
    return _eliminate(a)[0]


def determinant(a):
    """The determinant of a (0 for a singular matrix)."""
    try:
        return _eliminate(a)[1]
    except ZeroDivisionError:
        return 0.0


def _eliminate(a):
    n = len(a)
    rows = [list(map(float, row)) + unit for row, unit in zip(a, identity(n))]
    value = 1.0
    for i in range(n):
        pivot = max(range(i, n), key=lambda r: abs(rows[r][i]))
        if pivot != i:
            rows[i], rows[pivot] = rows[pivot], rows[i]
            value = -value
        head = rows[i][i]
        value *= head
        rows[i] = [x / head for x in rows[i]]
        for r in range(n):
            factor = rows[r][i]
            if r != i and factor != 0.0:
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i])]
    return [row[n:] for row in rows], value


def cholesky(a):
    """The lower triangular L with L L^T = a, or None where a is not positive definite."""
    n = len(a)
    lower = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            rest = a[i][j] - fsum([lower[i][k] * lower[j][k] for k in range(j)])
            if i == j:
                if not rest > 0.0:
                    return None
                lower[i][i] = sqrt(rest)
            else:
                lower[i][j] = rest / lower[j][j]
    return lower
