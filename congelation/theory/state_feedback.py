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
from congelation.theory.expressions import parse_of_time
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
from congelation.theory.options import Options, reference
from congelation.theory.strict_feedback import SYSTEM_60, Regressors, regressors_of

__all__ = [
    "StateFeedbackDesign",
    "StateFeedbackStep",
    "StateFeedbackSymbols",
    "state_feedback_controller",
    "state_feedback_design",
    "state_feedback_model",
]


SMALLEST_SQUARE = 1e-12
"""Added to |w_i|^2, so that the bound estimator's regressor |w_i| tanh(|w_i| z_i/eta) is smooth."""

START_OF_ETA = 0.1
"""Default of the start value of eta, for errors of size 1."""


@dataclass(frozen=True)
class StateFeedbackSymbols:
    """The symbols that the law is a function of; None where its options have no use for one."""

    x: Variables
    theta_hat: Variables
    c: Variables
    Gamma: Variables
    damping: Variables
    epsilon: Variables | None = None
    delta: Variables | None = None
    yr: Variables | None = None
    epsilon_r: Variables | None = None
    epsilon_d: Variables | None = None
    D_hat: Variables | None = None
    gamma_D: Variables | None = None
    rho_hat: Variables | None = None
    gamma: Variables | None = None
    sign_b: Variables | None = None
    epsilon_b: Variables | None = None
    eta: Variables | None = None
    decay: Variables | None = None
    t: Variables | None = None

    @classmethod
    def of(cls, n: int, p: int, options: Options) -> StateFeedbackSymbols:
        """The symbols of a law."""
        found = cls(
            x=vector("x", n, "State x of the plant (9)"),
            theta_hat=vector("theta_hat", p, "Estimate of theta, (19)"),
            c=vector("c", n, "Decay rates c_i of (15)"),
            Gamma=matrix("Gamma", p, p, "Adaptation gain of (19)"),
            damping=scalar("damping", "True: Controller 1, with damping; false: Controller 2"),
        )
        if options.Upsilon:
            q = len(options.Upsilon[0])
            about = "Estimate of vartheta in theta(t) = Upsilon(t) vartheta + theta_u(t)"
            found = replace(
                found,
                theta_hat=vector("theta_hat", q, about),
                Gamma=matrix("Gamma", q, q, found.Gamma.description),
                t=scalar("t", "Time, of which Upsilon(t) is a function", "s"),
            )
        if options.bound_estimator:
            about = "True: the bound is estimated; false: Controller 2"
            found = replace(
                found,
                damping=scalar("damping", about),
                D_hat=scalar("D_hat", "Estimate of the bound of theta(t) - ell"),
                gamma_D=scalar("gamma_D", "Adaptation gain of D_hat"),
                eta=scalar("eta", "Width in which tanh stands for a sign"),
                decay=scalar("decay", "Rate at which eta falls, eta' = -decay eta", "1/s"),
            )
        else:
            found = replace(found, epsilon=scalar("epsilon", "Weight in Young's inequality, (26)"))
        if options.unknown_radius:
            found = replace(
                found,
                D_hat=scalar("D_hat", "Estimate of epsilon^2 delta^2 / 2"),
                gamma_D=scalar("gamma_D", "Adaptation gain of D_hat"),
            )
        elif not options.bound_estimator:
            delta = scalar("delta", "Radius of theta(t), Assumption 1")
            found = replace(found, delta=delta)
        if options.tracking:
            found = replace(found, yr=reference(n))
            if not options.bound_estimator:
                weight = scalar("epsilon_r", "Weight of the reference in Young's inequality")
                found = replace(found, epsilon_r=weight)
        if options.disturbance:
            weight = scalar("epsilon_d", "Weight of the disturbance in Young's inequality")
            found = replace(found, epsilon_d=weight)
        if options.varying_gain:
            found = replace(
                found,
                rho_hat=scalar("rho_hat", "Estimate of 1/inf |b(t)|, with the sign of b"),
                gamma=scalar("gamma", "Adaptation gain of rho_hat"),
                sign_b=scalar("sign_b", "Sign of the input gain b(t)"),
            )
            if options.tracking:
                weight = scalar("epsilon_b", "Weight of the reference beside the gain b(t)")
                found = replace(found, epsilon_b=weight)
        return found

    @property
    def estimates(self) -> ca.SX:
        """theta_hat, and D_hat where there is one, as one column."""
        return _stacked(self.theta_hat, self.D_hat)

    @property
    def estimate_gain(self) -> ca.SX:
        """Gamma, and gamma_D, as one block diagonal matrix."""
        if self.gamma_D is None:
            return self.Gamma.symbol
        return ca.diagcat(self.Gamma.symbol, self.gamma_D.symbol)

    @property
    def width(self) -> int:
        """The length of rows: they multiply [z; y_r; ..; y_r^(n-1)], or z alone."""
        n = int(self.x.symbol.numel())
        return n if self.yr is None else 2 * n

    def row(self, *elements: int) -> ca.SX:
        """A row with ones at the given places, counted from 0."""
        row = ca.SX(1, self.width)
        for element in elements:
            row[element] = 1
        return row

    def unit(self, i: int) -> ca.SX:
        """x_i - alpha_{i-1} = z_i + y_r^(i-1) as a row, i counted from 1."""
        n = int(self.x.symbol.numel())
        return self.row(i - 1) if self.yr is None else self.row(i - 1, n + i - 1)


