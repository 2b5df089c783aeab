"""Quasi-Newton iteration for a fixed point z = G(z) of a few coupled values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Broyden"]

Floats = npt.NDArray[np.float64]


class Broyden:
    """Broyden's "good" method for z = G(z).

    The Jacobian of G is started as zero, so the first iteration of all is the plain one,
    z <- G(z), and it is kept from one problem to the next: neighbouring problems have nearly the
    same Jacobian (the idea of the multi-vector interface quasi-Newton methods of partitioned
    fluid-structure solvers). An affine problem in n values is solved in at most 2 n iterations,
    contracting or not.

    C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Math. Comp. 19
    (1965), eq. (4.5); D. M. Gay, Some convergence properties of Broyden's method, SIAM J. Numer.
    Anal. 16 (1979).

    Parameters
    ----------
    size : int
        Number of values, n.

    Attributes
    ----------
    J : array, shape (n, n)
        Approximate Jacobian of G. It is replaced, never changed in place, so that a reference
        kept elsewhere stays as it was.
    """

    def __init__(self, size: int) -> None:
        # Here, as it takes a tenth of a second that runs without feedback do not need.
        from scipy.linalg.lapack import dgesv

        self._dgesv = dgesv
        self.J: Floats = np.zeros((size, size))
        self._z: Floats | None = None
        self._r: Floats | None = None

    def restart(self) -> None:
        """Begin a new problem; the Jacobian is kept."""
        self._z = self._r = None

    def rescale(self, ratio: float) -> None:
        """Multiply the Jacobian, where the new problem's is known to be larger by that ratio."""
        self.J = self.J * ratio

    def learn(self, z: Floats, r: Floats) -> None:
        """Take in an iterate z and its residual r = G(z) - z, both of shape (n,)."""
        if self._z is not None and self._r is not None:
            s = z - self._z
            length = s.dot(s)
            if length > 0.0:
                # G moved by s + (r - r_before) while z moved by s.
                missed = s + (r - self._r) - self.J.dot(s)
                self.J = self.J + np.outer(missed, s / length)
        self._z, self._r = z.copy(), r.copy()

    def step(self) -> Floats:
        """The next iterate, shape (n,), from the last one learnt."""
        if self._z is None or self._r is None:
            raise RuntimeError("nothing learnt yet")
        _, _, change, info = self._dgesv(np.eye(len(self._z)) - self.J, self._r)
        # A singular matrix has no quasi-Newton step; the plain one goes on.
        found: Floats = self._z + (change if info == 0 else self._r)
        return found
