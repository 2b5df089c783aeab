"""The K-filter (28)-(35), Kreisselmeier's re-parametrisation of the plant (27).

With constant theta the state is x = xi + Omega^T theta + x_tilde, x_tilde' = A_f x_tilde; with
congealed parameters ell in the place of theta, x_tilde obeys (40).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from congelation.theory.gains import placed_filter_gain
from congelation.theory.iss_riccati import iss_weight, smallest_feasible_r
from congelation.theory.model import Domain, Gain, Parameter, Variables, scalar, vector
from congelation.theory.observer_form import checked_orders

__all__ = [
    "FilterDesign",
    "FilterFactory",
    "KFilter",
    "iss_filter",
    "standard_filter",
    "varying_b_filter",
]


@dataclass(frozen=True)
class FilterDesign:
    """Where the injection gain k comes from, and how much of Delta the filter lets through.

    Attributes
    ----------
    k : Variables, shape (n, 1)
        The injection gain, a `Gain` of the controller.
    disturbance_gain : casadi.SX, (1, 1)
        g such that V_xtilde' <= -|x_tilde|^2 + g^2 |F^T Delta|^2: r epsilon in (42).
    parameters, gains
        What the controller has to hold for them.
    """

    k: Variables
    disturbance_gain: ca.SX
    parameters: tuple[Parameter, ...]
    gains: tuple[Gain, ...]


FilterFactory = Callable[[int], FilterDesign]
"""Makes the design of a filter of order n."""


@functools.cache
def _moderate_r(n: int, epsilon_b: float, rho: int) -> float:
    """Twice the smallest feasible r for epsilon_a = 1, rounded up: a filter of moderate gain."""
    return float(math.ceil(2 * smallest_feasible_r(n, iss_weight(n, 1.0, epsilon_b, rho))))


def iss_filter(n: int) -> FilterDesign:
    """The ISS K-filter of Theorem 1, b constant: k = X e_1 / 2, X from (43), Q = I/epsilon^2."""
    k = vector("k", n, "Injection gain k = X e_1 / 2 of Theorem 1")
    r = scalar("r", "Gain bound r of the ISS K-filter, (42)")
    epsilon = scalar("epsilon", "Weight in Young's inequality, (41)")
    return FilterDesign(
        k,
        disturbance_gain=r.symbol * epsilon.symbol,
        parameters=(
            Parameter(r, (_moderate_r(n, math.inf, n),), Domain.POSITIVE),
            Parameter(epsilon, (1.0,), Domain.POSITIVE),
        ),
        gains=(Gain(k, "iss_filter_gain", ("r", "epsilon"), {"n": n}),),
    )


def varying_b_filter(rho: int) -> FilterFactory:
    """The ISS K-filter of Theorem 1 for time-varying b: the Q printed with (41).

    (42) then holds for a(t) and b(t) both; Proposition 2, and so the certificate, wants b constant.

    Parameters
    ----------
    rho : int
        Relative degree of the plant.
    """

    def varying_b(n: int) -> FilterDesign:
        k = vector("k", n, "Injection gain k = X e_1 / 2 of Theorem 1")
        r = scalar("r", "Gain bound r of the ISS K-filter, (42)")
        epsilon_a = scalar("epsilon_a", "Weight in Young's inequality for a(t), (41)")
        epsilon_b = scalar("epsilon_b", "Weight in Young's inequality for b(t), (41)")
        names = ("r", "epsilon_a", "epsilon_b")
        return FilterDesign(
            k,
            disturbance_gain=r.symbol * epsilon_a.symbol,
            parameters=(
                Parameter(r, (_moderate_r(n, 1.0, rho),), Domain.POSITIVE),
                Parameter(epsilon_a, (1.0,), Domain.POSITIVE),
                Parameter(epsilon_b, (1.0,), Domain.POSITIVE),
            ),
            gains=(Gain(k, "iss_filter_gain_varying_b", names, {"n": n, "rho": rho}),),
        )

    return varying_b


def standard_filter(n: int) -> FilterDesign:
    """The K-filter of [18] with any Hurwitz A_f; by default all its poles are at -1.

    Its gain from F^T Delta to x_tilde is the H-infinity norm of (40), so the corrected damping
    holds for it as for the ISS filter.
    """
    k = vector("k", n, "Injection gain of the K-filter (28)-(29)")
    chosen = vector("k_filter", n, "Coefficients k_1 .. k_n of det(s I - A_f)")
    gain = scalar("filter_gain", "H-infinity norm of (40), in the place of r epsilon in (42)")
    return FilterDesign(
        k,
        disturbance_gain=gain.symbol,
        parameters=(Parameter(chosen, tuple(placed_filter_gain([-1.0] * n).tolist())),),
        gains=(
            Gain(k, "hurwitz_filter_gain", ("k_filter",)),
            Gain(gain, "filter_norm", ("k_filter",)),
        ),
    )


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
