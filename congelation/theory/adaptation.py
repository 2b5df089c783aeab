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

    V' = (V' of the gradient law) + (ell - theta_hat)^T (W z - chi(theta_hat, tau_n)),

where tau_n = W z for every law but the dead zone. What is left of the certificate under a law is
its `Claim`.

The recursion differentiates chi, so the classical laws appear here in sufficiently smooth forms.

References
----------
.. [3] P. A. Ioannou and J. Sun, *Robust Adaptive Control*, Prentice Hall, 1996, Secs. 8.4, 8.5:
   fixed and switching sigma-modification, dead zone, projection.
.. [7] R. H. Middleton and G. C. Goodwin, "Adaptive control of time-varying linear systems",
   IEEE Trans. Automat. Contr. 33(2), 1988: projection for time-varying parameters.
.. [8] G. C. Goodwin and D. Q. Mayne, "A parameter estimation perspective of continuous time model
   reference adaptive control", Automatica 23(1), 1987: projection operations.
.. [9] K. Tsakalis and P. A. Ioannou, "Adaptive control of linear time-varying plants", Automatica
   23(4), 1987: switching sigma-modification for time-varying parameters.
.. [G] F. Giri, A. Rabeh and F. Ikhouane, "Backstepping adaptive control of time-varying plants",
   Syst. Control Lett. 36, 1999, pp. 245-252: switching sigma-modification in backstepping.
.. [C] Z. Cai, M. S. de Queiroz and D. M. Dawson, "A sufficiently smooth projection operator",
   IEEE Trans. Automat. Contr. 51(1), 2006, pp. 135-139.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.theory.model import Domain, Parameter, Variables, scalar, vector

__all__ = [
    "NEUTRAL",
    "Adaptation",
    "AdaptationFactory",
    "Claim",
    "Gradient",
    "Joint",
    "Robust",
    "claim_of",
    "gradient",
    "robust",
]

NEUTRAL = MappingProxyType(
    {"adapt": 1.0, "sigma": 0.0, "projection_ball": 0.0, "projection_box": 0.0, "dead_zone": 0.0}
)
"""With these settings `robust` is `gradient`, whatever its other parameters are."""

PROJECTION_SMOOTHING = 1e-3
"""nu in s(a) = (a + sqrt(a^2 + nu^2)) / 2, the smooth max(a, 0) of [C], per second. At the edge of
the set the estimate moves inwards at least at this rate times 1/2 of the edge's width."""


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

    @abstractmethod
    def companion(self, estimate: Variables, gain: ca.SX) -> Adaptation:
        """The same law for one more scalar estimate (54), with the same settings."""


AdaptationFactory = Callable[[Variables, ca.SX, int], Adaptation]
"""Makes a law from the estimates, their gain matrix, and how many steps differentiate the law."""


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

    def companion(self, estimate: Variables, gain: ca.SX) -> Gradient:
        return self


def gradient(theta_hat: Variables, Gamma: ca.SX, steps: int) -> Gradient:
    """The paper's law (19), (55), which needs none of its arguments."""
    return Gradient()


@dataclass(frozen=True)
class Joint(Adaptation):
    """Two estimates as one: the first `size` elements by one law, the rest by a companion of it."""

    first: Adaptation
    second: Adaptation
    size: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*self.first.parameters, *self.second.parameters)

    def regressor(self, w: ca.SX, z: ca.SX) -> ca.SX:
        (a, b) = self._parts(w)
        return ca.vertcat(self.first.regressor(a, z), self.second.regressor(b, z))

    def rate(self, tau: ca.SX) -> ca.SX:
        (a, b) = self._parts(tau)
        return ca.vertcat(self.first.rate(a), self.second.rate(b))

    def slope(self, before: ca.SX, after: ca.SX, w: ca.SX) -> ca.SX:
        pairs = zip(*(self._parts(v) for v in (before, after, w)), strict=True)
        laws = (self.first, self.second)
        return ca.vertcat(*(law.slope(*pair) for law, pair in zip(laws, pairs, strict=True)))

    def companion(self, estimate: Variables, gain: ca.SX) -> Adaptation:
        return self.first.companion(estimate, gain)

    def _parts(self, v: ca.SX) -> tuple[ca.SX, ca.SX]:
        return v[: self.size], v[self.size :]


