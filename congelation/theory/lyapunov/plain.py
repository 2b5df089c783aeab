"""The certificates of the designs whose error variables are the state: scalar and matched."""

from __future__ import annotations

import casadi as ca
import numpy as np

from congelation.theory.adaptation import claim_of
from congelation.theory.certificate import Certificate, Coordinates, PerturbationSet, Terms
from congelation.theory.closed_loop import ClosedLoop
from congelation.theory.lyapunov.samplers import within
from congelation.theory.lyapunov.terms import (
    ball,
    estimate_terms,
    inverse,
    quadratic,
    stacked,
    state_of,
)

__all__ = ["matched_certificate", "scalar_certificate"]


def scalar_certificate(loop: ClosedLoop) -> Certificate:
    """(5): V = x^2/2 + (ell - theta_hat)^2/(2 gamma), claimed V' <= -k_bar x^2.

    Controller 2 is certified too, with ell = inf theta(t): V' = -k_bar x^2 - (theta - ell) x^2.
    """
    x, k_bar = state_of(loop, "x"), loop.values["k_bar"].item()
    of_x = Terms(x**2 / 2, k_bar * x**2, ca.SX(0), 2 * k_bar)
    return _of_x(loop, of_x, ball(loop, -np.ones(1)), loop.values["gamma"], 1)


def matched_certificate(loop: ClosedLoop) -> Certificate:
    """V = x^T P x + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat), claimed V' <= -x^T Q x.

    Of first order, V' holds 2 P B Delta x^2, so that Controller 2 is certified with an extreme ell.
    """
    x, P, Q = state_of(loop, "x"), loop.values["P"], loop.values["Q"]
    first_order = None
    if x.numel() == 1:
        (gain,) = loop.controller.gains
        first_order = np.sign(np.asarray(gain.constants["B"], float)).ravel()
    rate = float(np.linalg.eigvals(inverse(P) @ Q).real.min())
    of_x = Terms(quadratic(P, x), quadratic(Q, x), ca.SX(0), rate)
    return _of_x(loop, of_x, ball(loop, first_order), loop.values["Gamma"], 2)


def _of_x(
    loop: ClosedLoop,
    of_x: Terms,
    perturbations: PerturbationSet,
    gain: np.ndarray,
    weight: float,
) -> Certificate:
    """The certificate whose V is that of x, and `weight` times half the estimate's square."""
    x, theta_hat = state_of(loop, "x"), state_of(loop, "theta_hat")
    ell = ca.SX.sym("ell", theta_hat.numel())
    law = claim_of(loop.values, "theta_hat", theta_hat.numel())
    terms = of_x + estimate_terms(law, ell, theta_hat, gain, weight)
    drawn, error = ca.SX.sym("x", x.numel()), ca.SX.sym("error", theta_hat.numel())
    X = stacked(loop, {"x": drawn, "theta_hat": ell + error})
    return Certificate(
        loop,
        ell,
        terms,
        perturbations,
        within(law),
        Coordinates(ca.vertcat(drawn, error), X, (drawn.numel(), error.numel())),
    )
