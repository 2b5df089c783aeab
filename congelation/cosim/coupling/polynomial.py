"""Input polynomials of a macro step, as matrices.

A link's data over [t, t + h] are the values and derivatives of its output at both ends,
w = (v0, d0, v1, d1). What is needed of them is linear in w, so for all links at once it is a
matrix of a few entries times an array of shape (4, L).
"""

from __future__ import annotations

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
    a, b = 1.0 / h, 1.0 / (h * h)
    return np.array(
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [-6.0 * b, -4.0 * a, 6.0 * b, -2.0 * a],
            [12.0 * a * b, 6.0 * b, -12.0 * a * b, 6.0 * b],
        ]
    )


def extrapolation(h: float, ahead: float) -> Floats:
    """From (v0, d0, v1, d1) on [t, t + h] to value and derivative of their cubic at
    t + h + ahead.

    Returns
    -------
    array, shape (2, 4)
    """
    s = h + ahead
    taylor = np.array([[1.0, s, s**2 / 2.0, s**3 / 6.0], [0.0, 1.0, s, s**2 / 2.0]])
    return taylor @ hermite(h)
