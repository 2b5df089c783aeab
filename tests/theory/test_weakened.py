"""The search catches every design that is weaker than its proof, and no other (negative controls).

What V' + sum c_i z_i^2 can reach is computed here by other means than the closed loop: from the
error dynamics (20) for state feedback, and as a quadratic form for output feedback.
"""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest

from congelation.theory import output_feedback, state_feedback
from congelation.theory.closed_loop import close
from congelation.theory.iss_riccati import iss_riccati, iss_weight
from congelation.theory.lyapunov import output_feedback_certificate, state_feedback_certificate
from congelation.theory.matrices import filter_matrix
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.strict_feedback import strict_feedback_plant

from .systems import (
    random_output_feedback_parameters,
    random_phibar,
    random_state_feedback_parameters,
)

WEAKENED = ["whole", "half", "tenth", "none", "off-diagonal", "g_ii", "delta", "first", "last"]
SHARES = {"half": 0.5, "tenth": 0.1, "none": 0.0}
STATE_DAMPING, OUTPUT_DAMPING = state_feedback.parameter_damping, output_feedback._damping


def state_damping(kind):
    """(26) with one term left out."""

    def damping(symbols, wbar):
        row, i = STATE_DAMPING(symbols, wbar), len(wbar)
        square = symbols.damping.symbol * symbols.epsilon.symbol**2 * symbols.delta.symbol**2 / 2
        if kind == "off-diagonal":
            for k in range(i - 1):
                row[k] = 0
        elif kind == "g_ii":
            row[i - 1] = -square
        elif kind == "delta":
            row[i - 1] += square
        elif (kind == "first" and i == 1) or (kind == "last" and i == row.numel()):
            row = ca.SX(1, row.numel())
        return row

    return damping


def with_share(loop, kind):
    """The loop with all of its damping times a number."""
    share = np.array([[SHARES.get(kind, 1.0)]])
    return dataclasses.replace(loop, values={**loop.values, "damping": share})


def largest_by_20(phibar, parameters, kind):
    """The largest (V' + sum c_i z_i^2)/sum c_i z_i^2 at random z and theta_hat, from (20):
    z^T A_zeta z + delta |W z|, where A_zeta holds the damping alone."""
    design = state_feedback.state_feedback_design(phibar)
    symbols, steps = design.symbols, design.steps
    zeta, wbar = ca.vertcat(*(s.zeta for s in steps)), [s.wbar for s in steps]
    n, _, p = phibar.shape
    values = {**parameters, "damping": SHARES.get(kind, 1.0)}
    arguments = [symbols.x.symbol, symbols.theta_hat.symbol]
    others = [getattr(symbols, name) for name in ("c", "Gamma", "epsilon", "delta", "damping")]
    numbers = [ca.DM(values[v.name]) for v in others]
    bound = ca.substitute([design.z, zeta, design.W], [v.symbol for v in others], numbers)
    function = ca.Function("terms", arguments, bound)
    rng, worst = np.random.default_rng(0), -math.inf
    for _ in range(300):
        z = rng.normal(size=n) * 10 ** rng.uniform(-4, 0, n)
        theta_hat, x = rng.normal(size=p) * 10 ** rng.uniform(-2, 1), np.zeros(n)
        for i in range(n):
            x[i] = z[i] - float(function(x * (np.arange(n) < i), theta_hat)[0][i])
        _, A_zeta, W = (np.array(v) for v in function(x, theta_hat))
        worst = max(
            worst,
            (z @ A_zeta @ z + parameters["delta"] * np.linalg.norm(W @ z))
            / (parameters["c"] @ z**2),
        )
    assert len(wbar) == n
    return worst


@pytest.mark.parametrize("kind", WEAKENED)
@pytest.mark.parametrize(("n", "p", "seed"), [(2, 2, 0), (3, 2, 1), (3, 3, 2), (4, 2, 1)])
def test_weakened_state_feedback_is_caught(monkeypatch, n, p, seed, kind):
    monkeypatch.setattr(state_feedback, "parameter_damping", state_damping(kind))
    rng = np.random.default_rng(seed)
    phibar = random_phibar(rng, n, p)
    parameters = random_state_feedback_parameters(rng, n, p)
    plant = strict_feedback_plant(phibar)
    controller = state_feedback.state_feedback_controller(phibar)
    loop = with_share(close(plant, controller, parameters), kind)
    finding = state_feedback_certificate(loop).search()
    assert finding.violated is (kind != "whole")
    found_by_20 = largest_by_20(phibar, parameters, kind)
    assert finding.violated or found_by_20 <= 0  # what chance finds, the search finds


