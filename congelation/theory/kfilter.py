"""The K-filter (28)-(35), Kreisselmeier's re-parametrisation of the plant (27).

With constant theta the state is x = xi + Omega^T theta + x_tilde, x_tilde' = A_f x_tilde; with
congealed parameters ell in the place of theta, x_tilde obeys (40).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from congelation.theory.model import Variables
from congelation.theory.observer_form import checked_orders

__all__ = ["KFilter"]


@dataclass(frozen=True)
class KFilter:
    """The filter states as symbols, and what is made of them.

    Parameters
    ----------
    m : int
        Degree of the numerator of the plant.
    eta, lambda_, k : Variables, shape (n, 1)
        The states of (28) and (29), and the vector of injection gains in A_f = S - k e_1^T.
    """

    m: int
    eta: Variables
    lambda_: Variables
    k: Variables

    @property
    def n(self) -> int:
        """Order of the plant and of each half of the filter."""
        return int(self.eta.symbol.numel())

    @property
    def rho(self) -> int:
        """Relative degree n - m."""
        return checked_orders(self.n, self.m)

    def eta_rate(self, y: ca.SX) -> ca.SX:
        """eta' = A_f eta + e_n y, (28)."""
        return self._driven(self.eta.symbol, y)

    def lambda_rate(self, u: ca.SX) -> ca.SX:
        """lambda' = A_f lambda + e_n u, (29)."""
        return self._driven(self.lambda_.symbol, u)

    @property
    def xi(self) -> ca.SX:
        """xi = -A_f^n eta, which satisfies (34). (30) is printed as a differential equation."""
        return -self._powers(self.eta.symbol, self.n)[-1]

    @property
    def v(self) -> tuple[ca.SX, ...]:
        """v_0 .. v_m of (32), v_i = A_f^i lambda, each of shape (n, 1)."""
        return tuple(self._powers(self.lambda_.symbol, self.m))

    @property
    def Xi(self) -> ca.SX:
        """Xi = -[A_f^{n-1} eta, .., eta] of (33), shape (n, n)."""
        return -ca.horzcat(*reversed(self._powers(self.eta.symbol, self.n - 1)))

    @property
    def Omega_T(self) -> ca.SX:
        """Omega^T = [v_m .. v_0, Xi] of (31), shape (n, m + 1 + n)."""
        return ca.horzcat(*reversed(self.v), self.Xi)

    def omega(self, y: ca.SX) -> ca.SX:
        """omega = [v_{m,2} .. v_{0,2}, Xi_(2) - y e_1^T]^T, shape (m + 1 + n, 1).

        y' = xi_2 + omega^T theta + x_tilde_2 for constant theta; a second row is 0 where n = 1.
        """
        row = second_row(self.Omega_T)
        row[self.m + 1] -= y
        return row.T

    def _times_A_f(self, vector: ca.SX) -> ca.SX:
        """A_f vector, written out: A_f is a shift and one column."""
        return ca.vertcat(vector[1:, :], 0) - self.k.symbol * vector[0]

    def _driven(self, state: ca.SX, entry: ca.SX) -> ca.SX:
        rate = self._times_A_f(state)
        rate[-1] += entry
        return rate

    def _powers(self, vector: ca.SX, highest: int) -> list[ca.SX]:
        """[vector, A_f vector, .., A_f^highest vector]."""
        powers = [vector]
        for _ in range(highest):
            powers.append(self._times_A_f(powers[-1]))
        return powers


def second_row(array: ca.SX) -> ca.SX:
    """Row 2 of an array with n rows, which is 0 where n = 1 (x_2 = 0 in (27))."""
    return array[1, :] if array.shape[0] > 1 else ca.SX.zeros(1, array.shape[1])
