"""Sec. III: the recursion against a hand derivation, (20), Lemma 1, (26) and Proposition 1."""

import math
import time

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings

from congelation.errors import InvalidInput
from congelation.theory.adaptation import gradient, robust
from congelation.theory.closed_loop import close
from congelation.theory.lyapunov import state_feedback_certificate
from congelation.theory.state_feedback import (
    state_feedback_controller,
    state_feedback_design,
    state_feedback_model,
)
from congelation.theory.strict_feedback import SYSTEM_60, strict_feedback_plant
from congelation.theory.values import complete_values

from .systems import (
    numbers,
    orders,
    random_phibar,
    random_state,
    random_state_feedback_parameters,
    relative_difference,
    seeds,
)


def law_by_hand(phibar, x, theta_hat, c, Gamma, epsilon, delta, damping):
    """n = 2, any p, worked out on paper: no recursion, no automatic derivative."""
    (f11, _), (f21, f22) = phibar
    x1, x2 = x
    kappa = c[0] + f11 @ theta_hat + damping * (f11 @ f11 / epsilon**2 + (epsilon * delta) ** 2) / 2
    z1, z2 = x1, x2 + kappa * x1
    w1 = f11 * x1
    w2 = f21 * x1 + f22 * x2 + kappa * f11 * x1
    w21, w22 = f21 - kappa * f22 + kappa * f11, f22  # w2 = w21 z1 + w22 z2
    tau2 = w1 * z1 + w2 * z2
    zeta2 = -(w21 @ f11) / epsilon**2 * z1
    zeta2 -= ((w21 @ w21 + w22 @ w22) / epsilon**2 + (epsilon * delta) ** 2) / 2 * z2
    u = -z1 - c[1] * z2 - kappa * x2 - w2 @ theta_hat - x1 * (f11 @ Gamma @ tau2) + damping * zeta2
    return u, Gamma @ tau2, np.array([z1, z2])


@given(seed=seeds)
def test_second_order_law_equals_the_hand_derivation(seed):
    rng = np.random.default_rng(seed)
    p = int(rng.integers(1, 4))
    phibar = random_phibar(rng, 2, p)
    model = state_feedback_controller(phibar)
    values = random_state_feedback_parameters(rng, 2, p) | random_state(rng, model)
    values["damping"] = float(rng.integers(0, 2))
    expressions = [model.output("u"), model.states[0].rate, model.output("z")]
    arguments = {
        name: np.squeeze(v) for name, v in values.items() if name not in {"x", "theta_hat"}
    }
    arguments["Gamma"] = np.reshape(values["Gamma"], (p, p))
    expected = law_by_hand(phibar, values["x"].ravel(), values["theta_hat"].ravel(), **arguments)
    for found, by_hand in zip(numbers(model, expressions, values), expected, strict=True):
        assert relative_difference(found.ravel(), np.ravel(by_hand)) < 1e-12


def test_law_of_system_60_at_one_state():
    """x = (2, -1), theta_hat = 0, Fig. 2: kappa = 0.5 + (1/0.09 + 0.18)/2 = 6.1456.., by hand."""
    model = state_feedback_controller()
    values = {"x": [2, -1], "theta_hat": [0, 0], "c": [0.5, 0.5], "Gamma": np.eye(2)}
    values |= {"epsilon": 0.3, "delta": math.sqrt(2), "damping": 1.0}
    u, z = numbers(model, [model.output("u"), model.output("z")], values)
    kappa = 0.5 + (1 / 0.09 + 0.09 * 2) / 2
    z2 = -1 + 2 * kappa
    # w1 = (-2, 0), w2 = (-2 kappa, -2), wbar_2 = [(-kappa, -1), 0]
    zeta2 = -kappa / 0.09 * 2 - ((kappa**2 + 1) / 0.09 + 0.18) / 2 * z2
    tau2 = np.array([-4 - 2 * kappa * z2, -2 * z2])
    expected = -2 - 0.5 * z2 + kappa + 2 * tau2[0] + zeta2
    assert z.ravel() == pytest.approx([2, z2])
    assert u.item() == pytest.approx(expected)


