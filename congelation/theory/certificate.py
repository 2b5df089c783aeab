"""The Lyapunov certificate of a closed loop, at a state, along a run, and by search.

Each design claims V' <= -rate + residue for every perturbation Delta = theta - ell that the radii
admit, where V holds the congealed parameters ell; the residue is 0 except where a law trades
regulation for bounded estimates. V' is affine in Delta, so its largest value is known in closed
form: the value at Delta = 0 plus the support function of the admitted set at the gradient. The
*margin* is that largest V' plus the claimed rate, less the residue: positive where the claim fails.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput, counted
from congelation.theory.closed_loop import ClosedLoop, Compiled

__all__ = ["Certificate", "Coordinates", "Finding", "Margin", "PerturbationSet", "Terms"]

Vector = NDArray[np.float64]

ROUNDING = 1e-9
"""A margin above this fraction of the terms that it is the sum of is a violation; less is within
the rounding of those terms."""

ASCENT = {"maxiter": 100, "maxfun": 300}
"""Effort of one local ascent. Where the claim fails, the excess may have no maximum at all."""

DECADES = (-4.0, 1.0)
"""Sizes of a group of coordinates that the search draws, as powers of 10. Near z = 0 the claim is
one of quadratic forms, so that small states show what large ones, where the damping of high order
dominates, do not."""

LARGEST_GAIN = 10.0
"""An input gain b(t) is looked at up to this many times inf |b(t)| above it; no bound is needed."""

UNEVEN = 3.0
"""Decades by which single coordinates of a group are smaller, in every other state drawn."""


@dataclass(frozen=True)
class PerturbationSet:
    """{offset + D : |D| <= delta, |D_first| <= delta_1, D = 0 where nothing varies}.

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
    offset : tuple of float
        Centre of theta(t) minus ell, where ell is not that centre; empty: it is.
    gain : int or None
        The element that is an input gain b(t). Its ell is the end of the interval of b(t) next to
        0, and b - ell may be anything of the gain's sign; sizes up to `gain_reach` are looked at.
    sign : float
        That of the gain.
    free_delta : bool
        Whether the claim holds for any delta, which is then the last element of ell.
    """

    delta: float
    varies: tuple[bool, ...]
    first: int | None = None
    delta_1: float = math.inf
    offset: tuple[float, ...] = ()
    gain: int | None = None
    sign: float = 1.0
    gain_reach: float = 0.0
    free_delta: bool = False

    def ell(self, center: Vector, radii: Vector | None = None) -> Vector:
        """The congealed parameters for a theta(t) in the box of that centre and those radii.

        With structured variations the centre is vartheta, then that of b(t), and the box one of
        theta_u, then of b(t).
        """
        ell = center - np.array(self.offset) if self.offset else center.copy()
        spread = np.zeros(len(self.varies)) if radii is None else radii
        if self.gain is not None:  # b(t) is the last element of theta, and of ell
            ell[-1] -= self.sign * spread[-1]
        if self.free_delta:
            varying = np.where(self.varies, spread, 0.0)
            ell = np.append(ell, np.linalg.norm(varying))
        return ell

    def about(self, ell: Vector) -> PerturbationSet:
        """The set for these congealed parameters."""
        found = self
        if self.free_delta:
            found = replace(found, delta=float(ell[-1]))
        if self.gain is not None:
            place = -2 if self.free_delta else -1
            found = replace(found, gain_reach=LARGEST_GAIN * abs(float(ell[place])))
        return found

    def worst(self, gradient: Vector) -> Vector:
        """The Delta of the set with the largest gradient . Delta."""
        Delta = self._about_zero(gradient)
        return Delta + np.array(self.offset) if self.offset else Delta

    def _about_zero(self, gradient: Vector) -> Vector:
        g = np.where(self.varies, gradient, 0.0)
        size = float(np.linalg.norm(g))
        Delta = np.zeros_like(g) if size == 0 else self.delta * (g / size)
        if self.gain is not None and self.sign * gradient[self.gain] > 0:
            Delta[self.gain] = self.sign * self.gain_reach
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
    residue : float
        What V' may exceed -claimed by, e.g. (sigma/2) |ell - theta_center|^2 of the leakage.
    scale : float
        Sum of the magnitudes of the terms of `value`, against which rounding is measured.
    Delta : ndarray, shape (p,)
        Where `rate` is attained.
    """

    V: float
    rate: float
    claimed: float
    residue: float
    scale: float
    Delta: Vector

    @property
    def value(self) -> float:
        """V' + claimed - residue: positive where the claim fails."""
        return self.rate + self.claimed - self.residue

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

    @property
    def resolved(self) -> bool:
        """Whether the claimed rate stands out of the rounding, so that its failure would show."""
        return self.claimed > ROUNDING * self.scale