@dataclass(frozen=True)
class StateFeedbackStep:
    """Step i of the recursion. Rows multiply [z; y_r; ..; y_r^(n-1)], of length N.

    Attributes
    ----------
    z, alpha : casadi.SX, (1, 1)
        z_i of (12) and alpha_i of (15).
    m : casadi.SX, (1, n)
        e_i^T - d alpha_{i-1}/dx: z_i' holds m x'.
    w, wbar : casadi.SX, (p, 1), (p, N)
        w_i of (13); column j of wbar is wbar_{i,j} of (25): w_i = wbar [z; y_r; ..].
    v, vbar : casadi.SX, (q, 1), (q, N)
        The regressor of the estimates: w_i, or Upsilon^T w_i with structured variations. With an
        unknown radius both have one row more, the regressor of D_hat.
    tau, slope : casadi.SX, (p, 1)
        tau_i of (14), and the slope of the adaptation law there (v_i for the gradient law).
    mu, zeta : casadi.SX, (1, N)
        The corrections mu_i = mu z of (17), and the damping zeta_i = zeta z of (18).
    dalpha_dx, dalpha_dtheta, dalpha_dyr : casadi.SX, (1, n), (1, q), (1, n + 1)
        Partial derivatives of alpha_{i-1} with respect to x, the estimates, and y_r .. y_r^(n).
    T : casadi.SX, (1, N)
        x_i = T [z; y_r; ..]; T depends on (x_1 .. x_{i-1}), the estimates and the reference.
    drift : casadi.SX, (1, N)
        (d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) as a row; zero for the gradient law.
    E : casadi.SX, (1, N)
        (d alpha_{i-1}/dt) at constant x, estimates and reference, as a row; zero unless Upsilon(t)
        is known.
    """

    z: ca.SX
    alpha: ca.SX
    m: ca.SX
    w: ca.SX
    wbar: ca.SX
    v: ca.SX
    vbar: ca.SX
    tau: ca.SX
    slope: ca.SX
    mu: ca.SX
    zeta: ca.SX
    dalpha_dx: ca.SX
    dalpha_dtheta: ca.SX
    dalpha_dyr: ca.SX
    T: ca.SX
    drift: ca.SX
    E: ca.SX


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
        n, row = symbols.x.symbol.numel(), _control_factor(self)
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
    Upsilon = _known_variations(chosen, p, n, symbols.t)
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


