"""The law inside StateFeedbackController against a derivation by hand for n = 2.

System (60): phi_1 = [-x_1, 0], phi_2 = [0, -x_1]. With Gamma = I, the two steps of the recursion
written out, all partial derivatives taken by hand:

    z_1 = x_1,  w_1 = [-x_1, 0],  s = c_1 + (1/eps^2 + eps^2 delta^2)/2,  a = s - theta_hat_1
    alpha_1 = -a x_1,  dalpha_1/dx_1 = -a,  dalpha_1/dtheta_hat = [x_1, 0]
    z_2 = x_2 + a x_1,  w_2 = phi_2 + a phi_1 = [-a x_1, -x_1]
    wbar_11 = [-1, 0],  wbar_21 = [-a, -1],  wbar_22 = 0
    theta_hat' = w_1 z_1 + w_2 z_2
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.fmus.instance import FMUS, loaded

NUMBER = st.floats(-3.0, 3.0)
GAIN = st.floats(0.1, 2.0)


def law_by_hand(x, theta_hat, c, epsilon, delta, damping):
    """u and theta_hat' of the two steps written out."""
    x1, x2 = x
    t1, t2 = theta_hat
    half = 0.5 * (epsilon * delta) ** 2 if damping else 0.0
    inverse = 1.0 / epsilon**2 if damping else 0.0
    a = c[0] + 0.5 * inverse + half - t1
    z2 = x2 + a * x1
    w1, w2 = np.array([-x1, 0.0]), np.array([-a * x1, -x1])
    rate = w1 * x1 + w2 * z2
    # g_21 = wbar_21 . wbar_11 = a, g_22 = |wbar_21|^2 + |wbar_22|^2 = a^2 + 1,
    # zeta_2 = -g_21/eps^2 z_1 - (1/2)(g_22/eps^2 + eps^2 delta^2) z_2
    zeta2 = -inverse * a * x1 - (0.5 * inverse * (a**2 + 1.0) + half) * z2
    u = -x1 - c[1] * z2 - a * x2 - w2 @ np.array([t1, t2]) + x1 * rate[0] + zeta2
    return u, rate


@pytest.fixture(scope="module")
def controller():
    with loaded(FMUS / "StateFeedbackController.fmu") as (instance,):
        yield instance


@given(
    st.tuples(NUMBER, NUMBER),
    st.tuples(NUMBER, NUMBER),
    st.tuples(GAIN, GAIN),
    GAIN,
    GAIN,
    st.booleans(),
)
def test_control(controller, x, theta_hat, c, epsilon, delta, damping):
    start = {
        "c[1]": c[0],
        "c[2]": c[1],
        "epsilon": epsilon,
        "delta": delta,
        "damping": damping,
        "theta_hat0[1]": theta_hat[0],
        "theta_hat0[2]": theta_hat[1],
    }
    controller.slave.reset()
    controller.start(**start, **{"x[1]": x[0], "x[2]": x[1]})
    (u,) = controller.get("u")
    expected, _ = law_by_hand(x, theta_hat, c, epsilon, delta, damping)
    assert math.isclose(u, expected, rel_tol=1e-9, abs_tol=1e-9)


@settings(max_examples=30)
@given(st.tuples(NUMBER, NUMBER), st.tuples(NUMBER, NUMBER), st.booleans())
def test_adaptation(controller, x, theta_hat, damping):
    """Over a step with held x, theta_hat follows the rate by hand, integrated by scipy."""
    h = 0.005  # with x held, theta_hat escapes in finite time: a' = x_1^2 (1 + a^2) + a x_1 x_2
    start = {"theta_hat0[1]": theta_hat[0], "theta_hat0[2]": theta_hat[1], "damping": damping}
    controller.slave.reset()
    controller.start(**start, **{"x[1]": x[0], "x[2]": x[1]})
    assert controller.step(0.0, h) == 0

    def rate(_, estimate):
        return law_by_hand(x, estimate, (0.5, 0.5), 0.3, math.sqrt(2.0), damping)[1]

    expected = solve_ivp(rate, (0.0, h), theta_hat, method="Radau", rtol=1e-9, atol=1e-11)
    found = controller.get("theta_hat[1]", "theta_hat[2]")
    np.testing.assert_allclose(found, expected.y[:, -1], rtol=1e-6, atol=1e-8)


def test_exact_derivative(controller):
    """der(u) is the slope of u along the motion that der(x) and the law's own rate describe."""
    x, slope, theta_hat = np.array([2.0, -1.0]), np.array([4.0, -30.0]), np.array([0.3, -0.2])
    controller.slave.reset()
    controller.start(
        **{"theta_hat0[1]": theta_hat[0], "theta_hat0[2]": theta_hat[1]},
        **{"x[1]": x[0], "x[2]": x[1], "der(x[1])": slope[0], "der(x[2])": slope[1]},
    )
    (found,) = controller.get("der(u)")
    gains = ((0.5, 0.5), 0.3, math.sqrt(2.0), True)
    _, rate = law_by_hand(x, theta_hat, *gains)
    h = 1e-6
    ahead, _ = law_by_hand(x + h * slope, theta_hat + h * rate, *gains)
    behind, _ = law_by_hand(x - h * slope, theta_hat - h * rate, *gains)
    assert math.isclose(found, (ahead - behind) / (2 * h), rel_tol=1e-6)
