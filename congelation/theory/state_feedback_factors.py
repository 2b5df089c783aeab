"""Lemma 1 of state feedback: each term of its recursion as a row, and the dampings made of rows.

Rows multiply [z; y_r; ..; y_r^(n-1)]. A damping is the lower triangular solution of (26), or of the
same equation for another perturbation that enters z' with some rows.
"""

from __future__ import annotations

import casadi as ca

from congelation.theory.adaptation import Adaptation
from congelation.theory.model import Variables
from congelation.theory.state_feedback_symbols import StateFeedbackSymbols, Steps

__all__ = [
    "control_factor",
    "disturbance_damping",
    "drift_factor",
    "parameter_damping",
    "reference_damping",
    "regressor_factor",
    "state_factor",
    "time_factor",
]


def parameter_damping(symbols: StateFeedbackSymbols, wbar: tuple[ca.SX, ...]) -> ca.SX:
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


def reference_damping(symbols: StateFeedbackSymbols, rbar: tuple[ca.SX, ...]) -> ca.SX:
    """zeta^r_i: the same for the columns of w_i that multiply the reference."""
    if symbols.epsilon_r is None:
        return ca.SX(1, symbols.x.symbol.numel())
    return symbols.damping.symbol * _triangular(symbols, rbar, symbols.epsilon_r)


def disturbance_damping(symbols: StateFeedbackSymbols, m: tuple[ca.SX, ...]) -> ca.SX:
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


def regressor_factor(factors: tuple[ca.SX | ca.DM, ...], T: ca.SX, dalpha_dx: ca.SX) -> ca.SX:
    """wbar_i of Lemma 1: (13) with x = T [z; y_r; ..], where T has the rows 1 .. i."""
    i, width = T.shape
    found = ca.SX(factors[0].shape[0], width)
    for j in range(i):
        weight = 1 if j == i - 1 else -dalpha_dx[j]
        found += weight * (factors[j] @ T[: j + 1, :])
    return found


def state_factor(symbols: StateFeedbackSymbols, steps: Steps) -> ca.SX:
    """Row i of T in x = T [z; y_r; ..]: x_i = z_i + y_r^(i-1) + alpha_{i-1}."""
    unit = symbols.unit(len(steps) + 1)
    return unit + control_factor(symbols, steps) if steps else unit


def control_factor(symbols: StateFeedbackSymbols, steps: Steps) -> ca.SX:
    """alpha_i of the last step as a row: every term of (15) holds a z_j, or a y_r^(j)."""
    n, i, last = symbols.x.symbol.numel(), len(steps), steps[-1]
    row = -symbols.c.symbol[i - 1] * symbols.row(i - 1) - symbols.estimates.T @ last.vbar
    if i > 1:
        row -= symbols.row(i - 2)
    for j in range(i - 1):
        row += last.dalpha.x[j] * steps[j + 1].T
        if symbols.yr is not None:
            row[n + j + 1] += last.dalpha.yr[j]
    for j, step in enumerate(steps):
        row[j] += last.dalpha.estimates @ symbols.estimate_gain @ step.slope
    return row + last.drift + last.mu + last.zeta + last.E


def time_factor(symbols: StateFeedbackSymbols, steps: Steps) -> ca.SX:
    """E_i: d alpha_{i-1}/dt at constant x, estimates and reference as a row.

    With alpha_{i-1} = f [z; y_r; ..] and dz_k/dt = -d alpha_{k-1}/dt = -E_k [z; y_r; ..] there.
    """
    if symbols.t is None or not steps:
        return symbols.row()
    f = control_factor(symbols, steps)
    row = ca.jacobian(f.T, symbols.t.symbol).T
    for k, step in enumerate(steps):
        row -= f[k] * step.E
    return row


def drift_factor(symbols: StateFeedbackSymbols, steps: Steps, law: Adaptation) -> ca.SX:
    """(d alpha_{i-1}/d theta_hat) Gamma chi(theta_hat, 0) as a row.

    With alpha_{i-1} = f [z; y_r; ..] and d z_k/d theta_hat = -d alpha_{k-1}/d theta_hat.
    """
    estimates = symbols.estimates
    rate = symbols.estimate_gain @ law.rate(ca.SX.zeros(estimates.numel()))
    if rate.is_zero() or not steps:
        return symbols.row()
    f = control_factor(symbols, steps)
    row = ca.jtimes(f.T, estimates, rate).T
    for k, step in enumerate(steps):
        row -= f[k] * step.drift
    return row