@dataclass(frozen=True)
class Finding:
    """The worst state that a search met.

    Attributes
    ----------
    margin : Margin
    state : dict
        The states of the closed loop by name.
    ell : ndarray, shape (p,)
    samples, discarded, resolved : int
        States drawn; those of them at which some term overflowed; and those at which the claimed
        rate stands out of the rounding.
    extreme : str
        The parameter whose size is furthest from 1, with its value: the one to change where few
        states are resolved.
    """

    margin: Margin
    state: dict[str, float]
    ell: Vector
    samples: int
    discarded: int
    resolved: int
    extreme: str

    @property
    def violated(self) -> bool:
        return self.margin.violated


@dataclass(frozen=True)
class Coordinates:
    """Where the search draws its states: X as a function of Y and ell.

    Parameters
    ----------
    Y : casadi.SX, shape (number of states, 1)
        E.g. the errors z and ell - theta_hat. Drawn in x, states of order 3 and more are nearly
        all huge in z, where the damping swamps everything.
    X : casadi.SX, shape (number of states, 1)
        The states of the closed loop, in terms of Y and ell.
    groups : tuple of int
        Sizes of the groups of Y that are of one size each.
    """

    Y: ca.SX
    X: ca.SX
    groups: tuple[int, ...]

    def draw(self, generator: np.random.Generator) -> Vector:
        """A random Y."""
        groups = []
        for n in self.groups:
            sizes = np.full(n, generator.uniform(*DECADES))
            if generator.random() < 0.5:
                sizes -= generator.uniform(0.0, UNEVEN, n)
            groups.append(10.0**sizes * generator.normal(size=n))
        return np.concatenate(groups)


@dataclass(frozen=True)
class Encounter:
    """A state that the search tried."""

    margin: Margin
    Y: Vector
    X: Vector
    ell: Vector

    def rank(self) -> tuple[bool, bool, float]:
        """Violations first, then states that show more than rounding, by how far the claim is
        missed."""
        return self.margin.violated, self.margin.resolved, self.margin.excess


@dataclass(frozen=True)
class Terms:
    """A Lyapunov function and its claim V' <= -claimed + residue, or summands of both.

    Attributes
    ----------
    V, claimed, residue : casadi.SX, (1, 1)
        In terms of the loop's states and ell; numbers for the parameters.
    decay : float
        a > 0 where the claimed rate is at least a V everywhere, so that V ends below residue/a; 0
        where it is not, such as without leakage.
    """

    V: ca.SX
    claimed: ca.SX
    residue: ca.SX
    decay: float

    def __add__(self, other: Terms) -> Terms:
        return Terms(
            self.V + other.V,
            self.claimed + other.claimed,
            self.residue + other.residue,
            min(self.decay, other.decay),
        )