def output_damping(kind):
    """The corrected damping with delta_1, or with the filter's gain, left out."""

    def damping(design):
        symbols = design.symbols
        g = design.filter_design.disturbance_gain * symbols.delta.symbol
        strength = {"delta_1": g**2, "filter": symbols.delta_1.symbol**2}[kind]
        return -symbols.damping.symbol * strength * ca.sum1(1 / (4 * symbols.d.symbol))

    return damping


def largest_quadratic_form(p, kind):
    """sup (V' + sum c_i z_i^2) at y = 1, over x_tilde, z_2 .. z_rho and Delta.

    With s = x_tilde_2 - Delta_1 and every z_i, i >= 2, at its worst, what is left is
    s - d_1 + s^2 sum_{i>=2} 1/(4 d_i) - damping + weight V_xtilde'.
    """
    n, d, delta, delta_1 = p["n"], p["d"], p["delta"], p["delta_1"]
    X = iss_riccati(p["r"], iss_weight(n, p["epsilon"]))
    P, A_f, g = p["r"] ** 2 * np.linalg.inv(X), filter_matrix(X[:, 0] / 2), p["r"] * p["epsilon"]
    D, D_2 = np.sum(1 / (4 * d)), np.sum(1 / (4 * d[1:]))
    strength = {"delta_1": (g * delta) ** 2, "filter": delta_1**2}.get(
        kind, SHARES.get(kind, 1.0) * (g * delta + delta_1) ** 2
    )
    weight, e_2 = (1 + delta_1 / (g * delta)) * D, np.eye(n)[:, 1]
    H = -(D_2 * np.outer(e_2, e_2) + weight * (P @ A_f + A_f.T @ P))
    assert np.linalg.eigvalsh(H).min() > 0
    rng, worst = np.random.default_rng(0), -math.inf
    for _ in range(2000):
        Delta = rng.normal(size=n)
        Delta *= delta / np.linalg.norm(Delta)
        if abs(Delta[0]) > delta_1:
            Delta[0] = math.copysign(delta_1, Delta[0])
            rest = math.sqrt(delta**2 - delta_1**2)
            Delta[1:] *= rest / np.linalg.norm(Delta[1:])
        slope = e_2 * (1 - 2 * D_2 * Delta[0]) - 2 * weight * P @ Delta
        rest = -d[0] - Delta[0] + D_2 * Delta[0] ** 2 - strength * D
        worst = max(worst, rest + slope @ np.linalg.solve(H, slope) / 4)
    return worst


@pytest.mark.parametrize("kind", ["whole", "half", "tenth", "none", "delta_1", "filter"])
@pytest.mark.parametrize(
    ("n", "m", "seed"),
    [(2, 0, 2), (2, 1, 2), (3, 0, 0), (3, 1, 1), (3, 2, 1), (4, 1, 0), (4, 2, 1)],
)
def test_weakened_output_feedback_is_caught_exactly_where_it_fails(monkeypatch, n, m, seed, kind):
    """delta_1 left out is not always a violation; the quadratic form tells."""
    parameters = random_output_feedback_parameters(np.random.default_rng(seed), n, m)
    if kind in ("delta_1", "filter"):
        monkeypatch.setattr(output_feedback, "_damping", output_damping(kind))
    controller = output_feedback.output_feedback_controller(n, m)
    loop = with_share(close(observer_form_plant(n, m), controller, parameters), kind)
    largest = largest_quadratic_form({**parameters, "n": n}, kind)
    finding = output_feedback_certificate(loop).search()
    assert finding.violated == (largest > 0)
    if kind != "delta_1":
        assert finding.violated is (kind != "whole")
    if finding.violated:
        assert finding.margin.excess == pytest.approx(largest / parameters["c"][0], rel=0.1)
