"""The Lyapunov certificate of a closed loop, at a state, along a run, and by search.

Each design claims V' <= -(rate of decay) for every perturbation Delta = theta - ell that the radii
admit, where V holds the congealed parameters ell. V' is affine in Delta, so its largest value is
known in closed form: the value at Delta = 0 plus the support function of the admitted set at the
gradient. The *margin* is that largest V' plus the claimed rate: positive where the claim fails.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from congelation.errors import InvalidInput
from congelation.theory.closed_loop import ClosedLoop, Compiled

__all__ = ["Certificate", "Finding", "Margin", "PerturbationSet"]

Vector = NDArray[np.float64]

ROUNDING = 1e-9
"""A margin above this fraction of the terms that it is the sum of is a violation; less is within
the rounding of those terms."""

ASCENT = {"maxiter": 100, "maxfun": 300}
"""Effort of one local ascent. Where the claim fails, the excess may have no maximum at all."""


@dataclass(frozen=True)
class PerturbationSet:
    """{Delta : |Delta| <= delta, |Delta_first| <= delta_1, Delta = 0 where nothing varies}.

    Attributes
    ----------
    delta : float
        Radius of the ball.
    varies : tuple of bool
        Which elements of theta vary.
    first : int or None
        The element with a radius of its own: a_{n-1} in the output feedback design.
    delta_1 : float
        That radius.
    """

    delta: float
    varies: tuple[bool, ...]
    first: int | None = None
    delta_1: float = math.inf

    def worst(self, gradient: Vector) -> Vector:
        """The Delta of the set with the largest gradient . Delta."""
        g = np.where(self.varies, gradient, 0.0)
        size = float(np.linalg.norm(g))
        Delta = np.zeros_like(g) if size == 0 else self.delta * (g / size)
        if self.first is None or abs(Delta[self.first]) <= self.delta_1:
            return Delta
        others = g.copy()
        others[self.first] = 0.0
        size = float(np.linalg.norm(others))
        left = math.sqrt(max(self.delta**2 - self.delta_1**2, 0.0))
        Delta = np.zeros_like(g) if size == 0 else left * (others / size)
        Delta[self.first] = math.copysign(self.delta_1, g[self.first])
        return Delta


@dataclass(frozen=True)
class Margin:
    """The certificate at one state.

    Attributes
    ----------
    V : float
        The Lyapunov function.
    rate : float
        The largest V' that the set of perturbations allows.
    claimed : float
        The claimed rate of decay, e.g. sum c_i z_i^2.
    scale : float
        Sum of the magnitudes of the terms of `rate`, against which rounding is measured.
    Delta : ndarray, shape (p,)
        Where `rate` is attained.
    """

    V: float
    rate: float
    claimed: float
    scale: float
    Delta: Vector

    @property
    def value(self) -> float:
        """V' + claimed: positive where the claim fails."""
        return self.rate + self.claimed

    @property
    def relative(self) -> float:
        """`value` in units of `scale`; 0 where everything is 0."""
        return self.value / self.scale if self.scale > 0 else 0.0

    @property
    def excess(self) -> float:
        """`value` in units of the claimed rate, which is what the search maximises.

        Where the claimed rate vanishes, rounding takes its place.
        """
        unit = self.claimed + ROUNDING * self.scale
        return self.value / unit if unit > 0 else 0.0

    @property
    def violated(self) -> bool:
        """Whether the claim fails here by more than rounding."""
        return self.relative > ROUNDING


@dataclass(frozen=True)
class Finding:
    """The worst state that a search met.

    Attributes
    ----------
    margin : Margin
    state : dict
        The states of the closed loop by name.
    ell : ndarray, shape (p,)
    samples, discarded : int
        States tried, and those of them at which some term overflowed.
    """

    margin: Margin
    state: dict[str, float]
    ell: Vector
    samples: int
    discarded: int

    @property
    def violated(self) -> bool:
        return self.margin.violated


@dataclass(frozen=True)
class Encounter:
    """A state that the search tried."""

    margin: Margin
    X: Vector
    ell: Vector

    def rank(self) -> tuple[bool, float]:
        """Violations first, then by how far the claim is missed."""
        return self.margin.violated, self.margin.excess


