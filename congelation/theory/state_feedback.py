"""Adaptive backstepping by state feedback with congealed parameters (Sec. III), any n and p.

One recursion serves the paper's law and what goes beyond it, see `Options`: each option adds rows
to the regressor, or damping, and none replaces the recursion (docs/theory.md, "Beyond the paper").
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from congelation.errors import InvalidInput
from congelation.theory.adaptation import Adaptation, AdaptationFactory, Joint, gradient
from congelation.theory.expressions import known_variations
from congelation.theory.matrices import upper_shift
from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    Variables,
    control,
)
from congelation.theory.options import Options
from congelation.theory.state_feedback_factors import (
    control_factor,
    disturbance_damping,
    drift_factor,
    parameter_damping,
    reference_damping,
    regressor_factor,
    state_factor,
    time_factor,
)
from congelation.theory.state_feedback_symbols import (
    Partial,
    StateFeedbackStep,
    StateFeedbackSymbols,
)
from congelation.theory.strict_feedback import SYSTEM_60, Regressors, regressors_of

__all__ = [
    "StateFeedbackDesign",
    "state_feedback_controller",
    "state_feedback_design",
    "state_feedback_model",
]


SMALLEST_SQUARE = 1e-12
"""Added to |w_i|^2, so that the bound estimator's regressor |w_i| tanh(|w_i| z_i/eta) is smooth."""

START_OF_ETA = 0.1
"""Default of the start value of eta, for errors of size 1."""


@dataclass(frozen=True)
class StateFeedbackDesign:
    """The whole derivation: its symbols, the law of the estimates, and the steps 1 .. n."""

    regressors: Regressors
    options: Options
    symbols: StateFeedbackSymbols
    adaptation: Adaptation
    rho_adaptation: Adaptation | None
    factors: tuple[ca.SX | ca.DM, ...]
    Upsilon: ca.SX | None
    steps: tuple[StateFeedbackStep, ...]

    @property
    def z(self) -> ca.SX:
        """The error variables z of (12), shape (n, 1)."""
        return ca.vertcat(*(step.z for step in self.steps))

    @property
    def W(self) -> ca.SX:
        """W = [v_1 .. v_n], shape (q, n), for which tau_n = W z and (20) holds."""
        return ca.horzcat(*(step.v for step in self.steps))

    @property
    def u(self) -> ca.SX:
        """u = alpha_n + y_r^(n), (19); for a varying gain rho_hat ubar."""
        symbols = self.symbols
        if symbols.rho_hat is not None:
            return -symbols.rho_hat.symbol * self.kappa * self.steps[-1].z
        if symbols.yr is None:
            return self.steps[-1].alpha
        return self.steps[-1].alpha + symbols.yr.symbol[-1]

    @property
    def kappa(self) -> ca.SX:
        """kappa of ubar = -kappa z_n: the control alpha_n + y_r^(n) = f z + h [y_r; ..] dominated.

        Each f_k z_k by Young's inequality with half of c_k, so that ubar opposes z_n and b(t) may
        be any size.
        """
        symbols = self.symbols
        n, row = symbols.x.symbol.numel(), control_factor(symbols, self.steps)
        f, h = row[:n], row[n:]
        kappa = ca.sqrt(1 + f[n - 1] ** 2)
        for k in range(n - 1):
            kappa += f[k] ** 2 / (2 * symbols.c.symbol[k])
        if symbols.epsilon_b is not None:
            kappa += (ca.sumsqr(h) + 1) / (2 * symbols.epsilon_b.symbol**2)  # 1: of y_r^(n)
        return kappa

    @property
    def estimate_rates(self) -> tuple[ca.SX, ...]:
        """The rates of theta_hat, and of D_hat, eta, rho_hat and t where there are such.

        theta_hat' of (19) is Gamma chi(theta_hat, tau_n); the gradient law has chi = tau.
        """
        symbols = self.symbols
        p = symbols.theta_hat.symbol.numel()
        rates = symbols.estimate_gain @ self.adaptation.rate(self.steps[-1].tau)
        found = [rates[:p]] if symbols.D_hat is None else [rates[:p], rates[p]]
        if symbols.eta is not None and symbols.decay is not None:
            found.append(-symbols.decay.symbol * symbols.eta.symbol)
        if self.rho_adaptation is not None and symbols.sign_b is not None and symbols.gamma:
            z_n, law = self.steps[-1].z, self.rho_adaptation
            regressor = law.regressor(symbols.sign_b.symbol * self.kappa * z_n, z_n)
            found.append(symbols.gamma.symbol * law.rate(regressor * z_n))
        if symbols.t is not None:
            found.append(ca.SX(1))
        return tuple(found)

    @property
    def theta_hat_rate(self) -> ca.SX:
        """theta_hat' of (19)."""
        return self.estimate_rates[0]