def _known_variations(options: Options, p: int, n: int, t: Variables | None) -> ca.SX | None:
    """Upsilon(t), shape (p, q), from its formulas; None where nothing of theta(t) is known.

    Raises
    ------
    InvalidInput
        Formulas that are no p rows of one length, or that have no n derivatives at t = 0.
    """
    if t is None:
        return None
    rows = options.Upsilon
    if len(rows) != p or len({len(row) for row in rows}) != 1:
        sizes = ", ".join(str(len(row)) for row in rows)
        raise InvalidInput(
            f"Upsilon has {len(rows)} rows of {sizes} formulas; valid: a row for each of the "
            f"{p} elements of theta, all of one length"
        )
    parsed = [[parse_of_time(text, t.symbol) for text in row] for row in rows]
    for texts, row in zip(rows, parsed, strict=True):
        for text, formula in zip(texts, row, strict=True):
            derivatives = [formula]
            for _ in range(n):
                derivatives.append(ca.jacobian(derivatives[-1], t.symbol))
            (values,) = ca.substitute([ca.densify(ca.vertcat(*derivatives))], [t.symbol], [0])
            # CasADi makes |t| of sqrt(t**2), and gives it the slope 0 at 0.
            if "fabs" in str(formula) or not np.isfinite(np.asarray(ca.DM(values))).all():
                raise InvalidInput(
                    f"Upsilon holds {text}, which has not {n} derivatives at t = 0; the law needs "
                    "them: give a smooth function (docs/theory.md, 'Structured variations')"
                )
    return ca.vertcat(*(ca.horzcat(*row) for row in parsed))


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
    dalpha_dx, dalpha_dtheta, dalpha_dyr, dalpha_deta, dalpha_dt = _gradient(
        alpha_before, x, estimates, yr, eta, t
    )
    m = _e(i, n) - dalpha_dx  # what multiplies x', and so a disturbance, in z_i'
    w = ca.horzcat(*design.regressors.at(x)) @ m.T  # (13)
    v = w if design.Upsilon is None else design.Upsilon.T @ w
    zeta, T, drift, E, wbar, vbar = (symbols.row() for _ in range(6))
    if symbols.epsilon_d is not None:
        zeta[:n] += _disturbance_damping(symbols, (*(s.m for s in steps), m))
    if symbols.eta is not None:  # no damping (26), so no factors either
        size = ca.sqrt(ca.sumsqr(w) + SMALLEST_SQUARE)
        v = ca.vertcat(v, symbols.damping.symbol * size * ca.tanh(size * z / symbols.eta.symbol))
    else:
        T, drift, E = _state_factor(design), _drift_factor(design), _time_factor(design)
        wbar = _regressor_factor(design.factors, ca.vertcat(*(s.T for s in steps), T), dalpha_dx)
        vbar = wbar if design.Upsilon is None else design.Upsilon.T @ wbar
        mixed = (*(s.wbar for s in steps), wbar)
        zeta[:n] += _damping(symbols, tuple(rows[:, :n] for rows in mixed))
        if symbols.epsilon_r is not None:
            zeta[:n] += _tracking_damping(symbols, tuple(rows[:, n:] for rows in mixed))
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
        + dalpha_dx @ (ca.DM(upper_shift(n)) @ x)
        - v.T @ estimates
        + dalpha_dtheta @ Gamma @ law.rate(tau)
        + (mu + zeta)[:i] @ z_all
    )
    if symbols.yr is not None:
        alpha += dalpha_dyr[:n] @ yr[1:]
    if symbols.eta is not None and symbols.decay is not None:
        alpha -= dalpha_deta * symbols.decay.symbol * symbols.eta.symbol
    if symbols.t is not None:
        alpha += dalpha_dt
    return StateFeedbackStep(
        z,
        alpha,
        m,
        w,
        wbar,
        v,
        vbar,
        tau,
        slope,
        mu,
        zeta,
        dalpha_dx,
        dalpha_dtheta,
        dalpha_dyr,
        T,
        drift,
        E,
    )


def _before(design: StateFeedbackDesign) -> tuple[ca.SX, ca.SX, ca.SX]:
    """z_{i-1}, alpha_{i-1} and tau_{i-1}; all zero at the first step, (11) and (15)."""
    if not design.steps:
        return ca.SX(0), ca.SX(0), ca.SX.zeros(design.symbols.estimates.numel())
    last = design.steps[-1]
    return last.z, last.alpha, last.tau


def _gradient(alpha: ca.SX, *symbols: ca.SX) -> list[ca.SX]:
    """The partial derivatives of alpha, as rows, from one reverse sweep."""
    ends = np.cumsum([0, *(v.numel() for v in symbols)]).tolist()
    parts: list[ca.SX] = ca.horzsplit(ca.jacobian(alpha, ca.vertcat(*symbols)), ends)
    return parts


def _correction(steps: tuple[StateFeedbackStep, ...], step_rate: ca.SX, row: ca.SX) -> ca.SX:
    """mu_i of (17) as a row: coefficient j is -sigma_{j,i}, 2 <= j <= i - 1.

    -sigma_{j,i} = (d alpha_{j-1}/d theta_hat) Gamma w_i; a modified law has its slope for w_i.
    """
    for j, step in enumerate(steps):
        row[j] = step.dalpha_dtheta @ step_rate
    return row


def _damping(symbols: StateFeedbackSymbols, wbar: tuple[ca.SX, ...]) -> ca.SX:
    """Row i of A_zeta of (22), the lower triangular solution of (26).

    zeta_{i,k} = -g_{i,k} / epsilon^2 for k < i and half the diagonal of (26) for k = i, where
    g_{i,k} = sum_j wbar_{i,j} . wbar_{k,j} is element (i, k) of Wbar^T Wbar. What is left out for
    an unknown radius, -epsilon^2 delta^2 z_i / 2, is -D_hat z_i there.
    """
    if symbols.epsilon is None:
        return ca.SX(1, symbols.x.symbol.numel())
    row = _triangular(symbols, wbar, symbols.epsilon)
    if symbols.delta is not None:
        i = len(wbar)
        row[i - 1] -= symbols.epsilon.symbol**2 * symbols.delta.symbol**2 / 2
    return symbols.damping.symbol * row


