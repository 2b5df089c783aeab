"""The K-filter: what it reconstructs along runs, for any input and any theta(t)."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from congelation.theory.gains import iss_filter_gain
from congelation.theory.iss_riccati import iss_riccati, iss_weight
from congelation.theory.kfilter import KFilter
from congelation.theory.matrices import filter_matrix
from congelation.theory.model import vector
from congelation.theory.observer_form import observer_form_plant, parameter_regressor

from .systems import degrees, least_r, numbers, seeds


def filter_of(n, m):
    return KFilter(m, vector("eta", n, ""), vector("lambda", n, ""), vector("k", n, ""))


def functions(n, m):
    """(eta, lambda, k, y, u) -> xi, Omega^T, eta', lambda', omega as numbers."""
    k_filter, y, u = filter_of(n, m), ca.SX.sym("y"), ca.SX.sym("u")
    arguments = [v.symbol for v in (k_filter.eta, k_filter.lambda_, k_filter.k)] + [y, u]
    results = [k_filter.xi, k_filter.Omega_T, k_filter.eta_rate(y), k_filter.lambda_rate(u)]
    function = ca.Function("filter", arguments, [*results, k_filter.omega(y)])
    return lambda *values: [np.array(v) for v in function(*values)]


@given(degree=degrees, seed=seeds)
@settings(max_examples=25)
def test_filter_obeys_34_and_35(degree, seed):
    """xi' = A_f xi + k y and Omega^T' = A_f Omega^T + F^T(y, u), by the chain rule."""
    n, m = degree
    rng = np.random.default_rng(seed)
    k_filter, (y, u) = filter_of(n, m), rng.normal(size=2)
    eta, lam, k = rng.normal(size=(3, n))
    evaluate = functions(n, m)
    xi, Omega_T, eta_rate, lambda_rate, _ = evaluate(eta, lam, k, y, u)
    # xi and Omega are linear in (eta, lambda): their rates are their values at the rates.
    xi_rate, Omega_T_rate, *_ = evaluate(eta_rate, lambda_rate, k, y, u)
    A_f = filter_matrix(k)
    F_T = np.array(ca.DM(parameter_regressor(n, m, ca.SX(y), ca.SX(u))))
    assert xi_rate == pytest.approx(A_f @ xi + k[:, None] * y, rel=1e-9, abs=1e-9)
    assert Omega_T_rate == pytest.approx(A_f @ Omega_T + F_T, rel=1e-9, abs=1e-9)
    assert k_filter.rho == n - m


def run(n, m, k, theta, u, x_0, end=3.0):
    """Plant and filter driven by u(t) under theta(t); states x, eta, lambda at `end`."""
    evaluate, plant = functions(n, m), observer_form_plant(n, m)
    x, u_symbol = plant.states[0].variables.symbol, plant.inputs[0].variables.symbol
    rate = ca.Function("plant", [x, u_symbol, plant.theta.symbol], [plant.states[0].rate])

    def slope(t, X):
        _, _, eta_rate, lambda_rate, _ = evaluate(X[n : 2 * n], X[2 * n :], k, X[0], u(t))
        x_rate = np.array(rate(X[:n], u(t), theta(t)))
        return np.vstack([x_rate, eta_rate, lambda_rate]).ravel()

    start = np.concatenate([x_0, np.zeros(2 * n)])
    found = solve_ivp(slope, (0, end), start, rtol=1e-9, atol=1e-11)
    X = found.y[:, -1]
    xi, Omega_T, *_ = evaluate(X[n : 2 * n], X[2 * n :], k, X[0], u(end))
    return X[:n], xi.ravel(), Omega_T


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 0), (2, 1), (3, 1), (4, 2)])
def test_estimation_error_decays_as_37_for_constant_parameters(n, m):
    """x = xi + Omega^T theta + e^{A_f t} x_tilde(0), whatever the input."""
    rng = np.random.default_rng(10 * n + m)
    theta, x_0 = rng.uniform(-0.5, 0.5, m + 1 + n), rng.normal(size=n)
    k = iss_filter_gain(1.5 * least_r(n, 1.0), 1.0, n=n)
    x, xi, Omega_T = run(n, m, k, lambda t: theta, lambda t: math.sin(3 * t) + 0.2, x_0)
    x_tilde = expm(3.0 * filter_matrix(k)) @ x_0
    assert x == pytest.approx(xi + Omega_T @ theta + x_tilde, rel=1e-6, abs=1e-6)


def test_estimation_error_obeys_40_for_congealed_parameters():
    """x_tilde' = A_f x_tilde + F^T Delta: against the convolution, solved on its own."""
    n, m, ell = 2, 0, np.array([1.0, -1.0, 2.0])
    k, x_0 = np.array([3.0, 2.0]), np.array([0.5, -1.0])

    def Delta(t):
        return np.array([0.0, 0.6 * math.sin(4 * t), 0.4 * math.cos(9 * t)])

    def u(t):
        return -2 * math.sin(t)

    x, xi, Omega_T = run(n, m, k, lambda t: ell + Delta(t), u, x_0)
    plant = observer_form_plant(n, m)

    def slope(t, X):
        values = {"x": X[:n], "u": u(t), "theta": ell + Delta(t)}
        (x_rate,) = numbers(plant, [plant.states[0].rate], values)
        x_tilde_rate = filter_matrix(k) @ X[n:] - Delta(t)[1:] * X[0]
        return np.concatenate([x_rate.ravel(), x_tilde_rate])

    found = solve_ivp(slope, (0, 3.0), np.concatenate([x_0, x_0]), rtol=1e-9, atol=1e-11)
    assert x - xi - Omega_T @ ell == pytest.approx(found.y[n:, -1], rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_iss_bound_42_along_a_run(n):
    """V(T) - V(0) <= int (-|x_tilde|^2 + r^2 eps^2 |Delta|^2 y^2) with jumps of Delta(t)."""
    rng = np.random.default_rng(n)
    epsilon, r = 0.5, 1.3 * least_r(n, 0.5)
    X = iss_riccati(r, iss_weight(n, epsilon))
    P, A_f = r**2 * np.linalg.inv(X), filter_matrix(X[:, 0] / 2)
    directions = rng.normal(size=(20, n))
    error, bound = rng.normal(size=n), 0.0
    V_0 = error @ P @ error
    for k, Delta in enumerate(directions):  # one constant piece after the other

        def slope(t, state, Delta=Delta):
            e, y = state[:n], math.cos(2 * t)
            integrand = -e @ e + (r * epsilon) ** 2 * (Delta @ Delta) * y**2
            return np.append(A_f @ e - Delta * y, integrand)

        piece = (0.2 * k, 0.2 * (k + 1))
        found = solve_ivp(slope, piece, np.append(error, bound), rtol=1e-9, atol=1e-11)
        error, bound = found.y[:n, -1], found.y[n, -1]
        assert error @ P @ error - V_0 <= bound + 1e-7
