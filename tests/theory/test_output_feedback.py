"""Sec. IV: the law against a hand derivation, the corrected (57), and Proposition 2."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings

from congelation.errors import InfeasibleDesign, InvalidInput
from congelation.theory.closed_loop import close
from congelation.theory.gains import iss_filter_gain
from congelation.theory.iss_riccati import iss_riccati, iss_weight
from congelation.theory.kfilter import standard_filter, varying_b_filter
from congelation.theory.lyapunov import output_feedback_certificate
from congelation.theory.matrices import filter_matrix
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.output_feedback import (
    output_feedback_controller,
    output_feedback_design,
    output_feedback_model,
)

from .systems import (
    degrees,
    numbers,
    random_output_feedback_parameters,
    random_state,
    relative_difference,
    seeds,
)


def zeta_by_hand(p):
    """The coefficient of the damping, corrected or as printed."""
    weight = sum(1 / (4 * d) for d in p["d"])
    g = p["r"] * p["epsilon"] * p["delta"]
    strength = (g + p["delta_1"]) ** 2 if p["corrected"] else g**2 / 2
    return -p["damping"] * strength * weight


def law_of_second_order_by_hand(p, k, y, eta, lam, theta_hat, rho_hat):
    """n = 2, m = 0 on paper: xi_2 = k_2 (eta_2 - k_1 eta_1), Xi_(2) = [k_2 eta_1, -eta_2]."""
    (k1, k2), (e1, e2), (l1, l2) = k, eta, lam
    (c1, c2), (d1, d2) = p["c"], p["d"]
    zeta, Gamma = zeta_by_hand(p), p["Gamma"]
    xi2 = k2 * (e2 - k1 * e1)
    omega = np.array([l2, k2 * e1 - y, -e2])
    s = -(c1 + d1) + zeta + theta_hat[1]  # d alphabar_1/dy
    alphabar = (-(c1 + d1) + zeta) * y - xi2 - omega[1] * theta_hat[1] - omega[2] * theta_hat[2]
    z2 = l2 - rho_hat * alphabar
    tau2 = (omega - rho_hat * alphabar * np.array([1, 0, 0])) * y - rho_hat * s * omega * z2
    rho_rate = -p["gamma"] * p["sign_b_m"] * alphabar * y
    beta = rho_hat * s * (xi2 + omega @ theta_hat) + k2 * l1 + alphabar * rho_rate
    beta += rho_hat * (k1 * k2 - k2 * theta_hat[1]) * (e2 - k1 * e1)
    beta += rho_hat * (-k2 + theta_hat[2]) * (-k2 * e1 + y)
    u = -theta_hat[0] * y - (c2 + d2 * (rho_hat * s) ** 2) * z2 + beta
    u += rho_hat * np.array([0, y - k2 * e1, e2]) @ Gamma @ tau2
    return u, Gamma @ tau2, rho_rate, np.array([y, z2])


def law_of_first_order_by_hand(p, k, y, eta, lam, theta_hat, rho_hat):
    """n = 1, m = 0: there is no second row, so omega = [0, -y] and u = rho_hat alphabar_1."""
    alphabar = (-(p["c"][0] + p["d"][0]) + zeta_by_hand(p) + theta_hat[1]) * y
    rate = p["Gamma"] @ np.array([0, -y * y])
    return rho_hat * alphabar, rate, -p["gamma"] * p["sign_b_m"] * alphabar * y, np.array([y])


@pytest.mark.parametrize(
    ("n", "by_hand"), [(1, law_of_first_order_by_hand), (2, law_of_second_order_by_hand)]
)
@given(seed=seeds)
def test_law_equals_the_hand_derivation(n, by_hand, seed):
    rng = np.random.default_rng(seed)
    model = output_feedback_controller(n, 0)
    parameters = random_output_feedback_parameters(rng, n, 0)
    parameters |= {name: float(rng.integers(0, 2)) for name in ("damping", "corrected")}
    k = iss_filter_gain(parameters["r"], parameters["epsilon"], n=n)
    values = parameters | random_state(rng, model) | {"k": k}
    rates = {s.variables.name: s.rate for s in model.states}
    found = numbers(
        model,
        [model.output("u"), rates["theta_hat"], rates["rho_hat"], model.output("z")],
        values,
    )
    state = [values[name].ravel() for name in ("eta", "lambda", "theta_hat")]
    expected = by_hand(parameters, k, values["y"].item(), *state, values["rho_hat"].item())
    for number, derived in zip(found, expected, strict=True):
        assert relative_difference(number.ravel(), np.ravel(derived)) < 1e-11


@given(degree=degrees, seed=seeds)
@settings(max_examples=50)
def test_error_dynamics_are_the_corrected_57(degree, seed):
    """z' = (A_z + A_zeta) z + W_xtilde (x_tilde_2 - Delta_1 y) + W_theta^T (ell - theta_hat)
    - b_m alphabar_1 (1/b_m - rho_hat) e_1, along the plant with theta = ell + Delta."""
    n, m = degree
    rng, rho = np.random.default_rng(seed), n - m
    design = output_feedback_design(n, m)
    model, plant, symbols = output_feedback_model(design), observer_form_plant(n, m), design.symbols
    p = random_output_feedback_parameters(rng, n, m)
    k = iss_filter_gain(p["r"], p["epsilon"], n=n)
    values = p | random_state(rng, model) | {"k": k}
    ell, Delta = rng.normal(size=m + 1 + n), rng.normal(size=m + 1 + n)
    Delta[: m + 1] = 0
    flows = [ca.jacobian(design.z, s.variables.symbol) @ s.rate for s in model.states]
    z, u, W_theta, W_x, alphabar, xi, Omega_T, *rest = numbers(
        model,
        [design.z, design.u, design.W_theta, design.W_x_tilde, design.alphabar_1]
        + [design.filter.xi, design.filter.Omega_T, ca.jacobian(design.z, symbols.y.symbol)]
        + flows
        + [step.dalpha.theta_hat for step in design.steps],
        values,
    )
    z_y, partial_rates, slopes = rest[0], rest[1 : 1 + len(flows)], rest[1 + len(flows) :]
    x = rng.normal(size=n)
    x[0] = values["y"].item()
    (x_rate,) = numbers(plant, [plant.states[0].rate], {"x": x, "u": u, "theta": ell + Delta})
    found = (z_y * x_rate[0] + sum(partial_rates)).ravel()

    x_tilde_2 = (x - xi.ravel() - Omega_T @ ell)[1] if n > 1 else 0.0
    diagonal = p["c"] + p["d"] * W_x.ravel() ** 2
    A_z = -np.diag(diagonal)
    A_z[0, 0] += zeta_by_hand(p)
    for i in range(1, rho):
        coupling = values["theta_hat"][0].item() if i == 1 else 1.0
        A_z[i, i - 1] -= coupling
        A_z[i - 1, i] += coupling
        for j in range(1, i):  # sigma_{j,i} = (d alpha_{j-1}/d theta_hat) Gamma (..dy) omega
            sigma = -(slopes[j] @ p["Gamma"] @ W_theta[:, i]).item()
            A_z[i, j] -= sigma
            A_z[j, i] += sigma
    expected = A_z @ z.ravel() + W_x.ravel() * (x_tilde_2 - Delta[m + 1] * x[0])
    expected += W_theta.T @ (ell - values["theta_hat"].ravel())
    expected[0] -= ell[0] * alphabar.item() * (1 / ell[0] - values["rho_hat"].item())
    assert relative_difference(found, expected) < 1e-7


def loop_of(n, m, parameters=None, **factories):
    return close(
        observer_form_plant(n, m), output_feedback_controller(n, m, **factories), parameters
    )


@given(degree=degrees, seed=seeds)
@settings(max_examples=30)
def test_corrected_proposition_2_holds_at_random_states(degree, seed):
    parameters = random_output_feedback_parameters(np.random.default_rng(seed), *degree)
    certificate = output_feedback_certificate(loop_of(*degree, parameters))
    finding = certificate.search(samples=80, ascents=3, seed=seed % 1000)
    assert not finding.violated, finding


@pytest.mark.parametrize(("r", "epsilon"), [(5.0, math.sqrt(0.1)), (11.0, 0.1)])
@pytest.mark.parametrize("corrected", [True, False])
def test_search_tells_the_corrected_from_the_printed_damping(r, epsilon, corrected):
    """The gains of Sec. V, in both readings."""
    parameters = {"c": [0.8, 0.8], "d": [0.2, 0.2], "r": r, "epsilon": epsilon}
    parameters |= {"delta": math.sqrt(2), "delta_1": 1.0, "corrected": corrected}
    finding = output_feedback_certificate(loop_of(2, 0, parameters)).search(seed=1)
    assert finding.violated is not corrected


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)])
def test_printed_59_is_violated_for_every_order(n, m):
    parameters = {"delta": 2.0, "delta_1": 1.5, "corrected": 0}
    assert output_feedback_certificate(loop_of(n, m, parameters)).search(seed=2).violated


def excess_for_weight(weight, damping, r, epsilon, d, delta, delta_1):
    """sup V' + sum c_i z_i^2 over x_tilde, z_2 and Delta at y = 1, for weight V_xtilde in V; n = 2.

    What is left of V' + sum c_i z_i^2 is s - d_1 + s^2/(4 d_2) - damping + weight V_xtilde', where
    s = x_tilde_2 - Delta_1 and z_2 is at its worst: a quadratic form in x_tilde.
    """
    X = iss_riccati(r, iss_weight(2, epsilon))
    P, A_f, e_2 = r**2 * np.linalg.inv(X), filter_matrix(X[:, 0] / 2), np.array([0.0, 1.0])
    D_2 = 1 / (4 * d[1])
    H = -(D_2 * np.outer(e_2, e_2) + weight * (P @ A_f + A_f.T @ P))
    if np.linalg.eigvalsh(H).min() <= 0:
        return math.inf
    angles = np.linspace(0, 2 * np.pi, 721)
    Delta = delta * np.array([np.cos(angles), np.sin(angles)])
    Delta = Delta[:, np.abs(Delta[0]) <= delta_1]
    slope = np.outer(e_2, 1 - 2 * D_2 * Delta[0]) - 2 * weight * P @ Delta
    constant = -Delta[0] - d[0] + D_2 * Delta[0] ** 2 - damping
    return float((constant + (slope * np.linalg.solve(H, slope)).sum(axis=0) / 4).max())


@pytest.mark.parametrize(("r", "epsilon"), [(5.0, math.sqrt(0.1)), (11.0, 0.1)])
def test_no_weight_of_the_filter_in_V_rescues_59(r, epsilon):
    """Not only the weight of the paper's proof: every one, at the gains of Sec. V."""
    given = (r, epsilon, [0.2, 0.2], math.sqrt(2), 1.0)
    total, g = 2 / (4 * 0.2), r * epsilon * math.sqrt(2)
    printed, corrected = g**2 / 2 * total, (g + 1) ** 2 * total
    weights = total * np.logspace(-3, 3, 601)
    assert min(excess_for_weight(w, printed, *given) for w in weights) > 5
    assert excess_for_weight((1 + 1 / g) * total, corrected, *given) < 0


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (3, 1)])
def test_standard_filter_is_certified_with_its_own_norm(n, m):
    loop = loop_of(n, m, {"delta": 2.0, "delta_1": 1.5}, filter_factory=standard_filter)
    assert not output_feedback_certificate(loop).search(samples=300, ascents=5).violated


