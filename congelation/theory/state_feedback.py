"""Adaptive backstepping by state feedback with congealed parameters (Sec. III), any n and p."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.theory.adaptation import Adaptation, AdaptationFactory, gradient
from congelation.theory.gains import upper_shift
from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    Variables,
    matrix,
    scalar,
    vector,
)
from congelation.theory.strict_feedback import SYSTEM_60, checked_phibar, regressors

__all__ = [
    "StateFeedbackDesign",
    "StateFeedbackStep",
    "StateFeedbackSymbols",
    "state_feedback_controller",
    "state_feedback_design",
    "state_feedback_model",
]


@dataclass(frozen=True)
class StateFeedbackSymbols:
    """The symbols that the law is a function of."""

    x: Variables
    theta_hat: Variables
    c: Variables
    Gamma: Variables
    epsilon: Variables
    delta: Variables
    damping: Variables


@dataclass(frozen=True)
class StateFeedbackStep:
    """Step i of the recursion. Rows multiply the whole of z, with zeros beyond z_i.

    Attributes
    ----------
    z, alpha : casadi.SX, (1, 1)
        z_i of (12) and alpha_i of (15).
    w, wbar : casadi.SX, (p, 1), (p, n)
        w_i of (13); column j of wbar is wbar_{i,j} of (25): w_i = wbar z.
    tau, slope : casadi.SX, (p, 1)
        tau_i of (14), and the slope of the adaptation law there (w_i for the gradient law).
    mu, zeta : casadi.SX, (1, n)
        The corrections mu_i = mu z of (17), and the damping zeta_i = zeta z of (18).
    dalpha_dx, dalpha_dtheta : casadi.SX, (1, n), (1, p)
        Partial derivatives of alpha_{i-1} with respect to x and theta_hat.
    T : casadi.SX, (1, n)
        x_i = T z; T depends on (x_1 .. x_{i-1}, theta_hat).
    drift : casadi.SX, (1, n)
        (d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) = drift z; zero for the gradient law.
    """

    z: ca.SX
    alpha: ca.SX
    w: ca.SX
    wbar: ca.SX
    tau: ca.SX
    slope: ca.SX
    mu: ca.SX
    zeta: ca.SX
    dalpha_dx: ca.SX
    dalpha_dtheta: ca.SX
    T: ca.SX
    drift: ca.SX


@dataclass(frozen=True)
class StateFeedbackDesign:
    """The whole derivation: its symbols, the law of the estimates, and the steps 1 .. n."""

    phibar: NDArray[np.float64]
    symbols: StateFeedbackSymbols
    adaptation: Adaptation
    steps: tuple[StateFeedbackStep, ...]

    @property
    def z(self) -> ca.SX:
        """The error variables z of (12), shape (n, 1)."""
        return ca.vertcat(*(step.z for step in self.steps))

    @property
    def W(self) -> ca.SX:
        """W = [w_1 .. w_n], shape (p, n), for which tau_n = W z and (20) holds."""
        return ca.horzcat(*(step.w for step in self.steps))

    @property
    def u(self) -> ca.SX:
        """u = alpha_n, (19)."""
        return self.steps[-1].alpha

    @property
    def theta_hat_rate(self) -> ca.SX:
        """theta_hat' of (19): Gamma chi(theta_hat, tau_n), where the gradient law has chi = tau."""
        return self.symbols.Gamma.symbol @ self.adaptation.rate(self.steps[-1].tau)


def state_feedback_design(
    phibar: ArrayLike = SYSTEM_60, adaptation: AdaptationFactory = gradient
) -> StateFeedbackDesign:
    """Run the recursion (11)-(19) with the damping (26).

    Parameters
    ----------
    phibar : array_like, shape (n, n, p)
        The plant (9), see `congelation.theory.strict_feedback.checked_phibar`.
    adaptation : callable
        The law of the estimates, see `congelation.theory.adaptation`.
    """
    checked = checked_phibar(phibar)
    n, _, p = checked.shape
    symbols = StateFeedbackSymbols(
        x=vector("x", n, "State x of the plant (9)"),
        theta_hat=vector("theta_hat", p, "Estimate of theta, (19)"),
        c=vector("c", n, "Decay rates c_i of (15)"),
        Gamma=matrix("Gamma", p, p, "Adaptation gain of (19)"),
        epsilon=scalar("epsilon", "Weight in Young's inequality, (26)"),
        delta=scalar("delta", "Radius of theta(t), Assumption 1"),
        damping=scalar("damping", "True: Controller 1, with damping; false: Controller 2"),
    )
    law = adaptation(symbols.theta_hat, symbols.Gamma.symbol, n)
    design = StateFeedbackDesign(checked, symbols, law, steps=())
    for _ in range(n):
        design = replace(design, steps=(*design.steps, _step(design)))
    return design