@dataclass(frozen=True)
class Settings:
    """The parameters that all estimates of a controller share."""

    adapt: Variables
    sigma: Variables
    switching: Variables
    projection_ball: Variables
    projection_box: Variables
    projection_margin: Variables
    dead_zone: Variables

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """With the neutral defaults."""
        return (
            Parameter(self.adapt, (1.0,), Domain.BOOLEAN),
            Parameter(self.sigma, (0.0,), Domain.NONNEGATIVE),
            Parameter(self.switching, (0.0,), Domain.BOOLEAN),
            Parameter(self.projection_ball, (0.0,), Domain.BOOLEAN),
            Parameter(self.projection_box, (0.0,), Domain.BOOLEAN),
            Parameter(self.projection_margin, (0.1,), Domain.POSITIVE),
            Parameter(self.dead_zone, (0.0,), Domain.NONNEGATIVE),
        )


@dataclass(frozen=True)
class Robust(Adaptation):
    """The rivals of congelation in one law, each off by default.

    - `adapt` = false: frozen estimates.
    - `sigma` > 0: leakage -sigma (theta_hat - center), the fixed sigma-modification [3]; with
      `switching` it acts only outside |theta_hat - center| <= bound, as in [9] and [G].
    - `projection_ball`, `projection_box`: smooth projection [7], [8], [C] onto the ball
      |theta_hat - center| <= bound, onto the box |theta_hat_j - center_j| <= half_width_j, or onto
      both; estimates that start inside stay inside the set enlarged by `projection_margin`.
    - `dead_zone` > 0: an error z_i with |z_i| <= dead_zone does not move the estimates [3].

    Parameters
    ----------
    estimate : Variables, shape (p, 1)
        theta_hat.
    gain : casadi.SX, shape (p, p)
        Gamma.
    smoothness : int
        chi has this many continuous derivatives.
    settings : Settings
    center, bound, half_width : Variables, shapes (p, 1), (1, 1), (p, 1)
        The set in which the parameters are believed to be.
    shares_settings : bool
        True for a companion, whose settings are parameters of the first law.
    """

    estimate: Variables
    gain: ca.SX
    smoothness: int
    settings: Settings
    center: Variables
    bound: Variables
    half_width: Variables
    shares_settings: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        p = self.estimate.symbol.numel()
        own = (
            Parameter(self.center, (0.0,) * p),
            Parameter(self.bound, (1.0,), Domain.POSITIVE),
            Parameter(self.half_width, (1.0,) * p, Domain.POSITIVE),
        )
        return own if self.shares_settings else (*self.settings.parameters, *own)

    def regressor(self, w: ca.SX, z: ca.SX) -> ca.SX:
        return w * self._gate(z)

    def rate(self, tau: ca.SX) -> ca.SX:
        P, normal, size = self._constraint()
        leaking = tau - self._leakage()
        outwards = normal.T @ self.gain @ leaking
        chi = leaking - normal * (P * (outwards + _root(outwards)) / (2 * size))
        return _where(self.settings.adapt.symbol, chi)

    def slope(self, before: ca.SX, after: ca.SX, w: ca.SX) -> ca.SX:
        # s(a) - s(b) = (a - b) (1 + (a + b) / (sqrt(a^2 + nu^2) + sqrt(b^2 + nu^2))) / 2
        P, normal, size = self._constraint()
        pull = normal.T @ self.gain
        a, b = pull @ (after - self._leakage()), pull @ (before - self._leakage())
        share = (1 + (a + b) / (_root(a) + _root(b))) / 2
        slope = w - normal * (P * share * (pull @ w) / size)
        return _where(self.settings.adapt.symbol, slope)

    def companion(self, estimate: Variables, gain: ca.SX) -> Robust:
        return Robust(
            estimate, gain, self.smoothness, self.settings, *_set_of(estimate), shares_settings=True
        )

    @property
    def _offset(self) -> ca.SX:
        return self.estimate.symbol - self.center.symbol

    def _leakage(self) -> ca.SX:
        """sigma (theta_hat - center), where `switching` blends it in between bound and 2 bound."""
        beyond = ca.sumsqr(self._offset) / self.bound.symbol**2 - 1  # 3 at twice the bound
        ramp = 1 - 1 / (1 + self._positive_power(beyond / 3))
        share = 1 - _where(self.settings.switching.symbol, 1 - ramp)
        return self.settings.sigma.symbol * share * self._offset

    def _gate(self, z: ca.SX) -> ca.SX:
        """0 where |z| <= dead_zone, 1/2 at sqrt(2) times that, tending to 1."""
        width = self.settings.dead_zone.symbol
        edge = self._positive_power(z**2 - width**2)
        inside = self._positive_power(width**2 + (width <= 0))  # not 0 without a dead zone
        return 1 - _where(width > 0, inside / (inside + edge))

    def _constraint(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """P, its gradient, and the gradient's squared size.

        P >= 0 is convex, 0 exactly in the set, and at most 1 only in the set enlarged by the
        margin. The size is grad P^T Gamma grad P where P = 1, and kept from 0 inside.
        """
        margin = (1 + self.settings.projection_margin.symbol) ** 2 - 1
        ball = (ca.sumsqr(self._offset) / self.bound.symbol**2 - 1) / margin
        box = ((self._offset / self.half_width.symbol) ** 2 - 1) / margin
        P = _where(self.settings.projection_ball.symbol, self._positive_power(ball))
        for j in range(box.numel()):
            side = self._positive_power(box[j])
            P += _where(self.settings.projection_box.symbol, side)
        normal = ca.gradient(P, self.estimate.symbol)
        scale = ca.sum1(ca.diag(self.gain) / self.half_width.symbol**2)
        size = normal.T @ self.gain @ normal + scale * self._positive_power(1 - P)
        return P, normal, size

    def _positive_power(self, value: ca.SX) -> ca.SX:
        """max(value, 0) to the power smoothness + 2, of which two derivatives are spent."""
        positive = ca.fmax(value, 0)
        power = positive
        for _ in range(self.smoothness + 1):
            power = power * positive
        return power


def robust(theta_hat: Variables, Gamma: ca.SX, steps: int) -> Robust:
    """Leakage, projection, dead zone and frozen estimates as parameters, all off by default.

    Parameters
    ----------
    theta_hat, Gamma, steps
        See `AdaptationFactory`. The control of `steps` steps and its time derivative hold
        `steps` - 1 derivatives of the law.
    """
    settings = Settings(
        adapt=scalar("adapt", "False: the estimates are frozen"),
        sigma=scalar("sigma", "Leakage of the sigma-modification"),
        switching=scalar("switching", "True: leakage only beyond the bound"),
        projection_ball=scalar("projection_ball", "True: project onto the ball"),
        projection_box=scalar("projection_box", "True: project onto the box"),
        projection_margin=scalar("projection_margin", "Relative width of the projection's edge"),
        dead_zone=scalar("dead_zone", "Errors up to this size do not move the estimates"),
    )
    return Robust(theta_hat, Gamma, max(steps - 1, 0), settings, *_set_of(theta_hat))


@dataclass(frozen=True)
class Claim:
    """What the certificate says under a law, for one estimate and the constant that it estimates.

    With `leaves_open` empty, V' obeys the gradient law's bound for every constant ell in the set
    {|ell - center| <= bound, |ell_j - center_j| <= half_width_j}, less
    (sigma/2) (|ell - theta_hat|^2 - |ell - center|^2) of a leakage that acts everywhere.

    Attributes
    ----------
    estimate : str
        ``theta_hat`` or ``rho_hat``.
    leaves_open : str
        Why there is no certificate; empty where there is one.
    sigma : float
        Leakage that acts everywhere; 0 with `switching`, which does not act in the set.
    center, half_width : ndarray, shape (p,)
    bound : float
        Infinite where the law asks nothing of ell, as are the half-widths.
    """

    estimate: str
    leaves_open: str
    sigma: float
    center: NDArray[np.float64]
    bound: float
    half_width: NDArray[np.float64]

    @property
    def restricts(self) -> bool:
        """Whether the certificate holds for some ell only."""
        return math.isfinite(self.bound) or bool(np.isfinite(self.half_width).all())

    def nearest(self, ell: ArrayLike) -> NDArray[np.float64]:
        """`ell` if it is in the set, else a point of the set near to it."""
        offset = np.clip(np.asarray(ell, float) - self.center, -self.half_width, self.half_width)
        size = float(np.linalg.norm(offset))
        return self.center + (offset if size <= self.bound else offset * (self.bound / size))

    def decay(self, ell: ca.SX, estimate: ca.SX) -> ca.SX:
        """What leakage adds to the claimed rate, for V = |ell - theta_hat|^2/(2 Gamma)."""
        return self.sigma / 2 * ca.sumsqr(ell - estimate)

    def residue(self, ell: ca.SX) -> ca.SX:
        """What leakage leaves of V' where everything else is 0."""
        return self.sigma / 2 * ca.sumsqr(ell - ca.DM(self.center))


def claim_of(values: Mapping[str, ArrayLike], estimate: str, size: int) -> Claim:
    """The claim of the law that these parameters of a controller set.

    Parameters
    ----------
    values : mapping
        Parameters by name; those of `robust` that are absent have their neutral values.
    estimate : str
        ``theta_hat`` or ``rho_hat``.
    size : int
        Number of its elements.
    """

    def number(name: str, neutral: float) -> float:
        return float(np.asarray(values.get(name, neutral), float).item())

    base = estimate.removesuffix("_hat")
    sigma, switching = number("sigma", 0.0), number("switching", 0.0) != 0
    leaves_open = ""
    if number("adapt", 1.0) == 0:
        leaves_open = "frozen estimates (adapt = false) leave (ell - theta_hat)^T W z in V'"
    elif number("dead_zone", 0.0) > 0:
        leaves_open = (
            f"the dead zone (dead_zone = {number('dead_zone', 0.0):.9g}) leaves "
            "(ell - theta_hat)^T (W z - chi) in V', which has no sign"
        )
    ball = number("projection_ball", 0.0) != 0 or (switching and sigma > 0)
    half_width = np.full(size, math.inf)
    if number("projection_box", 0.0) != 0:
        half_width = np.asarray(values[f"{base}_half_width"], float).ravel()
    return Claim(
        estimate,
        leaves_open,
        0.0 if switching else sigma,
        np.asarray(values.get(f"{base}_center", np.zeros(size)), float).ravel(),
        number(f"{base}_bound", 1.0) if ball else math.inf,
        half_width,
    )


def _set_of(estimate: Variables) -> tuple[Variables, Variables, Variables]:
    """The center, bound and half-widths of an estimate: theta_hat has theta_center, .. ."""
    base = estimate.name.removesuffix("_hat")
    p = estimate.symbol.numel()
    center, width = f"{base}_center", f"{base}_half_width"
    bound = scalar(f"{base}_bound", f"Radius of the ball around {center}")
    about = f"Center of the set where {base} is believed to be", f"Half-width of the box of {base}"
    if not estimate.indexed:
        return scalar(center, about[0]), bound, scalar(width, about[1])
    return vector(center, p, about[0]), bound, vector(width, p, about[1])


def _root(a: ca.SX) -> ca.SX:
    return ca.sqrt(a**2 + PROJECTION_SMOOTHING**2)


def _where(condition: ca.SX, value: ca.SX) -> ca.SX:
    """`value` where `condition` is not 0, else exactly 0, also where `value` overflows."""
    return ca.SX(ca.if_else(condition, value, 0))