def state_feedback_design(
    phibar: ArrayLike | Regressors = SYSTEM_60,
    adaptation: AdaptationFactory = gradient,
    options: Options | None = None,
) -> StateFeedbackDesign:
    """Run the recursion (11)-(19) with the damping (26).

    Parameters
    ----------
    phibar : array_like, shape (n, n, p), or Regressors
        The plant (9), see `congelation.theory.strict_feedback.regressors_of`.
    adaptation : callable
        The law of the estimates, see `congelation.theory.adaptation`.
    options : Options, optional
        What the law copes with; None: the paper's.

    Raises
    ------
    InvalidInput
        Regressors that are none, or options that exclude each other.
    """
    regressors, chosen = regressors_of(phibar), options or Options()
    if chosen.bound_estimator and (chosen.varying_gain or chosen.unknown_radius):
        raise InvalidInput(
            "law = 'bound-estimator' excludes gain = 'varying', which needs the factors of the "
            "damping, and radius = 'estimated', because it estimates the radius itself "
            "(docs/rivals.md)"
        )
    n, p = regressors.orders
    symbols = StateFeedbackSymbols.of(n, p, chosen)
    Upsilon = None
    if symbols.t is not None:
        Upsilon = known_variations(chosen.Upsilon, p, n, symbols.t.symbol)
    law = adaptation(symbols.theta_hat, symbols.Gamma.symbol, n)
    rho_law = None
    if symbols.rho_hat is not None and symbols.gamma is not None:
        rho_law = law.companion(symbols.rho_hat, symbols.gamma.symbol)
    if symbols.D_hat is not None and symbols.gamma_D is not None:
        size = len(symbols.theta_hat.names)
        law = Joint(law, law.companion(symbols.D_hat, symbols.gamma_D.symbol), size)
    factors = regressors.factors(symbols.x.symbol)
    design = StateFeedbackDesign(
        regressors, chosen, symbols, law, rho_law, factors, Upsilon, steps=()
    )
    for _ in range(n):
        design = replace(design, steps=(*design.steps, _step(design)))
    return design


def _step(design: StateFeedbackDesign) -> StateFeedbackStep:
    """Step i of the recursion, where `design` holds the steps 1 .. i - 1."""
    symbols, law, steps = design.symbols, design.adaptation, design.steps
    x, estimates, Gamma = symbols.x.symbol, symbols.estimates, symbols.estimate_gain
    n, i = x.numel(), len(steps) + 1
    z_before, alpha_before, tau_before = _before(design)
    yr = ca.SX(0, 1) if symbols.yr is None else symbols.yr.symbol

    z = x[i - 1] - alpha_before  # (12)
    if symbols.yr is not None:
        z -= yr[i - 1]
    eta = ca.SX(0, 1) if symbols.eta is None else symbols.eta.symbol
    t = ca.SX(0, 1) if symbols.t is None else symbols.t.symbol
    dalpha = _gradient(alpha_before, x, estimates, yr, eta, t)
    m = _e(i, n) - dalpha.x  # what multiplies x', and so a disturbance, in z_i'
    w = ca.horzcat(*design.regressors.at(x)) @ m.T  # (13)
    v = w if design.Upsilon is None else design.Upsilon.T @ w
    zeta, T, drift, E, wbar, vbar = (symbols.row() for _ in range(6))
    if symbols.epsilon_d is not None:
        zeta[:n] += disturbance_damping(symbols, (*(s.m for s in steps), m))
    if symbols.eta is not None:  # no damping (26), so no factors either
        size = ca.sqrt(ca.sumsqr(w) + SMALLEST_SQUARE)
        v = ca.vertcat(v, symbols.damping.symbol * size * ca.tanh(size * z / symbols.eta.symbol))
    else:
        T, E = state_factor(symbols, steps), time_factor(symbols, steps)
        drift = drift_factor(symbols, steps, law)
        wbar = regressor_factor(design.factors, ca.vertcat(*(s.T for s in steps), T), dalpha.x)
        vbar = wbar if design.Upsilon is None else design.Upsilon.T @ wbar
        mixed = (*(s.wbar for s in steps), wbar)
        zeta[:n] += parameter_damping(symbols, tuple(rows[:, :n] for rows in mixed))
        if symbols.epsilon_r is not None:
            zeta[:n] += reference_damping(symbols, tuple(rows[:, n:] for rows in mixed))
        if symbols.D_hat is not None:  # the regressor of D_hat is z_i, in Controller 1 alone
            v = ca.vertcat(v, symbols.damping.symbol * z)
            vbar = ca.vertcat(vbar, symbols.damping.symbol * symbols.row(i - 1))

    regressor = law.regressor(v, z)
    tau = tau_before + regressor * z  # (14)
    slope = law.slope(tau_before, tau, regressor)
    mu = _correction(steps, Gamma @ slope, symbols.row())
    z_all = ca.vertcat(*(s.z for s in steps), z)
    alpha = (  # (15)
        -z_before
        - symbols.c.symbol[i - 1] * z
        + dalpha.x @ (ca.DM(upper_shift(n)) @ x)
        - v.T @ estimates
        + dalpha.estimates @ Gamma @ law.rate(tau)
        + (mu + zeta)[:i] @ z_all
    )
    if symbols.yr is not None:
        alpha += dalpha.yr[:n] @ yr[1:]
    if symbols.eta is not None and symbols.decay is not None:
        alpha -= dalpha.eta * symbols.decay.symbol * symbols.eta.symbol
    if symbols.t is not None:
        alpha += dalpha.t
    return StateFeedbackStep(
        z, alpha, m, w, wbar, v, vbar, tau, slope, mu, zeta, dalpha, T, drift, E
    )


