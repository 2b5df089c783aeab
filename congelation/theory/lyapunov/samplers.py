"""Random congealed parameters, for which the law of a design keeps its certificate."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from congelation.errors import InvalidInput
from congelation.theory.adaptation import Claim

__all__ = [
    "Sampler",
    "with_bound_of",
    "with_gain_of",
    "with_inverse_of",
    "with_radius_of",
    "within",
]

Matrix = NDArray[np.float64]
Sampler = Callable[[np.random.Generator], Matrix]


def within(law: Claim) -> Sampler:
    """Random ell: of any size, or in the set for which the law's claim holds."""

    def sample(generator: np.random.Generator) -> Matrix:
        size = law.center.size
        if not law.restricts:
            return np.asarray(10 ** generator.uniform(-1, 1) * generator.normal(size=size))
        reach = np.minimum(law.half_width, law.bound)
        return law.nearest(law.center + generator.uniform(-1, 1, size) * reach)

    return sample


def with_radius_of(sample: Sampler, law: Claim, epsilon: float) -> Sampler:
    """Random ell and delta, the latter of any size for which D is in its law's set."""

    def with_radius(generator: np.random.Generator) -> Matrix:
        ell = sample(generator)
        D = law.nearest(np.array([(epsilon * 10 ** generator.uniform(-1, 1)) ** 2 / 2]))
        return np.append(ell, math.sqrt(2 * max(D.item(), 0.0)) / epsilon)

    return with_radius


def with_bound_of(sample: Sampler, law: Claim) -> Sampler:
    """Random ell and delta, the latter in its law's set."""

    def with_bound(generator: np.random.Generator) -> Matrix:
        ell = sample(generator)
        return np.append(ell, law.nearest(np.array([10 ** generator.uniform(-1, 1)])))

    return with_bound


def with_gain_of(sample: Sampler, place: int, law: Claim, sign: float) -> Sampler:
    """Random ell with ell_b at `place`, of the known sign, and 1/ell_b in its law's set."""

    def with_gain(generator: np.random.Generator) -> Matrix:
        inverse = law.nearest(np.array([sign * 10 ** generator.uniform(-1, 1)])).item()
        if not inverse * sign > 0:
            raise InvalidInput(
                "no gain of the sign sign_b has its inverse in the set of rho_center; give a set "
                "that holds 1/b"
            )
        return np.insert(sample(generator), place, 1 / inverse)

    return with_gain


def with_inverse_of(law: Claim, rho_law: Claim, sign: float) -> Sampler:
    """Random ell with b_m of the known sign (Assumption 3), it and 1/b_m in their laws' sets."""
    reach = min(law.half_width[0], law.bound)
    low, high = sorted((sign * (law.center[0] - reach), sign * (law.center[0] + reach)))
    inverse = min(rho_law.half_width[0], rho_law.bound)
    ends = sorted(sign * (rho_law.center[0] + side * inverse) for side in (-1, 1))
    if ends[1] <= 0 or high <= 0:
        low, high = 1.0, 0.0
    else:  # of |b_m|
        low = max(low, 1 / ends[1])
        high = min(high, 1 / ends[0] if ends[0] > 0 else math.inf)
    if low > high:
        raise InvalidInput(
            "no b_m has the sign sign_b_m, is in the set of theta_center and has 1/b_m in the set "
            "of rho_center; give sets that hold [b, a] and 1/b_m"
        )
    # Without an end the sizes drawn are those about 1 and about the other end.
    low, high = max(low, min(1.0, high) / 10), min(high, max(1.0, low) * 10)
    others = within(law)

    def sample(generator: np.random.Generator) -> Matrix:
        ell = others(generator)
        ell[0] = sign * np.exp(generator.uniform(np.log(low), np.log(high)))
        rest = ell[1:] - law.center[1:]
        left = math.sqrt(max(law.bound**2 - (ell[0] - law.center[0]) ** 2, 0.0))
        size = float(np.linalg.norm(rest))
        if size > left:
            ell[1:] = law.center[1:] + rest * (left / size)
        return ell

    return sample
