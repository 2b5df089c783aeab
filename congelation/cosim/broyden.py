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

from functools import cache
from typing import Any

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
    length = dz.dot(dz)
    if length == 0.0:
        return J
    # G moved by dz + dr while z moved by dz.
    missed = dz + dr - J.dot(dz)
    return J + np.outer(missed, dz / length)


def broyden_step(J: Floats, r: Floats) -> Floats:
    """From an iterate to the next one, shape (n,): (I - J)^-1 r, with r = G(z) - z."""
    _, _, change, info = _dgesv()(np.eye(len(r)) - J, r)
    # A singular matrix has no quasi-Newton step; the plain one goes on.
    found: Floats = change if info == 0 else r
    return found


@cache
def _dgesv() -> Any:
    """LAPACK's solver, which has a fifth of the overhead of numpy.linalg.solve."""
    # Imported where it is needed: it takes a tenth of a second, which runs without feedback save.
    from scipy.linalg.lapack import dgesv

    return dgesv
