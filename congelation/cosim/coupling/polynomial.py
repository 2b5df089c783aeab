"""Input polynomials of a macro step, as matrices.

A link's data over [t, t + h] are the values and derivatives of its output at both ends,
w = (v0, d0, v1, d1). What is needed of them is linear in w, so for all links at once it is a
matrix of a few entries times an array of shape (4, L).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["extrapolation", "hermite"]

Floats = npt.NDArray[np.float64]


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


def extrapolation(nodes: Sequence[float], at: float) -> Floats:
    """Value and derivative at one point of the polynomial with given values and derivatives at
    n nodes, of degree 2 n - 1.

    With the Lagrange polynomials l_i of the nodes, the polynomial is the sum over i of
    v_i (1 - 2 l_i'(x_i) (x - x_i)) l_i^2 + d_i (x - x_i) l_i^2.

    Parameters
    ----------
    nodes : sequence of float
        Distinct.

    Returns
    -------
    array, shape (2, 2 n)
        Its product with (v_1 .. v_n, d_1 .. d_n) is (value, derivative) at `at`.
    """
    n = len(nodes)
    weights = np.empty((2, 2 * n))
    for i, x in enumerate(nodes):
        others = [node for node in nodes if node != x]
        lagrange, slope, own_slope = 1.0, 0.0, 0.0
        for node in others:
            factor = (at - node) / (x - node)
            slope = slope * factor + lagrange / (x - node)
            lagrange *= factor
            own_slope += 1.0 / (x - node)
        square, square_slope = lagrange**2, 2.0 * lagrange * slope
        tilt = 1.0 - 2.0 * own_slope * (at - x)
        weights[:, i] = tilt * square, tilt * square_slope - 2.0 * own_slope * square
        weights[:, n + i] = (at - x) * square, (at - x) * square_slope + square
    return weights
