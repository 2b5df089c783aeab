"""Input polynomials of a macro step, as matrices.

A link's data over [t, t + h] are the values and derivatives of its output at both ends,
w = (v0, d0, v1, d1), and at a point before. What is needed of them is linear in them, so for all
links at once it is a matrix of a few entries times an array of a few rows and L columns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["differentiation", "hermite", "interpolation", "matched", "product"]

Floats = npt.NDArray[np.float64]


def product(M: Floats, data: Floats) -> Floats:
    """M times data, shapes (m, n) and (n, L), each sum from the left to the right.

    In this order the compiled loop has equal bits, whatever the processor; a library for linear
    algebra has an order of its own on each.
    """
    found: Floats = np.add.reduce(M[:, :, None] * data, axis=1)
    return found


def hermite(h: float) -> Floats:
    """From (v0, d0, v1, d1) to the coefficients of the cubic through them.

    Returns
    -------
    array, shape (4, 4)
        Its product with w is (u, u', u'', u''') at t, so that
        u(t + s) = C0 + C1 s + C2 s^2 / 2 + C3 s^3 / 6.
    """
    a, b = 1.0 / h, 6.0 / (h * h)
    c = 2.0 * a * b
    # fmt: off
    entries = (
        1.0, 0.0, 0.0, 0.0,
        0.0, 1.0, 0.0, 0.0,
        -b, -4.0 * a, b, -2.0 * a,
        c, b, -c, b,
    )
    # fmt: on
    return np.array(entries).reshape(4, 4)


def matched(h: float, g: float) -> Floats:
    """From (v0, d0, v1, d1) and (v, d) at t - g to the coefficients of a cubic that acts like the
    quintic through all six.

    A slave's states at the end of the step are integrals of its input times something smooth. The
    cubic has the quintic's integral, its first moment, and its value and derivative at t + h, so
    it takes the states, and the outputs, to where the quintic would, up to terms of h^7.

    With sigma = s / h and rho = g / h the quintic is the Hermite cubic plus
    sigma^2 (1 - sigma)^2 (alpha + beta sigma), where alpha and beta come from what the cubic
    misses at sigma = -rho. Of the polynomials (1 - sigma)^2 (A + B sigma) the one with the same
    two moments has A = -alpha/15 - 2 beta/35 and B = 2 alpha/3 + 3 beta/7.

    Parameters
    ----------
    h, g : float
        Length of the step, and distance of the point before, in seconds.

    Returns
    -------
    array, shape (4, 6)
        Its product with (v0, d0, v1, d1, v, d) is (u, u', u'', u''') at t.
    """
    r = g / h
    q = 1.0 + r
    # The Hermite basis and its derivatives (with respect to sigma) at -rho.
    missed = np.array(
        [
            [(2.0 * r - 1.0) * q * q, h * r * q * q, -r * r * (3.0 + 2.0 * r), h * r * r * q],
            [-6.0 * r * q, -h * q * (1.0 + 3.0 * r), 6.0 * r * q, -h * r * (2.0 + 3.0 * r)],
        ]
    )
    missed = np.hstack([missed, [[1.0, 0.0], [0.0, h]]])
    # w = sigma^2 (1 - sigma)^2 and w' there: missed = (w, w'; 0, w) (alpha - rho beta, beta).
    w, slope = (r * q) * (r * q), -2.0 * r * q * (1.0 + 2.0 * r)
    beta = (missed[1] - slope / w * missed[0]) / w
    alpha = missed[0] / w + r * beta
    A = -alpha / 15.0 - beta * (2.0 / 35.0)
    B = alpha * (2.0 / 3.0) + beta * (3.0 / 7.0)
    M = np.array([A, (B - 2.0 * A) / h, 2.0 * (A - 2.0 * B) / (h * h), 6.0 * B / (h * h * h)])
    M[:, :4] += hermite(h)
    return M


def interpolation(nodes: Sequence[float], at: float) -> Floats:
    """Value and derivative at one point of the polynomial with given values and derivatives at
    n nodes, of degree 2 n - 1.

    With the Lagrange polynomials l_i of the nodes, the polynomial is the sum over i of
    v_i (1 - 2 l_i'(x_i) (x - x_i)) l_i^2 + d_i (x - x_i) l_i^2.

    Parameters
    ----------
    nodes : sequence of float
        Distinct.
    at : float
        Between the nodes, or beyond them.

    Returns
    -------
    array, shape (2, 2 n)
        Its product with (v_1 .. v_n, d_1 .. d_n) is (value, derivative) at `at`.
    """
    # Lists and one array at the end: single entries of an array cost ten times as much.
    of_values: list[tuple[float, float]] = []
    of_slopes: list[tuple[float, float]] = []
    for x in nodes:
        others = [node for node in nodes if node != x]
        lagrange, slope, own_slope = 1.0, 0.0, 0.0
        for node in others:
            factor = (at - node) / (x - node)
            slope = slope * factor + lagrange / (x - node)
            lagrange *= factor
            own_slope += 1.0 / (x - node)
        square, square_slope = lagrange * lagrange, 2.0 * lagrange * slope
        tilt = 1.0 - 2.0 * own_slope * (at - x)
        of_values.append((tilt * square, tilt * square_slope - 2.0 * own_slope * square))
        of_slopes.append(((at - x) * square, (at - x) * square_slope + square))
    return np.array(of_values + of_slopes).T


def differentiation(nodes: Floats, at: float) -> tuple[Floats, Floats]:
    """Weights of the value and of the derivative at `at` of the polynomial through `nodes`.

    B. Fornberg, Calculation of weights in finite difference formulas, SIAM Review 40 (1998).

    Parameters
    ----------
    nodes : array, shape (n,)
        Distinct.

    Returns
    -------
    value, derivative : arrays, shape (n,)
    """
    n = len(nodes)
    weights = np.zeros((2, n))
    weights[0, 0] = 1.0
    product, distance = 1.0, nodes[0] - at
    for i in range(1, n):
        previous, distance = distance, nodes[i] - at
        partial = 1.0
        for j in range(i):
            gap = nodes[i] - nodes[j]
            partial *= gap
            if j == i - 1:
                weights[1, i] = product * (weights[0, j] - previous * weights[1, j]) / partial
                weights[0, i] = -product * previous * weights[0, j] / partial
            weights[1, j] = (distance * weights[1, j] - weights[0, j]) / gap
            weights[0, j] = distance * weights[0, j] / gap
        product = partial
    return weights[0], weights[1]
