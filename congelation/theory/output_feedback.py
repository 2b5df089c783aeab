"""Adaptive observer backstepping with congealed parameters (Sec. IV), any n and m."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from congelation.errors import InvalidInput
from congelation.theory.adaptation import Adaptation, AdaptationFactory, gradient
from congelation.theory.kfilter import FilterDesign, FilterFactory, KFilter, iss_filter, second_row
from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    Variables,
    control,
    vector,
)
from congelation.theory.observer_form import checked_orders
from congelation.theory.options import Options
from congelation.theory.output_feedback_symbols import (
    OutputFeedbackStep,
    OutputFeedbackSymbols,
    Partial,
)

__all__ = [
    "OutputFeedbackDesign",
    "output_feedback_controller",
    "output_feedback_design",
    "output_feedback_model",
]


@dataclass(frozen=True)
class OutputFeedbackDesign:
    """The whole derivation: symbols, filter, the law of the estimates, and the steps 1 .. rho."""

    symbols: OutputFeedbackSymbols
    filter: KFilter
    filter_design: FilterDesign
    adaptation: Adaptation
    rho_adaptation: Adaptation
    D_adaptation: Adaptation | None = None
    options: Options = field(default_factory=Options)
    steps: tuple[OutputFeedbackStep, ...] = ()

    @property
    def z(self) -> ca.SX:
        """The error variables z of (45)-(46), shape (rho, 1)."""
        return ca.vertcat(*(step.z for step in self.steps))

    @property
    def W_theta(self) -> ca.SX:
        """W_theta of (57), shape (m + 1 + n, rho)."""
        return ca.horzcat(*(step.w for step in self.steps))

    @property
    def W_x_tilde(self) -> ca.SX:
        """W_xtilde of (57), shape (rho, 1): [1, -d alpha_1/dy, .., -d alpha_{rho-1}/dy]^T."""
        return ca.vertcat(1, *(-step.dalpha.y for step in self.steps[1:]))

    @property
    def alphabar_1(self) -> ca.SX:
        """alphabar_1 of (49), without its damping multiplied by the estimate of 1/b_m."""
        symbols, k_filter, z_1 = self.symbols, self.filter, self.symbols.z_1
        return (
            -(symbols.c.symbol[0] + symbols.d.symbol[0]) * z_1
            + _damping(self) * z_1
            - second_row(k_filter.xi)
            - _omegabar(k_filter, symbols.y.symbol).T @ symbols.theta_hat.symbol
        )

    @property
    def u(self) -> ca.SX:
        """u = alpha_rho - v_{m,rho+1} + rho_hat y_r^(rho), (53), with v_{m,n+1} = 0."""
        v_m, rho = ca.vertcat(self.filter.v[-1], 0), self.filter.rho
        return self.steps[-1].alpha - v_m[rho] + _feedforward(self, rho)

    @property
    def theta_hat_rate(self) -> ca.SX:
        """theta_hat' of (55): Gamma chi(theta_hat, tau_rho); the gradient law has chi = tau."""
        return self.symbols.Gamma.symbol @ self.adaptation.rate(self.steps[-1].tau)

    @property
    def rho_hat_rate(self) -> ca.SX:
        """rho_hat' = -gamma sgn(b_m) (alphabar_1 + y_r') z_1, (54)."""
        symbols, law, z_1 = self.symbols, self.rho_adaptation, self.symbols.z_1
        wanted = self.alphabar_1 + symbols.reference(1)
        regressor = law.regressor(-symbols.sign_b_m.symbol * wanted, z_1)
        return symbols.gamma.symbol * law.rate(regressor * z_1)

    @property
    def D_hat_rate(self) -> ca.SX:
        """D_hat' = gamma_D z_1^2, in Controller 1; 0 where the radius is known."""
        symbols, law = self.symbols, self.D_adaptation
        if symbols.gamma_D is None or law is None:
            return ca.SX(0)
        z_1 = symbols.z_1
        regressor = law.regressor(symbols.damping.symbol * z_1, z_1)
        return symbols.gamma_D.symbol * law.rate(regressor * z_1)


