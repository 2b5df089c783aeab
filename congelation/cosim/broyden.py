"""Quasi-Newton steps towards a fixed point z = G(z) of a few coupled values.

Broyden's "good" method. The Jacobian J of G starts as zero, so the first step of all is the plain
one, z <- G(z), and it is carried over from one problem to the next, as neighbouring problems have
nearly the same Jacobian (the idea of the multi-vector interface quasi-Newton methods of
partitioned fluid-structure solvers). An affine problem in n values is solved in at most 2 n steps,
contracting or not.

C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
(1965), eq. (4.5); D. M. Gay, Some convergence properties of Broyden's method, SIAM J. Numer. Anal.
16 (1979).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["broyden_step", "learnt"]

Floats = npt.NDArray[np.float64]


def learnt(J: Floats, dz: Floats, dr: Floats) -> Floats:
    """The Jacobian after two iterates have been seen.

    Parameters
    ----------
    J : array, shape (n, n)
        It is not changed.
    dz, dr : arrays, shape (n,)
        Differences of the two iterates z, and of their residuals r = G(z) - z.
    """
    length = np.cumsum(dz * dz)[-1]
    if length == 0.0:
        return J
    # G moved by dz + dr while z moved by dz.
    missed = dz + dr - np.cumsum(J * dz, axis=1)[:, -1]
    return J + np.outer(missed, dz / length)


def broyden_step(J: Floats, r: Floats) -> Floats:
    """From an iterate to the next one, shape (n,): (I - J)^-1 r, with r = G(z) - z.

    By elimination with pivots in a stated order, which the compiled loop has as well. Where I - J
    is singular there is no quasi-Newton step, and the plain one goes on: r.
    """
    A = (np.eye(len(r)) - J).tolist()
    x: list[float] = r.tolist()
    n = len(x)
    for c in range(n):
        pivot = max(range(c, n), key=lambda i: abs(A[i][c]))
        if A[pivot][c] == 0.0:
            return r
        A[c], A[pivot] = A[pivot], A[c]
        x[c], x[pivot] = x[pivot], x[c]
        for i in range(c + 1, n):
            factor = A[i][c] / A[c][c]
            for j in range(c, n):
                A[i][j] -= factor * A[c][j]
            x[i] -= factor * x[c]
    for i in reversed(range(n)):
        for j in range(i + 1, n):
            x[i] -= A[i][j] * x[j]
        x[i] /= A[i][i]
    return np.array(x)