def error_dynamics(design, model, values, theta):
    """z' by the chain rule along the plant and the law."""
    x, theta_hat = design.symbols.x.symbol, design.symbols.theta_hat.symbol
    plant = strict_feedback_plant(design.regressors)
    (u,) = numbers(model, [design.u], values)
    (x_rate,) = numbers(plant, [plant.states[0].rate], {"x": values["x"], "u": u, "theta": theta})
    J_x, J_theta, estimate_rate = numbers(
        model,
        [ca.jacobian(design.z, x), ca.jacobian(design.z, theta_hat), design.theta_hat_rate],
        values,
    )
    return (J_x @ x_rate + J_theta @ estimate_rate).ravel()


@given(order=orders, seed=seeds)
@settings(max_examples=40)
def test_error_dynamics_are_20(order, seed):
    """z' = (A_z + A_zeta) z + W^T (theta - theta_hat), A_z skew up to its diagonal, (21)."""
    n, p = order
    rng = np.random.default_rng(seed)
    design = state_feedback_design(random_phibar(rng, n, p))
    model = state_feedback_model(design)
    values = random_state_feedback_parameters(rng, n, p) | random_state(rng, model)
    theta = rng.normal(size=p)
    Gamma = values["Gamma"]
    z, W, zeta, *slopes = numbers(
        model,
        [design.z, design.W, ca.vertcat(*(s.zeta for s in design.steps))]
        + [s.dalpha.estimates for s in design.steps],
        values,
    )
    A_z = -np.diag(values["c"])
    for i in range(1, n):
        A_z[i, i - 1] -= 1.0
        A_z[i - 1, i] += 1.0
        for j in range(1, i):  # sigma_{j,i} = -(d alpha_{j-1}/d theta_hat) Gamma w_i
            sigma = -(slopes[j] @ Gamma @ W[:, i]).item()
            A_z[i, j] -= sigma
            A_z[j, i] += sigma
    expected = (A_z + zeta) @ z.ravel() + W.T @ (theta - values["theta_hat"].ravel())
    found = error_dynamics(design, model, values, theta)
    assert relative_difference(found, expected) < 1e-8


def assert_product(matrix, vector, expected):
    """matrix @ vector = expected up to the rounding of its terms."""
    rounding = 1e-11 * (np.abs(matrix) @ np.abs(vector)) + 1e-300
    assert (np.abs(matrix @ vector - expected) <= rounding).all()


LEAKING = {"sigma": 0.4, "projection_ball": 1.0, "theta_bound": 0.5, "dead_zone": 0.1}


@pytest.mark.parametrize("law", [gradient, robust])
@given(order=orders, seed=seeds)
@settings(max_examples=25)
def test_lemma_1(law, order, seed):
    """w_i = sum_j wbar_{i,j} z_j and x = T z, with wbar and T lower triangular; so too where the
    law of the estimates has a drift that no z_j multiplies."""
    n, p = order
    rng = np.random.default_rng(seed)
    design = state_feedback_design(random_phibar(rng, n, p), law)
    model = state_feedback_model(design)
    given = random_state_feedback_parameters(rng, n, p) | (LEAKING if law is robust else {})
    values = complete_values(model, given) | random_state(rng, model)
    z, W, T, *wbar = numbers(
        model,
        [design.z, design.W, ca.vertcat(*(s.T for s in design.steps))]
        + [s.wbar for s in design.steps],
        values,
    )
    assert_product(T, z, values["x"])
    assert np.diag(T) == pytest.approx(np.ones(n))
    assert np.triu(T, 1) == pytest.approx(np.zeros((n, n)))
    for i, factor in enumerate(wbar):
        assert_product(factor, z, W[:, i : i + 1])
        assert not factor[:, i + 1 :].any()


