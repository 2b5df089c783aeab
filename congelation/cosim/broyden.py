"""Quasi-Newton iteration for a fixed point z = G(z) of a few coupled values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Broyden"]

Floats = npt.NDArray[np.float64]

SMALLEST_DENOMINATOR = 1e-3
"""Below this share of the step's own length an update would blow the matrix up; it is left out."""


class Broyden:
    """Broyden's "good" method for the residual r(z) = G(z) - z.

    The inverse Jacobian is started as that of the plain iteration z <- G(z), so the first
    iteration of all is the plain one, and it is kept from one problem to the next: neighbouring
    problems have nearly the same Jacobian (the idea of the multi-vector interface quasi-Newton
    methods of partitioned fluid-structure solvers). An affine problem in n values is solved in at
    most 2 n iterations, contracting or not.

    C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
    (1965), eq. (4.5); D. M. Gay, Some convergence properties of Broyden's method, SIAM J. Numer.
    Anal. 16 (1979).

    Parameters
    ----------
    size : int
        Number of values, n.

    Attributes
    ----------
    H : array, shape (n, n)
        z <- z + H r; minus the approximate inverse of dr/dz.
    """

    def __init__(self, size: int) -> None:
        self.H: Floats = np.eye(size)
        self._z: Floats | None = None
        self._r: Floats | None = None

    def restart(self) -> None:
        """Begin a new problem; the matrix is kept."""
        self._z = self._r = None

    def forget(self) -> None:
        """Begin a new problem with the plain iteration."""
        self.H = np.eye(self.H.shape[0])
        self.restart()

    def step(self, z: Floats, r: Floats) -> Floats:
        """The next iterate.

        Parameters
        ----------
        z : array, shape (n,)
        r : array, shape (n,)
            Its residual G(z) - z.

        Returns
        -------
        array, shape (n,)
        """
        if self._z is not None and self._r is not None:
            self._update(z - self._z, r - self._r)
        self._z, self._r = z.copy(), r.copy()
        next_z: Floats = z + self.H.dot(r)
        return next_z

    def _update(self, s: Floats, y: Floats) -> None:
        """Sherman-Morrison form of the rank-one update for -H ~ (dr/dz)^-1."""
        h_y = self.H.dot(y)
        denominator = s.dot(h_y)
        if abs(denominator) > SMALLEST_DENOMINATOR * s.dot(s):
            # A new array, so that a copy kept by the caller stays as it was.
            self.H = self.H - np.outer(s + h_y, s.dot(self.H)) / denominator