def test_filter_for_time_varying_b():
    loop = loop_of(3, 1, {"epsilon_b": 0.5}, filter_factory=varying_b_filter(2))
    assert not output_feedback_certificate(loop).search(samples=300, ascents=5).violated


def test_a_filter_gain_that_is_given_is_judged_by_its_own_norm():
    """poles at -1: the norm is 1 + sqrt(2), which r epsilon has to reach."""
    enough = loop_of(2, 0, {"k": [2.0, 1.0], "r": 2.5, "epsilon": 1.0})
    assert not output_feedback_certificate(enough).search(samples=200, ascents=5).violated
    short = loop_of(2, 0, {"k": [2.0, 1.0], "r": 2.4, "epsilon": 1.0})
    with pytest.raises(InvalidInput, match=r"2\.4; valid: .* norm, 2\.4142"):
        output_feedback_certificate(short)


def test_first_tuning_function_where_rho_is_1():
    """With the general formula (47) the inequality fails: e_1 would multiply a z_2 that is not."""
    design = output_feedback_design(2, 1)
    model = output_feedback_model(design)
    rng = np.random.default_rng(0)
    p = random_output_feedback_parameters(rng, 2, 1)
    values = p | random_state(rng, model) | {"k": iss_filter_gain(p["r"], p["epsilon"], n=2)}
    tau, omega_y = numbers(
        model, [design.steps[0].tau, design.filter.omega(design.z[0]) * design.z[0]], values
    )
    assert tau[0] == 0
    assert tau[1:] == pytest.approx(omega_y[1:])