def _tracking_damping(symbols: StateFeedbackSymbols, rbar: tuple[ca.SX, ...]) -> ca.SX:
    """zeta^r_i: the same for the columns of w_i that multiply the reference."""
    if symbols.epsilon_r is None:
        return ca.SX(1, symbols.x.symbol.numel())
    return symbols.damping.symbol * _triangular(symbols, rbar, symbols.epsilon_r)


def _disturbance_damping(symbols: StateFeedbackSymbols, m: tuple[ca.SX, ...]) -> ca.SX:
    """zeta^d_i: the same for the rows m_i, as z_i' holds m_i d."""
    if symbols.epsilon_d is None:
        return ca.SX(1, symbols.x.symbol.numel())
    return symbols.damping.symbol * _triangular(symbols, m, symbols.epsilon_d)


def _triangular(symbols: StateFeedbackSymbols, rows: tuple[ca.SX, ...], weight: Variables) -> ca.SX:
    """-g_{i,k}/weight^2, half of it for k = i; g_{i,k} = sum_j rows_{i,j} . rows_{k,j}."""
    row = ca.SX(1, symbols.x.symbol.numel())
    for k, other in enumerate(rows):
        row[k] = -ca.sum1(ca.sum2(rows[-1] * other)) / weight.symbol**2
    row[len(rows) - 1] /= 2
    return row


def _regressor_factor(factors: tuple[ca.SX | ca.DM, ...], T: ca.SX, dalpha_dx: ca.SX) -> ca.SX:
    """wbar_i of Lemma 1: (13) with x = T [z; y_r; ..], where T has the rows 1 .. i."""
    i, width = T.shape
    found = ca.SX(factors[0].shape[0], width)
    for j in range(i):
        weight = 1 if j == i - 1 else -dalpha_dx[j]
        found += weight * (factors[j] @ T[: j + 1, :])
    return found


def _state_factor(design: StateFeedbackDesign) -> ca.SX:
    """Row i of T in x = T [z; y_r; ..]: x_i = z_i + y_r^(i-1) + alpha_{i-1}."""
    unit = design.symbols.unit(len(design.steps) + 1)
    return unit + _control_factor(design) if design.steps else unit


def _control_factor(design: StateFeedbackDesign) -> ca.SX:
    """alpha_i of the last step as a row: every term of (15) holds a z_j, or a y_r^(j)."""
    symbols, steps = design.symbols, design.steps
    n, i, last = symbols.x.symbol.numel(), len(steps), steps[-1]
    row = -symbols.c.symbol[i - 1] * symbols.row(i - 1) - symbols.estimates.T @ last.vbar
    if i > 1:
        row -= symbols.row(i - 2)
    for j in range(i - 1):
        row += last.dalpha_dx[j] * steps[j + 1].T
        if symbols.yr is not None:
            row[n + j + 1] += last.dalpha_dyr[j]
    for j, step in enumerate(steps):
        row[j] += last.dalpha_dtheta @ symbols.estimate_gain @ step.slope
    return row + last.drift + last.mu + last.zeta + last.E


def _time_factor(design: StateFeedbackDesign) -> ca.SX:
    """E_i: d alpha_{i-1}/dt at constant x, estimates and reference as a row.

    With alpha_{i-1} = f [z; y_r; ..] and dz_k/dt = -d alpha_{k-1}/dt = -E_k [z; y_r; ..] there.
    """
    symbols, steps = design.symbols, design.steps
    if symbols.t is None or not steps:
        return symbols.row()
    f = _control_factor(design)
    row = ca.jacobian(f.T, symbols.t.symbol).T
    for k, step in enumerate(steps):
        row -= f[k] * step.E
    return row


def _drift_factor(design: StateFeedbackDesign) -> ca.SX:
    """(d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) as a row.

    With alpha_{i-1} = f [z; y_r; ..] and d z_k/d theta_hat = -d alpha_{k-1}/d theta_hat.
    """
    symbols, steps = design.symbols, design.steps
    estimates = symbols.estimates
    rate = symbols.estimate_gain @ design.adaptation.rate(ca.SX.zeros(estimates.numel()))
    if rate.is_zero() or not steps:
        return symbols.row()
    f = _control_factor(design)
    row = ca.jtimes(f.T, estimates, rate).T
    for k, step in enumerate(steps):
        row -= f[k] * step.drift
    return row


def _e(i: int, n: int) -> ca.SX:
    """e_i^T."""
    row = ca.SX(1, n)
    row[i - 1] = 1
    return row


def _stacked(*groups: Variables | None) -> ca.SX:
    return ca.vertcat(*(v.symbol for v in groups if v is not None))


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
            Output(
                Variables("u", design.u, "Control u = alpha_n of (19)", indexed=False),
                differentiated=True,
            ),
            *(Output(v) for v in estimates),
            Output(Variables("z", design.z, "Error variables z of (12)")),
        ),
        Upsilon=design.Upsilon,
    )