def output_feedback_design(
    n: int = 2,
    m: int = 0,
    adaptation: AdaptationFactory = gradient,
    filter_factory: FilterFactory = iss_filter,
    options: Options | None = None,
) -> OutputFeedbackDesign:
    """Run the recursion (45)-(55).

    Parameters
    ----------
    n, m : int
        Order of the plant (27) and degree of its numerator.
    adaptation : callable
        The law of the estimates, see `congelation.theory.adaptation`.
    filter_factory : callable
        The K-filter's gains: `iss_filter` or `standard_filter` of `congelation.theory.kfilter`.
    options : Options, optional
        What the law copes with; None: the paper's.

    Raises
    ------
    InvalidInput
        Orders that do not fit, or a varying gain.
    """
    chosen = options or Options()
    if chosen.varying_gain:
        raise InvalidInput(
            "gain = 'varying' has no certificate in output feedback: the bound (42) of the "
            "estimation error then holds u^2, which the Lyapunov function does not bound "
            "(docs/theory.md, 'Varying input gain'); leave it out, or use form = 'strict-feedback'"
        )
    rho, q = checked_orders(n, m), m + 1 + n
    symbols = OutputFeedbackSymbols.of(rho, q, chosen)
    filter_design = filter_factory(n)
    k_filter = KFilter(
        m,
        eta=vector("eta", n, "K-filter state of (28)"),
        lambda_=vector("lambda", n, "K-filter state of (29)"),
        k=filter_design.k,
    )
    law = adaptation(symbols.theta_hat, symbols.Gamma.symbol, rho)
    rho_law = law.companion(symbols.rho_hat, symbols.gamma.symbol)
    D_law = None
    if symbols.D_hat is not None and symbols.gamma_D is not None:
        D_law = law.companion(symbols.D_hat, symbols.gamma_D.symbol)
    design = OutputFeedbackDesign(
        symbols, k_filter, filter_design, law, rho_law, D_law, options=chosen
    )
    design = replace(design, steps=(_first_step(design),))
    for _ in range(rho - 1):
        design = replace(design, steps=(*design.steps, _later_step(design)))
    return design


def _damping(design: OutputFeedbackDesign) -> ca.SX:
    """zetabar_{1,1}: the corrected damping, or (59) as printed; -D_hat where no radius is known.

    With a reference y^2 <= (1 + q) z_1^2 + (1 + 1/q) y_r^2. Completing squares leaves
    sum_i (x_tilde_2 - Delta_1 y)^2 / (4 d_i); (59) drops Delta_1, the variation of a_{n-1}, which
    y' holds directly, and halves what its own proof gives. A disturbance joins Delta_1 y there,
    and F^T Delta in the filter's error; the split of the square in parts 1 + g, 1 + 1/g, with
    g = r epsilon, keeps what it leaves finite where delta_1 is 0.
    """
    symbols = design.symbols
    if symbols.D_hat is not None:
        return -symbols.damping.symbol * symbols.D_hat.symbol
    if symbols.delta is None or symbols.delta_1 is None or symbols.corrected is None:
        return ca.SX(0)
    estimation = design.filter_design.disturbance_gain * symbols.delta.symbol  # r epsilon delta
    corrected = (estimation + symbols.delta_1.symbol) ** 2
    printed = estimation**2 / 2  # (59)
    choice = ca.SX(symbols.corrected.symbol)
    weight = ca.sum1(1 / (4 * symbols.d.symbol))
    if symbols.q is not None:
        weight *= 1 + symbols.q.symbol
    if symbols.q_d is not None:
        g, delta, delta_1 = (
            design.filter_design.disturbance_gain,
            symbols.delta.symbol,
            symbols.delta_1.symbol,
        )
        corrected = (1 + g) * (delta_1**2 + g * delta**2)
        weight *= 1 + symbols.q_d.symbol
    return -symbols.damping.symbol * (choice * corrected + (1 - choice) * printed) * weight


def _omegabar(k_filter: KFilter, y: ca.SX) -> ca.SX:
    """omega with its first entry, v_{m,2}, taken out: omega = omegabar + v_{m,2} e_1."""
    omegabar = k_filter.omega(y)
    omegabar[0] = 0
    return omegabar