def _step(design: StateFeedbackDesign) -> StateFeedbackStep:
    """Step i of the recursion, where `design` holds the steps 1 .. i - 1."""
    symbols, law, steps = design.symbols, design.adaptation, design.steps
    x, theta_hat, Gamma = symbols.x.symbol, symbols.theta_hat.symbol, symbols.Gamma.symbol
    n, i = x.numel(), len(steps) + 1
    z_before, alpha_before, tau_before = _before(design)

    z = x[i - 1] - alpha_before  # (12)
    dalpha_dx, dalpha_dtheta = _gradient(alpha_before, x, theta_hat)
    phi = ca.horzcat(*regressors(design.phibar, x))
    w = phi @ (_unit(i, n) - dalpha_dx).T  # (13)
    regressor = law.regressor(w, z)
    tau = tau_before + regressor * z  # (14)
    slope = law.slope(tau_before, tau, regressor)

    T, drift = _state_factor(design), _drift_factor(design)
    wbar = _regressor_factor(design.phibar, ca.vertcat(*(s.T for s in steps), T), dalpha_dx)
    mu = _correction(steps, Gamma @ slope, n)
    zeta = _damping(symbols, (*(s.wbar for s in steps), wbar))
    z_all = ca.vertcat(*(s.z for s in steps), z)
    alpha = (  # (15)
        -z_before
        - symbols.c.symbol[i - 1] * z
        + dalpha_dx @ (ca.DM(upper_shift(n)) @ x)
        - w.T @ theta_hat
        + dalpha_dtheta @ Gamma @ law.rate(tau)
        + (mu + zeta)[:i] @ z_all
    )
    return StateFeedbackStep(
        z, alpha, w, wbar, tau, slope, mu, zeta, dalpha_dx, dalpha_dtheta, T, drift
    )


def _before(design: StateFeedbackDesign) -> tuple[ca.SX, ca.SX, ca.SX]:
    """z_{i-1}, alpha_{i-1} and tau_{i-1}; all zero at the first step, (11) and (15)."""
    if not design.steps:
        return ca.SX(0), ca.SX(0), ca.SX.zeros(design.symbols.theta_hat.symbol.numel())
    last = design.steps[-1]
    return last.z, last.alpha, last.tau


def _gradient(alpha: ca.SX, x: ca.SX, theta_hat: ca.SX) -> tuple[ca.SX, ca.SX]:
    """d alpha/dx and d alpha/d theta_hat, as rows, from one reverse sweep."""
    both = ca.jacobian(alpha, ca.vertcat(x, theta_hat))
    return both[:, : x.numel()], both[:, x.numel() :]


def _correction(steps: tuple[StateFeedbackStep, ...], step_rate: ca.SX, n: int) -> ca.SX:
    """mu_i of (17) as a row: coefficient j is -sigma_{j,i}, 2 <= j <= i - 1.

    -sigma_{j,i} = (d alpha_{j-1}/d theta_hat) Gamma w_i; a modified law has its slope for w_i.
    """
    row = ca.SX(1, n)
    for j, step in enumerate(steps):
        row[j] = step.dalpha_dtheta @ step_rate
    return row


def _damping(symbols: StateFeedbackSymbols, wbar: tuple[ca.SX, ...]) -> ca.SX:
    """Row i of A_zeta of (22), the lower triangular solution of (26).

    zeta_{i,k} = -g_{i,k} / epsilon^2 for k < i and half the diagonal of (26) for k = i, where
    g_{i,k} = sum_j wbar_{i,j} . wbar_{k,j} is element (i, k) of Wbar^T Wbar.
    """
    epsilon, delta = symbols.epsilon.symbol, symbols.delta.symbol
    n, i = symbols.x.symbol.numel(), len(wbar)
    row = ca.SX(1, n)
    for k, other in enumerate(wbar):
        row[k] = -ca.sum1(ca.sum2(wbar[-1] * other)) / epsilon**2
    row[i - 1] = (row[i - 1] - epsilon**2 * delta**2) / 2
    return symbols.damping.symbol * row


