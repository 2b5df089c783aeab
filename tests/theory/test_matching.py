"""The matched case: the remark after (8)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from congelation.errors import InfeasibleDesign, InvalidInput
from congelation.theory.closed_loop import SmoothPiece, close
from congelation.theory.gains import matched_riccati
from congelation.theory.lyapunov import matched_certificate
from congelation.theory.matching import matched_controller, matched_plant

from .systems import numbers, random_definite, seeds


@given(seed=seeds, n=st.integers(1, 4))
@settings(max_examples=25)
def test_certified_for_any_order(seed, n):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=n)
    epsilon = rng.uniform(0.3, 2)
    parameters = {
        "Gamma": random_definite(rng, n),
        "Q": random_definite(rng, n),
        "epsilon": epsilon,
        "delta": rng.uniform(0, 3),
        "rho": 1 / epsilon**2 + rng.uniform(0.2, 2),
    }
    loop = close(matched_plant(A, B), matched_controller(A, B), parameters)
    assert not matched_certificate(loop).search(samples=60, ascents=3).violated


def test_controller_2_is_not_certified():
    loop = close(matched_plant(), matched_controller(), {"damping": 0, "delta": 2.0})
    assert matched_certificate(loop).search(samples=200, ascents=5).violated


def test_law_and_plant_element_by_element():
    A, B = [[0.0, 1.0], [-2.0, -0.5]], [0.0, 3.0]
    x, theta, theta_hat = np.array([0.3, -0.7]), np.array([1.0, 2.0]), np.array([0.5, -1.0])
    P = matched_riccati(2.0, 1.0, 1.0, 1.0, np.eye(2), A=A, B=B)
    plant, controller = matched_plant(A, B), matched_controller(A, B)
    (rate,) = numbers(plant, [plant.states[0].rate], {"x": x, "u": 0.25, "theta": theta})
    drive = 0.25 + theta @ x
    assert rate.ravel() == pytest.approx([x[1], -2 * x[0] - 0.5 * x[1] + 3 * drive])
    values = {"x": x, "theta_hat": theta_hat, "P": P, "rho": 2.0, "Q": np.eye(2)}
    values |= {"Gamma": np.diag([2.0, 3.0]), "epsilon": 1.0, "delta": 1.0, "damping": 1.0}
    u, estimate_rate = numbers(
        controller, [controller.output("u"), controller.states[0].rate], values
    )
    e = 3 * P[1] @ x
    assert u.item() == pytest.approx(-theta_hat @ x - e)
    assert estimate_rate.ravel() == pytest.approx(np.array([2.0, 3.0]) * x * e)


def test_converges_under_fast_variation():
    loop = close(matched_plant(), matched_controller(), {"delta": 2.0})
    segment = SmoothPiece(0, 20, lambda t: [1 + np.sin(30 * t), -1 + np.cos(17 * t)])
    solution = loop.solve([segment], loop.start({"x": [2, -1]}), [0.0, 20.0])
    assert solution.success
    assert np.abs(solution.states[-1, :2]).max() < 1e-4


def test_refusals():
    with pytest.raises(InvalidInput, match="A has shape"):
        matched_plant([[1.0, 2.0]], [1.0])
    with pytest.raises(InvalidInput, match="B has shape"):
        matched_plant(np.eye(2), [1.0])
    with pytest.raises(InvalidInput, match="not finite"):
        matched_plant([[np.inf]], [1.0])
    with pytest.raises(InfeasibleDesign, match=r"rho > 1/epsilon\^2 = 100"):
        close(matched_plant(), matched_controller(), {"epsilon": 0.1})
