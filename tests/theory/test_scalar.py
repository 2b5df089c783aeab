"""Sec. II: the scalar example and the damping that (8) should hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.theory.certificate import PerturbationSet
from congelation.theory.closed_loop import close
from congelation.theory.lyapunov import scalar_certificate
from congelation.theory.scalar import scalar_controller, scalar_plant

from .systems import numbers

positive = st.floats(min_value=0.05, max_value=20)


def test_laws_2_and_3():
    plant, controller = scalar_plant(), scalar_controller()
    (rate,) = numbers(plant, [plant.states[0].rate], {"x": 2.0, "u": 0.5, "theta": -3.0})
    assert rate.item() == 6.5
    values = {"x": 2.0, "theta_hat": 0.5, "k_bar": 1.5, "gamma": 3.0}
    values |= {"epsilon": 0.5, "delta": 2.0, "damping": 1.0}
    expressions = [controller.output("u"), controller.states[0].rate]
    u, estimate_rate = numbers(controller, expressions, values)
    k = 1.5 + 1 / (2 * 0.25) + 0.25 * 4 / 2
    assert u.item() == pytest.approx(0.5 * 2 - k * 2)
    assert estimate_rate.item() == -12.0
    (u,) = numbers(controller, [controller.output("u")], values | {"damping": 0.0})
    assert u.item() == pytest.approx(0.5 * 2 - 1.5 * 2)


@given(epsilon=positive, delta=positive)
def test_corrected_8_is_certified(epsilon, delta):
    loop = close(scalar_plant(), scalar_controller(), {"epsilon": epsilon, "delta": delta})
    assert not scalar_certificate(loop).search(samples=20, ascents=2).violated


def test_printed_8_fails():
    """V' = -(k + Delta) x^2 at theta_hat = ell: with delta = 10, eps = 0.17 the k of (8) is less
    than k_bar + delta, while 1/(2 eps^2) + eps^2 delta^2/2 >= delta always."""
    epsilon, delta, k_bar = 0.17, 10.0, 1.0
    printed = k_bar + 1 / (2 * epsilon) + epsilon**2 * delta**2 / 2
    corrected = k_bar + 1 / (2 * epsilon**2) + epsilon**2 * delta**2 / 2
    controller = scalar_controller()
    base = {"k_bar": k_bar, "gamma": 1.0, "epsilon": epsilon, "delta": delta, "damping": 1.0}
    (u,) = numbers(controller, [controller.output("u")], base | {"x": 1.0, "theta_hat": 0.0})
    assert u.item() == pytest.approx(-corrected)
    Delta = PerturbationSet(delta, (True,)).worst(np.array([-1.0])).item()
    assert -(corrected + Delta) <= -k_bar
    assert -(printed + Delta) > -k_bar