def test_infeasible_gains_are_refused_when_the_loop_is_closed():
    with pytest.raises(InfeasibleDesign, match=r"10\.0499"):
        loop_of(2, 0, {"r": 5.0, "epsilon": 0.1})


@pytest.mark.parametrize("epsilon", [0.1, 0.3])
def test_a_design_without_r_is_refused_with_the_smallest_one(epsilon):
    """By default r is 3 for n = 2: feasible for epsilon = 0.4, where sqrt(1 + 1/epsilon^2) < 3."""
    least = math.sqrt(1 + epsilon**-2)
    with pytest.raises(InfeasibleDesign) as refusal:
        loop_of(2, 0, {"epsilon": epsilon})
    named = re.search(r"the smallest feasible r is ([0-9.]+[0-9])", str(refusal.value))
    assert named is not None
    assert float(named[1]) == pytest.approx(least, rel=1e-5)
    loop_of(2, 0, {"epsilon": epsilon, "r": 1.001 * least})
    loop_of(2, 0, {"epsilon": 0.4})


@pytest.mark.parametrize(("n", "m"), [(0, 0), (2, 2), (2, -1)])
def test_orders_that_are_refused(n, m):
    with pytest.raises(InvalidInput, match="valid: n >= 1"):
        output_feedback_controller(n, m)


