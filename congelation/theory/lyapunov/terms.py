"""What the certificates have in common: the terms that V and its claim are the sums of."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.theory.adaptation import Claim, claim_of
from congelation.theory.certificate import PerturbationSet, Terms
from congelation.theory.closed_loop import ClosedLoop

__all__ = [
    "ball",
    "estimate_terms",
    "free_ell",
    "inverse",
    "quadratic",
    "stacked",
    "state_of",
]

Matrix = NDArray[np.float64]


def estimate_terms(
    law: Claim, ell: ca.SX, estimate: ca.SX, gain: ArrayLike, weight: ca.SX | float = 1.0
) -> Terms:
    """weight (ell - estimate)^T gain^-1 (ell - estimate)/2 in V, and what leakage makes of it.

    Leakage alone lets it fall at sigma times the smallest eigenvalue of the gain.
    """
    Gamma = np.atleast_2d(np.asarray(gain, dtype=float))
    return Terms(
        weight * quadratic(inverse(Gamma), ell - estimate) / 2,
        weight * law.decay(ell, estimate),
        weight * law.residue(ell),
        law.sigma * float(np.linalg.eigvalsh(Gamma).min()),
    )


def stacked(loop: ClosedLoop, values: Mapping[str, ca.SX]) -> ca.SX:
    """The states of the loop in its order, from expressions by name."""
    states = [s.variables.name for s in (*loop.plant.states, *loop.controller.states)]
    states += [entry.variables.name for entry in loop.external]
    return ca.densify(ca.vertcat(*(values[name] for name in states)))


def quadratic(P: Matrix, v: ca.SX) -> ca.SX:
    """v^T P v."""
    return v.T @ ca.DM(P) @ v


def inverse(P: Matrix) -> Matrix:
    """P^-1."""
    return np.asarray(np.linalg.inv(P), dtype=float)


def state_of(loop: ClosedLoop, name: str) -> ca.SX:
    """The state x of the plant, or another one of the controller."""
    side = "plant" if name == "x" else "controller"
    return loop.state(side, name).symbol


def ball(loop: ClosedLoop, first_order: Matrix | None = None) -> PerturbationSet:
    """|theta - center| <= delta.

    Where V' holds theta in (first_order . Delta) z^2 alone and ell may be chosen, it is such that
    this product is never positive: center + delta first_order/|first_order|.
    """
    _, theta = loop.arguments
    delta = loop.values["delta"].item() if "delta" in loop.values else 0.0
    free = "delta" not in loop.values
    offset: tuple[float, ...] = ()
    if first_order is not None and first_order.any() and free_ell(loop):
        offset = tuple(-delta * first_order / np.linalg.norm(first_order))
    return PerturbationSet(delta, (True,) * theta.numel(), offset=offset, free_delta=free)


def free_ell(loop: ClosedLoop) -> bool:
    """Whether ell need not be the centre of theta(t): without damping it would fail there, and no
    set of the adaptation law has to hold it."""
    law = claim_of(loop.values, "theta_hat", loop.state("controller", "theta_hat").symbol.numel())
    return not loop.values["damping"].item() and not law.restricts