def _before(design: StateFeedbackDesign) -> tuple[ca.SX, ca.SX, ca.SX]:
    """z_{i-1}, alpha_{i-1} and tau_{i-1}; all zero at the first step, (11) and (15)."""
    if not design.steps:
        return ca.SX(0), ca.SX(0), ca.SX.zeros(design.symbols.estimates.numel())
    last = design.steps[-1]
    return last.z, last.alpha, last.tau


def _gradient(alpha: ca.SX, *symbols: ca.SX) -> Partial:
    """The partial derivatives of alpha with respect to x, .., t, from one reverse sweep."""
    ends = np.cumsum([0, *(v.numel() for v in symbols)]).tolist()
    return Partial(*ca.horzsplit(ca.jacobian(alpha, ca.vertcat(*symbols)), ends))


def _correction(steps: tuple[StateFeedbackStep, ...], step_rate: ca.SX, row: ca.SX) -> ca.SX:
    """mu_i of (17) as a row: coefficient j is -sigma_{j,i}, 2 <= j <= i - 1.

    -sigma_{j,i} = (d alpha_{j-1}/d theta_hat) Gamma w_i; a modified law has its slope for w_i.
    """
    for j, step in enumerate(steps):
        row[j] = step.dalpha.estimates @ step_rate
    return row


def _e(i: int, n: int) -> ca.SX:
    """e_i^T."""
    row = ca.SX(1, n)
    row[i - 1] = 1
    return row


def state_feedback_controller(
    phibar: ArrayLike | Regressors = SYSTEM_60,
    adaptation: AdaptationFactory = gradient,
    options: Options | None = None,
) -> Model:
    """The controller (19) as a block: Controller 1 with the damping (26), or Controller 2 without.

    Parameters
    ----------
    phibar, adaptation, options
        See `state_feedback_design`.
    """
    return state_feedback_model(state_feedback_design(phibar, adaptation, options))


def state_feedback_model(design: StateFeedbackDesign) -> Model:
    """The block of a derivation, on the symbols of that derivation."""
    symbols, options = design.symbols, design.options
    (n, p), q = design.regressors.orders, symbols.theta_hat.symbol.numel()
    own = (
        (symbols.c, (1.0,) * n, Domain.POSITIVE),
        (symbols.Gamma, tuple(np.eye(q).ravel()), Domain.POSITIVE_DEFINITE),
        (symbols.epsilon, (1.0,), Domain.POSITIVE),
        (symbols.delta, (1.0,), Domain.NONNEGATIVE),
        (symbols.epsilon_r, (1.0,), Domain.POSITIVE),
        (symbols.epsilon_d, (1.0,), Domain.POSITIVE),
        (symbols.gamma_D, (1.0,), Domain.POSITIVE),
        (symbols.decay, (0.0,), Domain.NONNEGATIVE),
        (symbols.gamma, (1.0,), Domain.POSITIVE),
        (symbols.epsilon_b, (1.0,), Domain.POSITIVE),
        (symbols.sign_b, (1.0,), Domain.SIGN),
        (symbols.damping, (1.0,), Domain.BOOLEAN),
    )
    laws = (design.adaptation, design.rho_adaptation)
    states = (symbols.theta_hat, symbols.D_hat, symbols.eta, symbols.rho_hat)
    estimates = [v for v in states if v is not None]
    moving = [*estimates, *(() if symbols.t is None else (symbols.t,))]
    also = f" ({options})" if str(options) else ""
    return Model(
        name="StateFeedbackController",
        description=f"State feedback controller (19) for the plant (9), n = {n}, p = {p}{also}",
        inputs=(
            Input.of(symbols.x),
            *(Input.of(v, "reference") for v in (symbols.yr,) if v is not None),
        ),
        states=tuple(
            State(v, rate, start=(START_OF_ETA if v is symbols.eta else 0.0,) * v.symbol.numel())
            for v, rate in zip(moving, design.estimate_rates, strict=True)
        ),
        parameters=(
            *(Parameter(v, default, domain) for v, default, domain in own if v is not None),
            *(q for law in laws if law is not None for q in law.parameters),
        ),
        outputs=(
            control(design.u, "Control u = alpha_n of (19)"),
            *(Output(v) for v in estimates),
            Output(Variables("z", design.z, "Error variables z of (12)")),
        ),
        Upsilon=design.Upsilon,
    )
