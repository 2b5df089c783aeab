"""How the estimates move: theta_hat' = Gamma chi(theta_hat, tau).

The paper's law is the plain gradient chi = tau. A modification of it cannot be put on at the end
of a recursion: every virtual control cancels the part of theta_hat' known at its step, so a law
is asked three things by each step i, whose regressor is w_i and whose error is z_i:

- `regressor`: what enters the tuning function, tau_i = tau_{i-1} + regressor(w_i, z_i) z_i;
- `rate`: chi(theta_hat, tau_i), which takes the place of tau_i in alpha_i;
- `slope`: (chi(theta_hat, tau_i) - chi(theta_hat, tau_{i-1})) / z_i in closed form, which takes
  the place of w_i in the correction terms (17) and (56).

With these three the cross terms telescope for any chi, because
chi(tau_n) - chi(tau_i) = sum_{j>i} slope_j z_j, and the Lyapunov function obeys
V' = (V' of the gradient law) + (ell - theta_hat)^T (tau_n - chi(theta_hat, tau_n)).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from congelation.theory.model import Parameter, Variables

__all__ = ["Adaptation", "AdaptationFactory", "Gradient", "gradient"]


class Adaptation(ABC):
    """The interface that the recursions of Secs. III and IV ask."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """What the user may set, each with its neutral default."""

    @abstractmethod
    def regressor(self, w: ca.SX, z: ca.SX) -> ca.SX:
        """What multiplies z in the tuning function where the regressor of the error z is w."""

    @abstractmethod
    def rate(self, tau: ca.SX) -> ca.SX:
        """chi(theta_hat, tau)."""

    @abstractmethod
    def slope(self, before: ca.SX, after: ca.SX, w: ca.SX) -> ca.SX:
        """(chi(theta_hat, after) - chi(theta_hat, before)) / z, where after = before + w z."""


AdaptationFactory = Callable[[Variables, ca.SX, int], Adaptation]
"""Makes a law from the estimates, their gain matrix, and how often the law is differentiated."""


@dataclass(frozen=True)
class Gradient(Adaptation):
    """theta_hat' = Gamma tau, the law of (19) and (55)."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return ()

    def regressor(self, w: ca.SX, z: ca.SX) -> ca.SX:
        return w

    def rate(self, tau: ca.SX) -> ca.SX:
        return tau

    def slope(self, before: ca.SX, after: ca.SX, w: ca.SX) -> ca.SX:
        return w


def gradient(theta_hat: Variables, Gamma: ca.SX, order: int) -> Gradient:
    """The paper's law (19), (55), which needs none of its arguments."""
    return Gradient()