@dataclass(frozen=True)
class Certificate:
    """A Lyapunov function V of a closed loop and the claim V' <= -claimed + residue.

    Attributes
    ----------
    loop : ClosedLoop
    ell : casadi.SX, shape (p, 1)
        The congealed parameters; then delta, where the claim holds for any.
    terms : Terms
    perturbations : PerturbationSet
    sample_ell : callable
        A random admissible ell from a generator.
    coordinates : Coordinates
        Where the search draws and ascends.
    nominal : casadi.SX or None
        theta at Delta = 0, in terms of the loop's states and ell; None: ell itself, less delta.
    """

    loop: ClosedLoop
    ell: ca.SX
    terms: Terms
    perturbations: PerturbationSet
    sample_ell: Callable[[np.random.Generator], Vector]
    coordinates: Coordinates
    nominal: ca.SX | None = None

    def ultimate(self, ell: ArrayLike) -> float | None:
        """The bound that V ends below, residue/a; None where there is none for every reference."""
        function = ca.Function("residue", [self.ell], [self.terms.residue], {"allow_free": True})
        if self.terms.decay <= 0 or function.has_free():
            return None
        return float(function(np.asarray(ell, float))) / self.terms.decay

    def at(self, state: ArrayLike, ell: ArrayLike) -> Margin:
        """The margin at a state of the closed loop, for congealed parameters ell."""
        return self._margin(
            self._numbers(state, ell), self.perturbations.about(np.asarray(ell, float))
        )

    def along(self, states: ArrayLike, ell: ArrayLike) -> list[Margin]:
        """The margins along a trajectory, `states` of shape (N, number of states)."""
        return [self.at(state, ell) for state in np.asarray(states, dtype=float)]

    def search(self, samples: int = 1000, ascents: int = 10, seed: int = 0) -> Finding:
        """Look for a state where the claim fails.

        Parameters
        ----------
        samples : int
            Random states, drawn in `coordinates`.
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
        points = []
        for _ in range(samples):
            ell = self.sample_ell(generator)
            points.append((self.coordinates.draw(generator), ell))
        met = [self._meet(Y, ell) for Y, ell in points]
        finite = [e for e in met if math.isfinite(e.margin.excess)]
        if not finite:
            raise InvalidInput(
                f"the certificate is not finite at any of {counted(samples, 'state')}, because "
                f"parameters are too large or too small; the most extreme: {self._most_extreme()}"
            )
        best = sorted(finite, key=Encounter.rank, reverse=True)[:ascents]
        climbed = [self._ascend(e.Y, e.ell) for e in best]
        worst = max([*best, *climbed], key=Encounter.rank)
        return Finding(
            worst.margin,
            dict(zip(self.loop.state_names, worst.X.tolist(), strict=True)),
            worst.ell,
            samples,
            samples - len(finite),
            sum(e.margin.resolved for e in finite),
            self._most_extreme(),
        )

    def _most_extreme(self) -> str:
        """The parameter with the element whose magnitude is furthest from 1."""

        def distance(value: Vector) -> float:
            sizes = np.abs(value[value != 0])
            return float(np.abs(np.log(sizes)).max(initial=0.0))

        own = [p.variables.name for p in self.loop.controller.parameters]
        name = max(own, key=lambda name: distance(self.loop.values[name]))
        value = self.loop.values[name]
        return f"{name} = {value.tolist() if value.size > 1 else value.item()}"

    def _meet(self, Y: Vector, ell: Vector) -> Encounter:
        X = self._drawn(Y, ell)
        return Encounter(self.at(X, ell), Y, X, ell)

    def _ascend(self, Y: Vector, ell: Vector) -> Encounter:
        """A local maximum of the excess over the coordinates, ell held."""

        def fall(Y: Vector) -> tuple[float, Vector]:
            margin = self.at(self._drawn(Y, ell), ell)
            # The gradient of a maximum over Delta is the gradient at the worst Delta (Danskin).
            slope = self._slope(Y, ell, margin.Delta)
            if not (math.isfinite(margin.excess) and np.isfinite(slope).all()):
                return math.inf, np.zeros_like(Y)
            return -margin.excess, -slope

        found = scipy.optimize.minimize(fall, Y, jac=True, method="L-BFGS-B", options=ASCENT)
        return self._meet(found.x, ell)

    def _margin(self, numbers: Vector, perturbations: PerturbationSet) -> Margin:
        V, claimed, residue, center, size = numbers[:5].tolist()
        gradient = numbers[5:]
        Delta = perturbations.worst(gradient)
        reach = float(gradient @ Delta)
        scale = size + abs(reach) + abs(claimed) + abs(residue)
        return Margin(V, center + reach, claimed, residue, scale, Delta)

    @cached_property
    def _drawn(self) -> Compiled:
        """(Y, ell) -> X."""
        return Compiled([self.coordinates.X], [self.coordinates.Y, self.ell])

    @cached_property
    def _rate(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """V' at Delta = 0, the magnitudes of its terms, and its gradient with respect to Delta."""
        X, theta = self.loop.arguments
        (f,) = self.loop.bind([self.loop.rate])
        terms = ca.jacobian(self.terms.V, X).T * f
        gradient = ca.jacobian(ca.sum1(terms), theta).T
        constants = self.ell[: theta.numel()] if self.nominal is None else self.nominal
        center, gradient = ca.substitute([terms, gradient], [theta], [constants])
        return ca.sum1(center), ca.sum1(ca.fabs(center)), gradient

    @cached_property
    def _numbers(self) -> Compiled:
        """(X, ell) -> V, the claim, and the parts of V'."""
        own, (X, _) = self.terms, self.loop.arguments
        return Compiled([own.V, own.claimed, own.residue, *self._rate], [X, self.ell])

    @cached_property
    def _slope(self) -> Compiled:
        """The gradient of the excess with respect to the coordinates, Delta held."""
        center, size, gradient = self._rate
        X, _ = self.loop.arguments
        Delta = ca.SX.sym("Delta", gradient.numel())
        reach = gradient.T @ Delta
        claimed, residue = self.terms.claimed, self.terms.residue
        scale = size + ca.fabs(reach) + ca.fabs(claimed) + ca.fabs(residue)
        excess = (center + reach + claimed - residue) / (claimed + ROUNDING * scale)
        drawn = self.coordinates
        # The chain rule by hand: the gradient in X, pulled back through X(Y), is the smaller graph.
        (slope,) = ca.substitute([ca.gradient(excess, X)], [X], [drawn.X])
        return Compiled([ca.jtimes(drawn.X, drawn.Y, slope, True)], [drawn.Y, self.ell, Delta])
