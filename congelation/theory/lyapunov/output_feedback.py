"""The certificate of output feedback, with whatever a law copes with beyond the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from congelation.errors import InvalidInput
from congelation.theory.adaptation import claim_of
from congelation.theory.certificate import Certificate, Coordinates, PerturbationSet, Terms
from congelation.theory.closed_loop import ClosedLoop
from congelation.theory.gains import filter_norm, filter_riccati
from congelation.theory.iss_riccati import iss_riccati, iss_weight
from congelation.theory.kfilter import KFilter
from congelation.theory.lyapunov.samplers import with_inverse_of, with_radius_of
from congelation.theory.lyapunov.terms import (
    estimate_terms,
    free_ell,
    inverse,
    quadratic,
    stacked,
    state_of,
)

__all__ = ["output_feedback_certificate"]

Matrix = NDArray[np.float64]


def output_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """The function of Proposition 2, with the weight of V_xtilde that the corrected damping needs.

    V = z^T z/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2
    + |b_m| (1/b_m - rho_hat)^2/(2 gamma) + w V_xtilde, claimed V' <= -sum c_i z_i^2; w and what is
    left of V' are those of `_Split`. An unknown radius adds (D - D_hat)^2/(2 gamma_D) to V, D the
    damping that is needed.

    Of first order x_tilde does not enter z', so that Controller 2 is certified without V_xtilde,
    with ell_a = inf a(t).
    """
    values, z = loop.values, loop.bound_signal("controller.z")
    n = values["k"].size
    b_and_a = ca.SX.sym("ell", state_of(loop, "theta_hat").numel())
    m = b_and_a.numel() - n - 1
    known, b_m = "delta" in values, b_and_a[0]
    constants = b_and_a if known else ca.vertcat(b_and_a, ca.SX.sym("delta"))
    delta = values["delta"].item() if known else 0.0
    delta_1 = values["delta_1"].item() if known else math.inf

    law, rho_law = claim_of(values, "theta_hat", m + 1 + n), claim_of(values, "rho_hat", 1)
    sign, rate = values["sign_b_m"].item(), np.array(values["c"], dtype=float).ravel()
    P, g = _estimation_error_function(values, n - m)
    extreme = n == 1 and known and free_ell(loop) and not loop.external
    split = _split(loop, g, delta if known else constants[-1], law.sigma > 0 and not extreme)
    rate[0] -= split.spent
    weight, decay, offset = split.weight, math.inf, tuple[float, ...]()
    if extreme:
        weight, offset = 0.0, (0.0, min(delta, delta_1))
    else:
        decay = split.decay / (weight * float(np.linalg.norm(P, 2)))
    xi, Omega_T = _filter_signals(loop, m)
    x_tilde = state_of(loop, "x") - xi - Omega_T @ b_and_a  # (39)-(40)
    terms = Terms(
        ca.sumsqr(z) / 2 + weight * quadratic(P, x_tilde),
        ca.sum1(ca.DM(rate) * z**2) + split.decay * ca.sumsqr(x_tilde),
        split.residue,
        min(2 * float(rate.min()), decay),
    )
    terms += estimate_terms(law, b_and_a, state_of(loop, "theta_hat"), values["Gamma"])
    terms += estimate_terms(
        rho_law, 1 / b_m, state_of(loop, "rho_hat"), values["gamma"], sign * b_m
    )
    sample = with_inverse_of(law, rho_law, sign)
    if not known:
        D_law = claim_of(values, "D_hat", 1)
        terms += estimate_terms(D_law, split.needed, state_of(loop, "D_hat"), values["gamma_D"])
        (unit,) = ca.substitute([split.needed], [constants[-1]], [1])  # D is this times delta^2
        sample = with_radius_of(sample, D_law, math.sqrt(2 * float(unit)))
    return Certificate(
        loop,
        constants,
        terms,
        PerturbationSet(
            delta,
            (False,) * (m + 1) + (True,) * n,
            first=m + 1,
            delta_1=delta_1,
            offset=offset,
            free_delta=not known,
        ),
        sample,
        _coordinates(loop, b_and_a, xi, Omega_T, None if known else split.needed),
    )


@dataclass(frozen=True)
class _Split:
    """How the square of x_tilde_2 - Delta_1 y + d_1 is split, which V' holds sum 1/(4 d_i) times.

    Attributes
    ----------
    weight : float
        Of V_xtilde in V.
    decay : float
        Of |x_tilde|^2 in the claimed rate.
    needed : casadi.SX
        The damping of z_1 that it asks for: all of zeta_1, where the radius is estimated.
    spent : float
        Of c_1, what the damping of the law lacks of it.
    residue : casadi.SX
        What the reference and the disturbance leave of V'.
    """

    weight: float
    decay: float
    needed: ca.SX
    spent: float
    residue: ca.SX


def _split(loop: ClosedLoop, g: float, delta: ca.SX | float, leaking: bool) -> _Split:
    """Young's inequality with free numbers s, q, q_d and nu (docs/theory.md).

    (x_tilde_2 - Delta_1 y + d_1)^2 <= (1 + s) |x_tilde|^2 + (1 + 1/s) (Delta_1 y - d_1)^2, the
    weight (1 + s + nu) sum 1/(4 d_i) of V_xtilde makes -nu |x_tilde|^2 of the first part, and
    squares of sums with y_r in y, or with d, are split with 1 + q, or 1 + q_d. The least damping
    is that of s = delta_1/(g delta), but a disturbance then leaves the more, the smaller delta_1
    is: there, and where the radius is not known, s = 1/g. Under leakage half of c_1 pays for
    nu > 0, so that V falls in all its parts. The printed damping (59) is judged by s = 0.
    """
    values = loop.values
    D = float(np.sum(1 / (4 * values["d"])))
    yr, d = loop.opened("reference"), loop.opened("disturbance")
    known = "delta" in values
    delta_1 = values["delta_1"].item() if known else delta
    q = values["q"].item() if "q" in values else 1.0
    q_d = values["q_d"].item() if "q_d" in values else 1.0
    share = 1 + q if yr.numel() else 1.0
    disturbed = "q_d" in values or (not known and bool(d.numel()))
    if disturbed:
        share *= 1 + q_d
    K: ca.SX | float
    if disturbed or not known:
        s, K = 1 / g, (1 + g) * (delta_1**2 + g * delta**2)
    else:
        s = float(delta_1 / (g * delta)) if delta > 0 else 0.0
        K = (g * delta + delta_1) ** 2
    spent = nu = 0.0
    if known and not values["corrected"].item():
        s, leaking = (1 / g if disturbed else 0.0), False
    if leaking:
        nu, more = 1.0, share * D * g**2 * delta**2
        if known and more > 0:
            spent = values["c"].ravel()[0] / 2
            nu = spent / more
        K += nu * g**2 * delta**2
    needed = ca.SX(share * D * K)
    residue = ca.SX(0)
    if yr.numel():
        residue += needed / q * yr[0] ** 2
    if disturbed:
        split = (1 + 1 / s) + (1 + s + nu) * g**2
        residue += D * split * (1 + 1 / q_d) * ca.sumsqr(d)
    return _Split((1 + s + nu) * D, nu * D, needed, spent, residue)


def _coordinates(
    loop: ClosedLoop, ell: ca.SX, xi: ca.SX, Omega_T: ca.SX, D: ca.SX | None
) -> Coordinates:
    """States from z, x_tilde, the errors of the estimates, eta and lambda_1 .. lambda_m.

    Row 1 of x = xi + Omega^T ell + x_tilde holds lambda_{m+1} with coefficient b_m, and z_i,
    i >= 2, holds lambda_{m+i} with coefficient 1, (46): they give the rest of lambda one by one,
    then x.
    """
    z, n = loop.bound_signal("controller.z"), int(loop.values["k"].size)
    rho = z.numel()
    m = n - rho
    sizes = {"z": rho, "x_tilde": n, "error": m + 1 + n, "rho_error": 1, "eta": n, "lambda": m}
    sizes |= {e.variables.name: e.variables.symbol.numel() for e in loop.external}
    sizes |= {} if D is None else {"D_error": 1}
    free = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    solved = {
        "theta_hat": ell + free["error"],
        "rho_hat": 1 / ell[0] + free["rho_error"],
        "eta": free["eta"],
    }
    solved |= {entry.variables.name: free[entry.variables.name] for entry in loop.external}
    if D is not None:
        solved["D_hat"] = D + free["D_error"]
    own = {s.variables.name: s.variables.symbol for s in loop.controller.states}
    own |= {entry.variables.name: entry.variables.symbol for entry in loop.external}
    y = free["z"][0] + (free["yr"][0] if loop.opened("reference").numel() else 0)  # (45)
    state = xi + Omega_T @ ell + free["x_tilde"]
    full = ca.vertcat(free["lambda"], ca.SX.zeros(rho))
    for i in range(rho):
        (rest,) = ca.substitute(
            [state[0] - y if i == 0 else z[i]],
            [state_of(loop, "x"), own["lambda"], *(own[name] for name in solved)],
            [ca.vertcat(y, ca.SX.zeros(n - 1)), full, *solved.values()],
        )
        full[m + i] = -rest / ell[0] if i == 0 else free["z"][i] - rest
    (state,) = ca.substitute([state], [own["eta"], own["lambda"]], [free["eta"], full])
    state[0] = y  # to the bit
    X = stacked(loop, {"x": state, "lambda": full, **solved})
    return Coordinates(ca.vertcat(*free.values()), X, tuple(sizes.values()))


def _filter_signals(loop: ClosedLoop, m: int) -> tuple[ca.SX, ca.SX]:
    """xi and Omega^T of (30), (31)."""
    eta, lambda_ = (loop.state("controller", name) for name in ("eta", "lambda"))
    gains = {g.variables.name: g.variables for g in loop.controller.gains}
    k_filter = KFilter(m, eta, lambda_, gains["k"])
    xi, Omega_T = loop.bind([k_filter.xi, k_filter.Omega_T])
    return xi, Omega_T


def _estimation_error_function(values: Mapping[str, Matrix], rho: int) -> tuple[Matrix, float]:
    """(P, g): V_xtilde = x_tilde^T P x_tilde has V_xtilde' <= -|x_tilde|^2 + g^2 |F^T Delta|^2.

    For the gain of the ISS filter the r^2 X^-1 and r epsilon of (42), b constant; for any other by
    the bounded real lemma, if the filter's norm is at most g.
    """
    k = values["k"].ravel()
    if "filter_gain" in values:
        X, r, g = None, math.nan, values["filter_gain"].item()
    else:
        r, epsilon, Q = _iss_design(values, rho)
        X, g = iss_riccati(r, Q), r * epsilon
    if X is not None and np.allclose(X[:, 0] / 2, k):
        return r**2 * inverse(X), g
    P = filter_riccati(k, g)
    if P is None:
        raise InvalidInput(
            f"the K-filter lets through more of Delta than the damping counts with, {g:.9g}; "
            f"valid: at least its H-infinity norm, {filter_norm(k).item():.9g}"
        )
    return P, g


def _iss_design(values: Mapping[str, Matrix], rho: int) -> tuple[float, float, Matrix]:
    """r, epsilon (of a) and Q of (41)."""
    n, r = values["k"].size, values["r"].item()
    if "epsilon_b" not in values:
        epsilon = values["epsilon"].item()
        return r, epsilon, iss_weight(n, epsilon)
    epsilon = values["epsilon_a"].item()
    return r, epsilon, iss_weight(n, epsilon, values["epsilon_b"].item(), rho)