def _regressor_factor(phibar: NDArray[np.float64], T: ca.SX, dalpha_dx: ca.SX) -> ca.SX:
    """wbar_i of Lemma 1: (13) with x = T z, where T has the rows 1 .. i."""
    i, n = T.shape
    factor = ca.SX(phibar.shape[2], n)
    for j in range(i):
        weight = 1 if j == i - 1 else -dalpha_dx[j]
        factor += weight * (ca.DM(phibar[j, : j + 1].T) @ T[: j + 1, :])
    return factor


def _state_factor(design: StateFeedbackDesign) -> ca.SX:
    """Row i of T in x = T z: x_i = z_i + alpha_{i-1}, and every term of (15) holds a z_j."""
    symbols, steps = design.symbols, design.steps
    n, i = symbols.x.symbol.numel(), len(steps) + 1
    row = _unit(i, n)
    if not steps:
        return row
    last = steps[-1]  # alpha_{i-1} is made of the quantities of step i - 1
    row -= symbols.c.symbol[i - 2] * _unit(i - 1, n) + symbols.theta_hat.symbol.T @ last.wbar
    if i > 2:
        row -= _unit(i - 2, n)
    for j in range(i - 2):
        row += last.dalpha_dx[j] * steps[j + 1].T
    for j, step in enumerate(steps):
        row[j] += last.dalpha_dtheta @ symbols.Gamma.symbol @ step.slope
    return row + last.drift + last.mu + last.zeta


def _drift_factor(design: StateFeedbackDesign) -> ca.SX:
    """(d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) as a row that multiplies z.

    With alpha_{i-1} = f z, f = T - e_i, and d z_k/d theta_hat = -d alpha_{k-1}/d theta_hat.
    """
    symbols, steps = design.symbols, design.steps
    theta_hat, n = symbols.theta_hat.symbol, symbols.x.symbol.numel()
    rate = symbols.Gamma.symbol @ design.adaptation.rate(ca.SX.zeros(theta_hat.numel()))
    if rate.is_zero() or not steps:
        return ca.SX(1, n)
    f = _state_factor(design) - _unit(len(steps) + 1, n)
    row = ca.jtimes(f.T, theta_hat, rate).T
    for k, step in enumerate(steps):
        row -= f[k] * step.drift
    return row


def _unit(i: int, n: int) -> ca.SX:
    """e_i^T."""
    row = ca.SX(1, n)
    row[i - 1] = 1
    return row


def state_feedback_controller(
    phibar: ArrayLike = SYSTEM_60, adaptation: AdaptationFactory = gradient
) -> Model:
    """The controller (19) as a block: Controller 1 with the damping (26), or Controller 2 without.

    Parameters
    ----------
    phibar, adaptation
        See `state_feedback_design`.
    """
    return state_feedback_model(state_feedback_design(phibar, adaptation))


def state_feedback_model(design: StateFeedbackDesign) -> Model:
    """The block of a derivation, on the symbols of that derivation."""
    symbols = design.symbols
    n, p = symbols.x.symbol.numel(), symbols.theta_hat.symbol.numel()
    return Model(
        name="StateFeedbackController",
        description=f"State feedback controller (19) for the plant (9), n = {n}, p = {p}",
        inputs=(Input.of(symbols.x),),
        states=(State(symbols.theta_hat, design.theta_hat_rate, start=(0.0,) * p),),
        parameters=(
            Parameter(symbols.c, (1.0,) * n, Domain.POSITIVE),
            Parameter(symbols.Gamma, tuple(np.eye(p).ravel()), Domain.POSITIVE_DEFINITE),
            Parameter(symbols.epsilon, (1.0,), Domain.POSITIVE),
            Parameter(symbols.delta, (1.0,), Domain.NONNEGATIVE),
            Parameter(symbols.damping, (1.0,), Domain.BOOLEAN),
            *design.adaptation.parameters,
        ),
        outputs=(
            Output(
                Variables("u", design.u, "Control u = alpha_n of (19)", indexed=False),
                differentiated=True,
            ),
            Output(symbols.theta_hat),
            Output(Variables("z", design.z, "Error variables z of (12)")),
        ),
    )
