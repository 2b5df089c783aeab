"""What a step computes: against scipy, across jumps of theta, in parts, with derivatives."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from tests.fmus.instance import FMUS, loaded


def theta(t, side=1.0):
    """The profile of system (60); `side` picks the limit at a jump."""
    square = math.copysign(1.0, math.sin(2 * math.pi * (t + side * 1e-9) / 1.3))
    return (
        -3.0 + 0.6 * math.sin(0.4 * t) + 0.4 * square,
        2.0 + 0.6 * math.cos(0.25 * t) + 0.4 * math.sin(20 * t),
    )


def rate(t, x, u, side):
    t1, t2 = theta(t, side)
    return [-t1 * x[0] + x[1], -t2 * x[0] + u(t)]


def reference(u, stop):
    """x(stop) of system (60), restarted at every jump of theta."""
    x, start = np.array([2.0, -1.0]), 0.0
    while start < stop:
        jump = 0.65 * (math.floor(start / 0.65 + 1e-9) + 1)
        end = min(jump, stop)
        middle = 0.5 * (start + end)

        def right(t, x, middle=middle):
            return rate(t, x, u, 1.0 if t < middle else -1.0)

        solution = solve_ivp(right, (start, end), x, method="DOP853", rtol=1e-12, atol=1e-13)
        x, start = solution.y[:, -1], end
    return x


def test_plant_with_a_cubic_input_over_two_jumps():
    """One macro step over jumps at 0.65 and 1.3 is as good as scipy restarted at them."""
    coefficients = (-1.0, 2.0, -3.0, 4.0)
    with loaded(FMUS / "StrictFeedbackPlant.fmu") as (plant,):
        plant.start()
        names = ("u", "der(u)", "der(u,2)", "der(u,3)")
        plant.assign(dict(zip(names, coefficients, strict=True)))
        assert plant.step(0.0, 1.5) == 0
        found = plant.get("x[1]", "x[2]")
        slope = plant.get("der(x[1])", "der(x[2])")

    def u(t):
        v, a, b, c = coefficients
        return v + a * t + b * t**2 / 2 + c * t**3 / 6

    expected = reference(u, 1.5)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(slope, rate(1.5, expected, u, 1.0), rtol=1e-6)


def test_a_step_in_parts():
    """One step is two half steps under constant inputs, to the tolerance."""
    with loaded(FMUS / "StrictFeedbackPlant.fmu", 2) as (whole, parts):
        for plant in (whole, parts):
            plant.start(u=3.0)
        assert whole.step(0.0, 1.0) == 0
        for k in range(16):
            assert parts.step(k / 16, 1 / 16) == 0
        np.testing.assert_allclose(whole.get("x[1]", "x[2]"), parts.get("x[1]", "x[2]"), rtol=1e-6)


def test_tolerance_of_the_experiment():
    """fmi2SetupExperiment's tolerance is the one that the states are integrated to."""
    expected = reference(lambda t: 0.0, 2.0)
    errors = []
    for tolerance in (1e-4, 1e-11):
        with loaded(FMUS / "StrictFeedbackPlant.fmu") as (plant,):
            plant.slave.setupExperiment(tolerance=tolerance, startTime=0.0)
            plant.slave.enterInitializationMode()
            plant.slave.exitInitializationMode()
            assert plant.step(0.0, 2.0) == 0
            found = np.array(plant.get("x[1]", "x[2]"))
        errors.append(np.max(np.abs(found / expected - 1.0)))
    assert errors[1] < 1e-10 < errors[0] < 1e-2


def test_theta_at_its_jumps():
    """The outputs at a jump are those after it, and next_event is the next one."""
    with loaded(FMUS / "StrictFeedbackPlant.fmu") as (plant,):
        plant.start()
        assert plant.get("next_event") == [0.65]
        assert plant.step(0.0, 0.65) == 0
        np.testing.assert_allclose(plant.get("theta[1]", "theta[2]"), theta(0.65), rtol=1e-12)
        assert plant.get("next_event") == [1.3]


def test_dtheta_is_added():
    with loaded(FMUS / "StrictFeedbackPlant.fmu") as (plant,):
        plant.start()
        before = plant.get("theta[1]", "theta[2]", "der(x[1])", "der(x[2])")
        plant.assign({"dtheta[1]": 0.5, "dtheta[2]": -0.25})
        after = plant.get("theta[1]", "theta[2]", "der(x[1])", "der(x[2])")
        # x = [2, -1]: x_1' = -theta_1 x_1 + x_2, x_2' = -theta_2 x_1 + u.
        np.testing.assert_allclose(np.subtract(after, before), [0.5, -0.25, -1.0, 0.5])


def test_filter_gain_is_scipys():
    """The Riccati equation solved inside the FMU and the one solved by the theory agree."""
    from congelation.theory.gains import iss_filter_gain

    for r, epsilon in ((5.0, math.sqrt(0.1)), (11.0, 0.1), (10.06, 0.1)):
        with loaded(FMUS / "OutputFeedbackController.fmu") as (controller,):
            controller.start(r=r, epsilon=epsilon)
            found = controller.get("k[1]", "k[2]")
            assert controller.errors() == []
        np.testing.assert_allclose(found, np.ravel(iss_filter_gain(r, epsilon, n=2)), rtol=1e-7)
