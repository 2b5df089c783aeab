"""The largest level set of a Lyapunov function on which a control stays within its limits.

While |u| <= u_max, a saturated loop is the loop of the certificate, V' <= 0 there, and {V <= v} is
left by no trajectory. So with v* the smallest V at which |u| reaches u_max, a loop that starts with
V < v* never saturates and keeps its certificate. Beyond v* nothing is claimed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput
from congelation.theory.certificate import Certificate
from congelation.theory.closed_loop import Compiled

__all__ = ["Level", "largest_level"]

Vector = NDArray[np.float64]

RAYS = 300
"""Random directions in which the nearest state that saturates is looked for."""

DESCENTS = 12
"""The best of these from which a local descent along the surface |u| = u_max starts."""

REACH = np.logspace(-6.0, 6.0, 73)
"""Distances along a ray at which |u| is looked at, in units of the ray's direction."""

NEAR = 1e-6
"""A descent counts where its |u| is this near to u_max, relative to it."""


@dataclass(frozen=True)
class Level:
    """A level set {V < v} on which |u| < u_max.

    Attributes
    ----------
    umax : float
        The limit of the control.
    v : float
        v*: the smallest V at which |u| reaches the limit, as far as the search found; infinite
        where it met no such state.
    state : dict
        The states of the loop by name at which it does.
    start : float
        V at the start of the loop.
    """

    umax: float
    v: float
    state: dict[str, float]
    start: float

    @property
    def holds_start(self) -> bool:
        """Whether the loop starts inside, so that it never saturates and keeps its certificate."""
        return self.start < self.v


def largest_level(
    certificate: Certificate, umax: float, ell: ArrayLike, start: ArrayLike, seed: int = 0
) -> Level:
    """The largest level set of V on which |u| < u_max, and V at a start.

    The smallest V on the surface |u| = u_max is a minimum of a smooth function under one smooth
    constraint. It is looked for in the coordinates of the certificate, in which V is near to a sum
    of squares: first along random rays from the bottom of V, then by local descents (SLSQP) from
    the best of the points found. Like the search of the certificate it proves nothing: a smaller
    one may have been missed.

    Parameters
    ----------
    certificate : Certificate
        Of the loop without limits, with a claim that has no residue.
    umax : float
        Largest |u|, in the unit of u.
    ell : array_like
        The congealed parameters, whose distance from the estimates V holds.
    start : array_like
        The states at the start.
    seed : int
        Of the rays.

    Raises
    ------
    InvalidInput
        A limit that is not positive, or a loop in which no level set of V bounds u.
    """
    if not 0.0 < umax < math.inf:
        raise InvalidInput(f"umax = {umax!r} is not valid; give a positive number")
    loop = certificate.loop
    ell = np.asarray(ell, dtype=float)
    _check_bounds(certificate)
    Y, X = certificate.coordinates.Y, certificate.coordinates.X
    states, _ = loop.arguments
    u = loop.bound_signal("controller.u")
    V, u = ca.substitute([certificate.terms.V, u], [states], [X])
    value = Compiled([V, u], [Y, certificate.ell])
    slope = Compiled([ca.gradient(V, Y), ca.gradient(u, Y)], [Y, certificate.ell])
    drawn = Compiled([X], [Y, certificate.ell])
    size = Y.numel()

    def V_of(y: Vector) -> float:
        return float(value(y, ell)[0])

    def u_of(y: Vector) -> float:
        return float(value(y, ell)[1])

    with np.errstate(all="ignore"):
        # The bottom of V, where u is 0: the origin but where V holds a root of an estimate.
        bottom = scipy.optimize.minimize(
            V_of, np.full(size, 0.1), jac=lambda y: slope(y, ell)[:size], method="BFGS"
        ).x
        generator = np.random.default_rng(seed)
        rays = [certificate.coordinates.draw(generator) for _ in range(RAYS)]
        found = [point for ray in rays for point in _crossings(u_of, umax, bottom, ray)]
        best = sorted(found, key=V_of)[:DESCENTS]
        descents = [_descended(value, slope, umax, ell, point) for point in best]
        best += [point for point in descents if point is not None]
    begin = np.asarray(start, dtype=float)
    at_start = certificate.at(begin, ell).V
    if not best:
        return Level(umax, math.inf, {}, at_start)
    lowest = min(best, key=V_of)
    names = dict(zip(loop.state_names, drawn(lowest, ell).tolist(), strict=True))
    return Level(umax, V_of(lowest), names, at_start)


def _check_bounds(certificate: Certificate) -> None:
    """Refuse a loop in which no level set of V bounds u, or V may leave its level sets."""
    loop = certificate.loop
    if any(state.variables.name == "lambda" for state in loop.controller.states):
        raise InvalidInput(
            "in output feedback V does not bound the filters, from which u is made; there is no "
            "level set of V on which |u| <= umax"
        )
    if loop.opened("reference").numel():
        raise InvalidInput(
            "V does not bound the reference, from which u is made; there is no level set of V on "
            "which |u| <= umax"
        )
    if loop.controller.Upsilon is not None:
        raise InvalidInput(
            "V does not bound Upsilon(t), from which u is made; there is no level set of V on "
            "which |u| <= umax"
        )
    if not certificate.terms.residue.is_zero():
        raise InvalidInput(
            "the claim has a residue, so that V may grow and leave its level sets; give a law "
            "without one (switching leakage, projection)"
        )


def _descended(
    value: Compiled, slope: Compiled, umax: float, ell: Vector, point: Vector
) -> Vector | None:
    """The point of the surface |u| = umax with the least V near to a given one; None: not found."""
    V, u = value(point, ell)
    side, size = math.copysign(1.0, u), point.size
    surface = scipy.optimize.NonlinearConstraint(
        lambda y: side * value(y, ell)[1] / umax - 1.0,
        0.0,
        math.inf,
        jac=lambda y: side * slope(y, ell)[size:] / umax,
    )
    descent = scipy.optimize.minimize(
        lambda y: value(y, ell)[0] / V,
        point,
        jac=lambda y: slope(y, ell)[:size] / V,
        constraints=[surface],
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    V, u = value(descent.x, ell)
    reached = abs(u) >= umax * (1.0 - NEAR) and math.isfinite(V)
    return np.asarray(descent.x) if reached else None


def _crossings(
    u_of: Callable[[Vector], float], umax: float, bottom: Vector, ray: Vector
) -> list[Vector]:
    """The first point on each half of a line through `bottom` at which |u| is umax, if any."""
    points = []
    for direction in (ray, -ray):

        def excess(r: float, direction: Vector = direction) -> float:
            return abs(u_of(bottom + r * direction)) - umax

        before = 0.0
        for r in REACH:
            there = excess(r)
            if not math.isfinite(there):
                break
            if there >= 0.0:
                points.append(
                    bottom + scipy.optimize.brentq(excess, before, r, xtol=1e-12) * direction
                )
                break
            before = r
    return points