@given(order=orders, seed=seeds)
@settings(max_examples=25)
def test_damping_solves_26(order, seed):
    n, p = order
    rng = np.random.default_rng(seed)
    design = state_feedback_design(random_phibar(rng, n, p))
    model = state_feedback_model(design)
    values = random_state_feedback_parameters(rng, n, p) | random_state(rng, model)
    A_zeta, *wbar = numbers(
        model,
        [ca.vertcat(*(s.zeta for s in design.steps))] + [s.wbar for s in design.steps],
        values,
    )
    # Wbar stacks the columns wbar_{i,1} .. wbar_{i,n} of row i, as (25) does.
    Wbar = np.column_stack([factor.T.ravel() for factor in wbar])
    expected = -(Wbar.T @ Wbar) / values["epsilon"] ** 2
    expected -= values["epsilon"] ** 2 * values["delta"] ** 2 * np.eye(n)
    assert relative_difference(A_zeta + A_zeta.T, expected) < 1e-12
    assert not np.triu(A_zeta, 1).any()


@given(order=orders, seed=seeds)
@settings(max_examples=30)
def test_proposition_1_holds_at_random_states(order, seed):
    n, p = order
    rng = np.random.default_rng(seed)
    phibar = random_phibar(rng, n, p)
    loop = close(
        strict_feedback_plant(phibar),
        state_feedback_controller(phibar),
        random_state_feedback_parameters(rng, n, p),
    )
    finding = state_feedback_certificate(loop).search(samples=100, ascents=3, seed=seed % 1000)
    assert not finding.violated, finding
    assert finding.discarded == 0


def test_controller_2_is_not_certified():
    """Without damping the claim fails, so the search can tell."""
    loop = close(strict_feedback_plant(), state_feedback_controller(), {"damping": 0})
    assert state_feedback_certificate(loop).search(samples=200, ascents=5).violated


def test_controller_2_is_controller_1_without_variation():
    """With damping = 0, delta and epsilon do not matter."""
    model = state_feedback_controller(random_phibar(np.random.default_rng(3), 3, 2))
    rng = np.random.default_rng(4)
    values = random_state_feedback_parameters(rng, 3, 2) | random_state(rng, model)
    values["damping"] = 0.0
    (u,) = numbers(model, [model.output("u")], values)
    (same,) = numbers(model, [model.output("u")], values | {"delta": 9.0, "epsilon": 7.0})
    assert u == pytest.approx(same)


def test_derivation_is_fast_and_small():
    rng = np.random.default_rng(0)
    begin = time.perf_counter()
    model = state_feedback_controller(random_phibar(rng, 4, 4))
    model.total_derivative(model.output("u"))
    assert time.perf_counter() - begin < 10
    chain = np.zeros((3, 3, 2))
    chain[0, 0], chain[1, 0] = [-1, 0], [0, -1]
    model = state_feedback_controller(chain)
    law = ca.cse([model.output("u"), model.states[0].rate])
    function = ca.Function("law", list(model.arguments().values()), law)
    assert function.n_instructions() - function.nnz_in() - function.nnz_out() < 210


@pytest.mark.parametrize(
    ("phibar", "message"),
    [
        (np.ones((2, 2, 1)), r"phibar_\{1,2\} is not zero"),
        (np.ones((2, 3, 1)), "shape"),
        (np.ones((2, 2)), "shape"),
        (np.full((1, 1, 1), math.nan), "not finite"),
    ],
)
def test_phibar_that_is_refused(phibar, message):
    with pytest.raises(InvalidInput, match=message):
        strict_feedback_plant(phibar)


def test_system_60():
    plant = strict_feedback_plant(SYSTEM_60)
    values = {"x": [2.0, -1.0], "theta": [-3.0, 2.0], "u": 0.5}
    (rate,) = numbers(plant, [plant.states[0].rate], values)
    assert rate.ravel() == pytest.approx([3 * 2 - 1, -2 * 2 + 0.5])