def _feedforward(design: OutputFeedbackDesign, order: int) -> ca.SX:
    """rho_hat y_r^(order), what v_{m,order+1} is to follow; 0 without a reference."""
    symbols = design.symbols
    return ca.SX(0) if symbols.yr is None else symbols.rho_hat.symbol * symbols.reference(order)


def _first_step(design: OutputFeedbackDesign) -> OutputFeedbackStep:
    """Step 1: (45), (47), (49)."""
    symbols, k_filter, law = design.symbols, design.filter, design.adaptation
    y, z = symbols.y.symbol, symbols.z_1  # (45)
    alpha = symbols.rho_hat.symbol * design.alphabar_1  # (49)
    if k_filter.rho == 1:
        # Here b_m (u + v_{m,2}) = b_m alpha_1 exactly: no z_2, so b_m is not estimated.
        w = _omegabar(k_filter, y)
    else:
        w = k_filter.omega(y)
        w[0] -= alpha + _feedforward(design, 1)  # omega - rho_hat (alphabar_1 + y_r') e_1
    regressor = law.regressor(w, z)
    tau = regressor * z  # (47)
    slope = law.slope(ca.SX.zeros(*tau.shape), tau, regressor)
    return OutputFeedbackStep(z, alpha, w, tau, slope, _partial(ca.SX(0), design))


def _later_step(design: OutputFeedbackDesign) -> OutputFeedbackStep:
    """Step i, 2 <= i <= rho: (46), (48), (50)-(52), (56)."""
    symbols, k_filter, law, steps = design.symbols, design.filter, design.adaptation, design.steps
    i, last, Gamma = len(design.steps) + 1, design.steps[-1], symbols.Gamma.symbol
    z = k_filter.v[-1][i - 1] - last.alpha - _feedforward(design, i - 1)  # (46)
    dalpha = _partial(last.alpha, design)
    w = -dalpha.y * k_filter.omega(symbols.y.symbol)
    regressor = law.regressor(w, z)
    tau = last.tau + regressor * z  # (48)
    slope = law.slope(last.tau, tau, regressor)

    coupling = symbols.theta_hat.symbol[0] if i == 2 else 1  # b_m_hat, (50); 1, (51)
    mu = sum((step.dalpha.theta_hat @ Gamma @ slope * step.z for step in steps[1:]), ca.SX(0))
    alpha = (  # (50)-(51), with d alpha/d theta_hat where d alpha/dy is printed before Gamma tau
        -coupling * last.z
        - (symbols.c.symbol[i - 1] + symbols.d.symbol[i - 1] * dalpha.y**2) * z
        + _beta(design, dalpha)
        + dalpha.theta_hat @ Gamma @ law.rate(tau)
        + mu  # (56) with sigma_{j,i} = (d alpha_{j-1}/d theta_hat) Gamma (d alpha_{i-1}/dy) omega
    )
    return OutputFeedbackStep(z, alpha, w, tau, slope, dalpha)


def _beta(design: OutputFeedbackDesign, dalpha: Partial) -> ca.SX:
    """beta_i of (52): the part of d alpha_{i-1}/dt, and of v_{m,i}', that is known."""
    symbols, k_filter, i = design.symbols, design.filter, len(design.steps) + 1
    y, omega = symbols.y.symbol, k_filter.omega(symbols.y.symbol)
    # alpha_{i-1} depends on lambda_1 .. lambda_{m+i-1} only, which the input does not reach.
    free_lambda_rate = k_filter.lambda_rate(ca.SX(0))
    known = ca.SX(0)
    if symbols.yr is not None:
        known = dalpha.yr[:-1] @ symbols.yr.symbol[1:]
    if symbols.D_hat is not None:
        known += dalpha.D_hat @ design.D_hat_rate
    return (
        dalpha.y * (second_row(k_filter.xi) + omega.T @ symbols.theta_hat.symbol)
        + dalpha.eta @ k_filter.eta_rate(y)
        + k_filter.k.symbol[i - 1] * k_filter.v[-1][0]
        + dalpha.lambda_ @ free_lambda_rate
        + (dalpha.rho_hat + symbols.reference(i - 1)) * design.rho_hat_rate
        + known
    )