def test_plant_27():
    """n = 3, m = 1, rho = 2, element by element."""
    plant = observer_form_plant(3, 1)
    b1, b0, a2, a1, a0 = theta = [2.0, 3.0, 5.0, 7.0, 11.0]
    x, u = [1.5, -0.5, 0.25], 0.75
    rate, y = numbers(
        plant, [plant.states[0].rate, plant.output("y")], {"x": x, "u": u, "theta": theta}
    )
    expected = [x[1] - a2 * x[0], x[2] - a1 * x[0] + b1 * u, -a0 * x[0] + b0 * u]
    assert rate.ravel() == pytest.approx(expected)
    assert y.item() == x[0]


def test_filter_matrix_is_the_one_of_the_controller():
    model = output_feedback_controller(3, 0)
    rng = np.random.default_rng(1)
    values = random_output_feedback_parameters(rng, 3, 0) | random_state(rng, model)
    values["k"] = np.array([3.0, 3.0, 1.0])
    rates = {s.variables.name: s.rate for s in model.states}
    eta, lam = numbers(model, [rates["eta"], rates["lambda"]], values)
    (u,) = numbers(model, [model.output("u")], values)
    A_f, e_n = filter_matrix(values["k"]), np.array([[0], [0], [1]])
    assert eta == pytest.approx(A_f @ values["eta"] + e_n * values["y"])  # (28)
    assert lam == pytest.approx(A_f @ values["lambda"] + e_n * u)  # (29)
