"""The Lyapunov functions of the four designs, as certificates of their closed loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from congelation.errors import InvalidInput
from congelation.theory.certificate import Certificate, PerturbationSet
from congelation.theory.closed_loop import ClosedLoop
from congelation.theory.gains import filter_norm, filter_riccati, iss_riccati, iss_weight
from congelation.theory.kfilter import KFilter

__all__ = [
    "matched_certificate",
    "output_feedback_certificate",
    "scalar_certificate",
    "state_feedback_certificate",
]

Matrix = NDArray[np.float64]


def scalar_certificate(loop: ClosedLoop) -> Certificate:
    """(5): V = x^2/2 + (ell - theta_hat)^2/(2 gamma), claimed V' <= -k_bar x^2."""
    x, ell = _state(loop, "x"), _congealed(loop)
    V = x**2 / 2 + _estimation(loop, ell, loop.values["gamma"]) / 2
    claimed = loop.values["k_bar"].item() * x**2
    return Certificate(loop, ell, V, claimed, _ball(loop), _any(ell))


def matched_certificate(loop: ClosedLoop) -> Certificate:
    """V = x^T P x + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat), claimed V' <= -x^T Q x."""
    x, ell, values = _state(loop, "x"), _congealed(loop), loop.values
    V = _quadratic(values["P"], x) + _estimation(loop, ell, values["Gamma"])
    return Certificate(loop, ell, V, _quadratic(values["Q"], x), _ball(loop), _any(ell))


def state_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """V = |z|^2/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2, V' <= -sum c_i z_i^2 (23)."""
    z, ell, values = loop.bound_signal("controller.z"), _congealed(loop), loop.values
    V = ca.sumsqr(z) / 2 + _estimation(loop, ell, values["Gamma"]) / 2
    claimed = ca.sum1(ca.DM(values["c"]) * z**2)
    return Certificate(loop, ell, V, claimed, _ball(loop), _any(ell))


def output_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """The function of Proposition 2, with the weight of V_xtilde that the corrected damping needs.

    V = z^T z/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2
    + |b_m| (1/b_m - rho_hat)^2/(2 gamma) + (1 + delta_1/(g delta)) sum_i 1/(4 d_i) V_xtilde,
    where g is the filter's r epsilon; claimed V' <= -sum c_i z_i^2. The printed damping (59) is
    judged by the printed weight, sum_i 1/(4 d_i).
    """
    z, ell, values = loop.bound_signal("controller.z"), _congealed(loop), loop.values
    n = values["k"].size
    m = ell.numel() - n - 1
    x_tilde = _estimation_error(loop, m, ell)
    V_x_tilde, g = _estimation_error_function(values, n - m)

    delta, delta_1 = values["delta"].item(), values["delta_1"].item()
    corrected = bool(values["corrected"].item()) and delta > 0
    weight = (1 + delta_1 / (g * delta) if corrected else 1) * np.sum(1 / (4 * values["d"]))
    sign, rho_hat = values["sign_b_m"].item(), _state(loop, "rho_hat")
    V = (
        ca.sumsqr(z) / 2
        + _estimation(loop, ell, values["Gamma"]) / 2
        + sign * ell[0] * (1 / ell[0] - rho_hat) ** 2 / (2 * values["gamma"].item())
        + weight * _quadratic(V_x_tilde, x_tilde)
    )
    varies = (False,) * (m + 1) + (True,) * n
    perturbations = PerturbationSet(delta, varies, first=m + 1, delta_1=delta_1)
    claimed = ca.sum1(ca.DM(values["c"]) * z**2)

    def sample_ell(generator: np.random.Generator) -> Matrix:
        drawn = generator.normal(size=m + 1 + n)
        drawn[0] = sign * np.exp(drawn[0])  # Assumption 3
        return drawn

    return Certificate(loop, ell, V, claimed, perturbations, sample_ell)


def _estimation_error(loop: ClosedLoop, m: int, ell: ca.SX) -> ca.SX:
    """x_tilde = x - xi - Omega^T ell, (39)-(40)."""
    eta, lambda_ = (loop.state("controller", name) for name in ("eta", "lambda"))
    gains = {g.variables.name: g.variables for g in loop.controller.gains}
    k_filter = KFilter(m, eta, lambda_, gains["k"])
    xi, Omega_T = loop.bind([k_filter.xi, k_filter.Omega_T])
    return _state(loop, "x") - xi - Omega_T @ ell


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
        return r**2 * _inverse(X), g
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


def _congealed(loop: ClosedLoop) -> ca.SX:
    _, theta = loop.arguments
    return ca.SX.sym("ell", theta.numel())


def _estimation(loop: ClosedLoop, ell: ca.SX, Gamma: Matrix) -> ca.SX:
    """(ell - theta_hat)^T Gamma^-1 (ell - theta_hat)."""
    return _quadratic(_inverse(Gamma), ell - _state(loop, "theta_hat"))


def _quadratic(P: Matrix, v: ca.SX) -> ca.SX:
    return v.T @ ca.DM(P) @ v


def _inverse(P: Matrix) -> Matrix:
    return np.asarray(np.linalg.inv(P), dtype=float)


def _state(loop: ClosedLoop, name: str) -> ca.SX:
    side = "plant" if name == "x" else "controller"
    return loop.state(side, name).symbol


def _ball(loop: ClosedLoop) -> PerturbationSet:
    _, theta = loop.arguments
    return PerturbationSet(loop.values["delta"].item(), (True,) * theta.numel())


def _any(ell: ca.SX) -> Callable[[np.random.Generator], Matrix]:
    size = int(ell.numel())
    return lambda generator: np.asarray(generator.normal(size=size))