def _partial(alpha: ca.SX, design: OutputFeedbackDesign) -> Partial:
    """The partial derivatives of a virtual control, from one reverse sweep."""
    symbols, k_filter = design.symbols, design.filter
    variables = (symbols.y, k_filter.eta, k_filter.lambda_, symbols.theta_hat, symbols.rho_hat)
    columns = [v.symbol for v in variables]
    columns += [ca.SX(0, 1) if v is None else v.symbol for v in (symbols.D_hat, symbols.yr)]
    ends = np.cumsum([0, *(v.numel() for v in columns)]).tolist()
    return Partial(*ca.horzsplit(ca.jacobian(alpha, ca.vertcat(*columns)), ends))


def output_feedback_controller(
    n: int = 2,
    m: int = 0,
    adaptation: AdaptationFactory = gradient,
    filter_factory: FilterFactory = iss_filter,
    options: Options | None = None,
) -> Model:
    """The controller (53)-(55) with its K-filter (28)-(29) as a block.

    Parameters
    ----------
    n, m, adaptation, filter_factory, options
        See `output_feedback_design`.
    """
    return output_feedback_model(output_feedback_design(n, m, adaptation, filter_factory, options))


def output_feedback_model(design: OutputFeedbackDesign) -> Model:
    """The block of a derivation, on the symbols of that derivation."""
    symbols, k_filter = design.symbols, design.filter
    n, m, rho, q = k_filter.n, k_filter.m, k_filter.rho, symbols.theta_hat.symbol.numel()
    zeros = (0.0,) * n
    also = f" ({design.options})" if str(design.options) else ""
    states = [
        State(symbols.theta_hat, design.theta_hat_rate, start=(0.0,) * q),
        State(symbols.rho_hat, design.rho_hat_rate, start=(0.0,)),
        State(k_filter.eta, k_filter.eta_rate(symbols.y.symbol), start=zeros),
        State(k_filter.lambda_, k_filter.lambda_rate(design.u), start=zeros),
    ]
    estimates = [symbols.theta_hat, symbols.rho_hat]
    if symbols.D_hat is not None:
        states.insert(2, State(symbols.D_hat, design.D_hat_rate, start=(0.0,)))
        estimates.append(symbols.D_hat)
    known = (  # of the radius and the reference
        (symbols.delta, 1.0, Domain.NONNEGATIVE),
        (symbols.delta_1, 1.0, Domain.NONNEGATIVE),
        (symbols.gamma_D, 1.0, Domain.POSITIVE),
        (symbols.q, 1.0, Domain.POSITIVE),
        (symbols.q_d, 1.0, Domain.POSITIVE),
        (symbols.damping, 1.0, Domain.BOOLEAN),
        (symbols.corrected, 1.0, Domain.BOOLEAN),
        (symbols.sign_b_m, 1.0, Domain.SIGN),
    )
    laws = (design.adaptation, design.rho_adaptation, design.D_adaptation)
    return Model(
        name="OutputFeedbackController",
        description=f"Output feedback controller (53)-(55) for the plant (27), n = {n}, m = {m}"
        + also,
        inputs=(
            Input.of(symbols.y),
            *(Input.of(v, "reference") for v in (symbols.yr,) if v is not None),
        ),
        states=tuple(states),
        parameters=(
            Parameter(symbols.c, (1.0,) * rho, Domain.POSITIVE),
            Parameter(symbols.d, (1.0,) * rho, Domain.POSITIVE),
            Parameter(symbols.Gamma, tuple(np.eye(q).ravel()), Domain.POSITIVE_DEFINITE),
            Parameter(symbols.gamma, (1.0,), Domain.POSITIVE),
            *design.filter_design.parameters,
            *(Parameter(v, (default,), domain) for v, default, domain in known if v is not None),
            *(parameter for law in laws if law is not None for parameter in law.parameters),
        ),
        gains=design.filter_design.gains,
        outputs=(
            control(design.u, "Control u of (53)"),
            *(Output(v) for v in estimates),
            Output(Variables("z", design.z, "Error variables z of (45)-(46)")),
        ),
    )