@dataclass(frozen=True)
class Certificate:
    """A Lyapunov function of a closed loop and the rate of decay that is claimed for it.

    Attributes
    ----------
    loop : ClosedLoop
    ell : casadi.SX, shape (p, 1)
        The congealed parameters.
    V, claimed : casadi.SX, (1, 1)
        In terms of the loop's states and ell; numbers for the parameters.
    perturbations : PerturbationSet
    sample_ell : callable
        A random admissible ell from a generator.
    """

    loop: ClosedLoop
    ell: ca.SX
    V: ca.SX
    claimed: ca.SX
    perturbations: PerturbationSet
    sample_ell: Callable[[np.random.Generator], Vector]

    def at(self, state: ArrayLike, ell: ArrayLike) -> Margin:
        """The margin at a state of the closed loop, for congealed parameters ell."""
        numbers = self._terms(state, ell)
        V, claimed, center, size = numbers[:4].tolist()
        gradient = numbers[4:]
        Delta = self.perturbations.worst(gradient)
        reach = float(gradient @ Delta)
        return Margin(V, center + reach, claimed, size + abs(reach) + abs(claimed), Delta)

    def along(self, states: ArrayLike, ell: ArrayLike) -> list[Margin]:
        """The margins along a trajectory, `states` of shape (N, number of states)."""
        return [self.at(state, ell) for state in np.asarray(states, dtype=float)]

    def search(self, samples: int = 1000, ascents: int = 10, seed: int = 0) -> Finding:
        """Look for a state where the claim fails.

        Parameters
        ----------
        samples : int
            Random states, of sizes from 0.01 to 10 in each variable group.
        ascents : int
            The worst ones of these from which a local ascent starts.
        seed : int
            Of the random generator.

        Raises
        ------
        InvalidInput
            If parameters are so large or small that nothing is finite.
        """
        with np.errstate(all="ignore"):  # states whose margin is not finite are left out
            return self._searched(samples, ascents, np.random.default_rng(seed))

    def _searched(self, samples: int, ascents: int, generator: np.random.Generator) -> Finding:
        points = [self._sample(generator) for _ in range(samples)]
        met = [Encounter(self.at(X, ell), X, ell) for X, ell in points]
        finite = [e for e in met if math.isfinite(e.margin.excess)]
        if not finite:
            raise InvalidInput(
                f"the certificate is not finite at any of {samples} states, because parameters are "
                f"too large or too small; the most extreme: {self._most_extreme()}"
            )
        best = sorted(finite, key=Encounter.rank, reverse=True)[:ascents]
        climbed = [self._ascend(e.X, e.ell) for e in best]
        worst = max([*best, *climbed], key=Encounter.rank)
        state = dict(zip(self.loop.state_names, worst.X.tolist(), strict=True))
        return Finding(worst.margin, state, worst.ell, samples, samples - len(finite))

    def _most_extreme(self) -> str:
        """The parameter or gain with the element whose magnitude is furthest from 1."""

        def distance(value: Vector) -> float:
            sizes = np.abs(value[value != 0])
            return float(np.abs(np.log(sizes)).max(initial=0.0))

        name, value = max(self.loop.values.items(), key=lambda item: distance(item[1]))
        return f"{name} = {value.tolist() if value.size > 1 else value.item()}"

    def _sample(self, generator: np.random.Generator) -> tuple[Vector, Vector]:
        models = (self.loop.plant, self.loop.controller)
        sizes = [len(s.variables.names) for model in models for s in model.states]
        groups = [10 ** generator.uniform(-2, 1) * generator.normal(size=n) for n in sizes]
        return np.concatenate(groups), self.sample_ell(generator)

    def _ascend(self, X: Vector, ell: Vector) -> Encounter:
        """A local maximum of the excess over the state, ell held."""

        def fall(state: Vector) -> tuple[float, Vector]:
            margin = self.at(state, ell)
            # The gradient of a maximum over Delta is the gradient at the worst Delta (Danskin).
            slope = self._slope(state, ell, margin.Delta)
            if not (math.isfinite(margin.excess) and np.isfinite(slope).all()):
                return math.inf, np.zeros_like(state)
            return -margin.excess, -slope

        found = minimize(fall, X, jac=True, method="L-BFGS-B", options=ASCENT)
        return Encounter(self.at(found.x, ell), found.x, ell)

    @cached_property
    def _rate(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """V' at Delta = 0, the magnitudes of its terms, and its gradient with respect to Delta."""
        X, theta = self.loop.arguments
        (f,) = self.loop.bind([self.loop.rate])
        terms = ca.jacobian(self.V, X).T * f
        gradient = ca.jacobian(ca.sum1(terms), theta).T
        center, gradient = ca.substitute([terms, gradient], [theta], [self.ell])
        return ca.sum1(center), ca.sum1(ca.fabs(center)), gradient

    @cached_property
    def _terms(self) -> Compiled:
        center, size, gradient = self._rate
        X, _ = self.loop.arguments
        return Compiled([self.V, self.claimed, center, size, gradient], [X, self.ell])

    @cached_property
    def _slope(self) -> Compiled:
        """The gradient of the excess with respect to the state, Delta held."""
        center, size, gradient = self._rate
        X, _ = self.loop.arguments
        Delta = ca.SX.sym("Delta", self.ell.numel())
        reach = gradient.T @ Delta
        scale = size + ca.fabs(reach) + ca.fabs(self.claimed)
        excess = (center + reach + self.claimed) / (self.claimed + ROUNDING * scale)
        return Compiled([ca.gradient(excess, X)], [X, self.ell, Delta])
