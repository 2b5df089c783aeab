"""The certificate of state feedback, with whatever a law copes with beyond the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from congelation.theory.adaptation import claim_of
from congelation.theory.certificate import Certificate, Coordinates, PerturbationSet, Terms
from congelation.theory.closed_loop import ClosedLoop
from congelation.theory.lyapunov.samplers import (
    Sampler,
    with_bound_of,
    with_gain_of,
    with_radius_of,
    within,
)
from congelation.theory.lyapunov.terms import ball, estimate_terms, stacked, state_of

__all__ = ["state_feedback_certificate"]

LARGEST_GAP = 0.27847
"""The largest a (1 - tanh a), rounded up."""


def state_feedback_certificate(loop: ClosedLoop) -> Certificate:
    """V = |z|^2/2 + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat)/2, V' <= -sum c_i z_i^2 (23).

    A varying gain adds |ell_b| (1/ell_b - rho_hat)^2/(2 gamma) to V, ell_b = sign_b inf |b(t)|,
    and halves c_1 .. c_{n-1}; an unknown radius adds (D - D_hat)^2/(2 gamma_D) to V, where
    D = epsilon^2 delta^2/2. What is left of V' is `_residue`.

    Of first order, V' holds (phibar . Delta) z^2, so that Controller 2 is certified with an extreme
    ell, for which that product is never positive.
    """
    values = loop.values
    names = [s.variables.name for s in loop.controller.states]
    z, theta_hat = loop.bound_signal("controller.z"), state_of(loop, "theta_hat")
    n, p = z.numel(), theta_hat.numel()
    known, varying_gain = "delta" in values, "rho_hat" in names
    ell = ca.SX.sym("ell", p + varying_gain + (not known))
    delta = ca.SX(values["delta"].item()) if known else ell[-1]

    rate = np.array(values["c"], dtype=float).ravel()
    if varying_gain:
        rate[:-1] /= 2
    law = claim_of(values, "theta_hat", p)
    terms = Terms(
        ca.sumsqr(z) / 2,
        ca.sum1(ca.DM(rate) * z**2),
        _residue(loop, delta, n),
        2 * float(rate.min()),
    )
    terms += estimate_terms(law, ell[:p], theta_hat, values["Gamma"])
    # Drawn are z, the errors of the estimates, and what comes from outside; `solved` has the
    # states that follow from them.
    drawn = {"z": ca.SX.sym("z", n), "error": ca.SX.sym("error", p)}
    solved = {"theta_hat": ell[:p] + drawn["error"]}
    perturbations, sample = ball(loop), within(law)
    if not known:
        radius = _radius_terms(loop, delta, sample)
        terms, sample = terms + radius.terms, radius.sample
        drawn, solved = drawn | radius.drawn, solved | radius.solved
    if varying_gain:
        gain = _gain_terms(loop, ell[p], p, sample)
        terms, sample = terms + gain.terms, gain.sample
        drawn, solved = drawn | gain.drawn, solved | gain.solved
        perturbations = _with_gain(loop, perturbations)
    nominal = None
    if loop.controller.Upsilon is not None:  # theta at Delta = 0 is Upsilon(t) vartheta
        nominal = ca.vertcat(loop.controller.Upsilon @ ell[:p], ell[p : p + varying_gain])
        solved["t"] = drawn["t"] = ca.SX.sym("t")
    for entry in loop.external:
        v = entry.variables
        solved[v.name] = drawn[v.name] = ca.SX.sym(v.name, v.symbol.numel())
    if n == 1 and names == ["theta_hat"] and not loop.external:
        perturbations = _of_first_order(loop)
    return Certificate(
        loop,
        ell,
        terms,
        perturbations,
        sample,
        Coordinates(
            ca.vertcat(*drawn.values()),
            _solved(loop, z, drawn["z"], solved),
            tuple(symbol.numel() for symbol in drawn.values()),
        ),
        nominal,
    )


@dataclass(frozen=True)
class _Estimate:
    """What one more estimate adds: to V, to what is drawn and the states that follow, to ell."""

    terms: Terms
    drawn: dict[str, ca.SX]
    solved: dict[str, ca.SX]
    sample: Sampler


def _radius_terms(loop: ClosedLoop, delta: ca.SX, sample: Sampler) -> _Estimate:
    """(D - D_hat)^2/(2 gamma_D), D = epsilon^2 delta^2/2, or delta for the bound estimator."""
    values, law = loop.values, claim_of(loop.values, "D_hat", 1)
    damped = "epsilon" in values
    D = values["epsilon"].item() ** 2 * delta**2 / 2 if damped else delta
    terms = estimate_terms(law, D, state_of(loop, "D_hat"), values["gamma_D"])
    drawn = {"D_error": ca.SX.sym("D_error")}
    solved = {"D_hat": D + drawn["D_error"]}
    if damped:
        return _Estimate(
            terms, drawn, solved, with_radius_of(sample, law, values["epsilon"].item())
        )
    drawn["root_of_eta"] = ca.SX.sym("root_of_eta")
    solved["eta"] = drawn["root_of_eta"] ** 2  # eta > 0
    return _Estimate(terms, drawn, solved, with_bound_of(sample, law))


def _gain_terms(loop: ClosedLoop, ell_b: ca.SX, place: int, sample: Sampler) -> _Estimate:
    """|ell_b| (1/ell_b - rho_hat)^2/(2 gamma), with ell_b at `place` of ell."""
    law, sign = claim_of(loop.values, "rho_hat", 1), loop.values["sign_b"].item()
    rho_hat, gamma = state_of(loop, "rho_hat"), loop.values["gamma"]
    drawn = {"root": ca.SX.sym("root")}
    return _Estimate(
        estimate_terms(law, 1 / ell_b, rho_hat, gamma, weight=sign * ell_b),
        drawn,
        {"rho_hat": sign * drawn["root"] ** 2},  # sign_b rho_hat >= 0 for ever
        with_gain_of(sample, place, law, sign),
    )


def _residue(loop: ClosedLoop, delta: ca.SX, n: int) -> ca.SX:
    """What V' may exceed -sum c_i z_i^2 by.

    A reference leaves epsilon_r^2 delta^2 |Y|^2/2, Y = [y_r; ..] up to order n - 1, and with a
    varying gain epsilon_b^2 |Y|^2/2, Y up to order n; a disturbance leaves epsilon_d^2 |d|^2/2;
    the bound estimator 0.27847 n eta delta, because a (1 - tanh a) is at most `LARGEST_GAP`.
    """
    values, residue = loop.values, ca.SX(0)
    yr, d = loop.opened("reference"), loop.opened("disturbance")
    if "epsilon_r" in values:
        residue += values["epsilon_r"].item() ** 2 * delta**2 * ca.sumsqr(yr[:n]) / 2
    if "epsilon_b" in values:
        residue += values["epsilon_b"].item() ** 2 * ca.sumsqr(yr) / 2
    if "epsilon_d" in values:
        residue += values["epsilon_d"].item() ** 2 * ca.sumsqr(d) / 2
    if "epsilon" not in values:
        residue += LARGEST_GAP * n * state_of(loop, "eta") * delta
    return residue


def _with_gain(loop: ClosedLoop, perturbations: PerturbationSet) -> PerturbationSet:
    """The same, where the last element of theta is an input gain."""
    _, theta = loop.arguments
    gain = theta.numel() - 1
    return replace(
        perturbations,
        varies=(True,) * gain + (False,),
        gain=gain,
        sign=loop.values["sign_b"].item(),
    )


def _of_first_order(loop: ClosedLoop) -> PerturbationSet:
    """The ball about an ell for which (phibar_{1,1} . Delta) z^2 is never positive."""
    X, theta = loop.arguments
    (slope_of_x,) = loop.bind([loop.rate[0]])
    (slope,) = ca.substitute([ca.jacobian(slope_of_x, theta)], [X[0]], [1])  # phibar_{1,1}
    return ball(loop, np.asarray(ca.DM(slope)).ravel())


def _solved(loop: ClosedLoop, z: ca.SX, wanted: ca.SX, solved: dict[str, ca.SX]) -> ca.SX:
    """The states at which the error variables are those wanted, from all but x.

    (12): z_i holds x_i with coefficient 1, and no x_j beyond it.
    """
    own = {s.variables.name: s.variables.symbol for s in loop.controller.states}
    own |= {entry.variables.name: entry.variables.symbol for entry in loop.external}
    x, rows = state_of(loop, "x"), ca.SX.zeros(*z.shape)
    for i in range(z.numel()):
        (rest,) = ca.substitute(
            [z[i]], [x, *(own[name] for name in solved)], [rows, *solved.values()]
        )
        rows[i] = wanted[i] - rest
    return stacked(loop, {"x": rows, **solved})
