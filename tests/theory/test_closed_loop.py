"""The monolithic closed loop: names, convergence, jumps of theta, and the figures of Sec. V."""

import math

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.theory.adaptation import robust
from congelation.theory.closed_loop import SmoothPiece, close
from congelation.theory.matching import matched_controller
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.scalar import scalar_controller, scalar_plant
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import strict_feedback_plant

HALF_PERIOD = 0.65


def variations(end, constants=()):
    """theta of Sec. V: slow and fast sines, and a square wave that jumps every 0.65 s."""

    def piece(k):
        sign = 1 if k % 2 == 0 else -1
        return SmoothPiece(
            k * HALF_PERIOD,
            min((k + 1) * HALF_PERIOD, end),
            lambda t: [
                *constants,
                -3 + 0.6 * math.sin(0.4 * t) + 0.4 * sign,
                2 + 0.6 * math.cos(0.25 * t) + 0.4 * math.sin(20 * t),
            ],
        )

    return [piece(k) for k in range(math.ceil(end / HALF_PERIOD))]


def settling_time(solution):
    """Last time at which |x| is above 1e-2; x are the first two states."""
    size = np.linalg.norm(solution.states[:, :2], axis=1)
    return solution.time[np.flatnonzero(size > 1e-2)[-1]]


def figure_2(damping, end=10.0, **parameters):
    loop = close(
        strict_feedback_plant(),
        state_feedback_controller(),
        {"c": [0.5, 0.5], "epsilon": 0.3, "delta": math.sqrt(2), "damping": damping} | parameters,
    )
    start = loop.start({"x": [2, -1]})
    return loop, loop.solve(variations(end), start, np.linspace(0, end, 1001))


def test_figure_2():
    """Controller 1 settles earlier, at the price of a far larger initial control."""
    loop, proposed = figure_2(1)
    _, classical = figure_2(0)
    u = loop.output_names.index("controller.u")
    assert proposed.success
    assert classical.success
    assert settling_time(proposed) < 2.5 < settling_time(classical)
    assert abs(proposed.outputs[0, u]) > 1000
    assert abs(classical.outputs[0, u]) < 100
    assert np.abs(proposed.states[-1, :2]).max() < 1e-8


@pytest.mark.parametrize(("r", "epsilon"), [(5.0, math.sqrt(0.1)), (11.0, 0.1)])
def test_figure_3(r, epsilon):
    settling = {}
    for damping in (1, 0):
        parameters = {"c": [0.8, 0.8], "d": [0.2, 0.2], "r": r, "epsilon": epsilon}
        parameters |= {"delta": math.sqrt(2), "delta_1": 1.0, "damping": damping}
        loop = close(observer_form_plant(), output_feedback_controller(), parameters)
        solution = loop.solve(
            variations(20, [1.0]),
            loop.start({"x": [2, -1]}),
            np.linspace(0, 20, 501),
            rtol=1e-8,
            atol=1e-9,
        )
        assert solution.success
        settling[damping] = settling_time(solution)
    assert settling[1] < settling[0]


@pytest.mark.parametrize(("n", "m"), [(1, 0), (2, 1), (3, 1), (3, 2)])
def test_output_feedback_regulates_for_other_orders(n, m):
    """b(s) = (s + 2)^m, an unstable plant, a(t) fast: y and x tend to 0, all states bounded."""
    zeros = np.atleast_1d(np.poly([-2.0] * m)).tolist()
    parameters = {"delta": 0.6, "delta_1": 0.6, "sign_b_m": 1}
    loop = close(observer_form_plant(n, m), output_feedback_controller(n, m), parameters)
    center = np.array([-0.5, 0.3, 0.2][:n])
    segment = SmoothPiece(
        0, 60, lambda t: [*zeros, *(center + 0.3 * np.sin(np.array([9.0, 5.0, 14.0][:n]) * t))]
    )
    solution = loop.solve(
        [segment], loop.start({"x": [1.0, -0.5, 0.2][:n]}), [0, 60], rtol=1e-7, atol=1e-9
    )
    assert solution.success, solution.message
    assert np.abs(solution.states[-1, :n]).max() < 1e-3


def test_names_and_start_values():
    loop = close(strict_feedback_plant(), state_feedback_controller())
    estimates = ("controller.theta_hat[1]", "controller.theta_hat[2]")
    assert loop.state_names == ("plant.x[1]", "plant.x[2]", *estimates)
    assert loop.output_names[:3] == ("plant.x[1]", "plant.x[2]", "controller.u")
    assert loop.start({"theta_hat": [3, 4]}).tolist() == [1, 0, 3, 4]
    with pytest.raises(InvalidInput, match="no state is called 'y'"):
        loop.start({"y": [1]})
    with pytest.raises(InvalidInput, match="is not valid; give 2 numbers"):
        loop.start({"x": [1, 2, 3]})


def test_pieces_join_at_the_jumps():
    """One run over the jumps equals the runs between them, started where the last one ended."""
    loop, whole = figure_2(1, end=2.6)
    state = loop.start({"x": [2, -1]})
    for segment in variations(2.6):
        state = loop.solve([segment], state, [segment.end]).states[-1]
    assert whole.states[-1] == pytest.approx(state, rel=1e-9, abs=1e-11)
    assert whole.time == pytest.approx(np.linspace(0, 2.6, 1001))


def test_a_time_at_a_jump_is_reported_once():
    loop, _ = figure_2(1, end=0.1)
    times = [0.0, HALF_PERIOD, 1.0, 2 * HALF_PERIOD]
    solution = loop.solve(variations(1.3), loop.start(), times)
    assert solution.time.tolist() == times
    assert solution.states.shape == (4, 4)


def test_scalar_loop_against_its_own_equations():
    parameters = {"k_bar": 1.0, "gamma": 2.0, "epsilon": 0.5, "delta": 1.0}
    loop = close(scalar_plant(), scalar_controller(), parameters)
    k = 1 + 2 + 0.125
    x, theta_hat, theta = 0.7, -0.4, 1.3
    rate = loop.function(np.array([x, theta_hat]), [theta])
    assert rate == pytest.approx([-theta * x + theta_hat * x - k * x, -2 * x**2])


def test_outputs_are_those_of_the_states():
    loop, solution = figure_2(1, end=1.0)
    assert solution.outputs[:, :2] == pytest.approx(solution.states[:, :2])
    z = loop.output_names.index("controller.z[1]")
    assert solution.outputs[:, z] == pytest.approx(solution.states[:, 0])


def test_a_run_that_blows_up_is_reported():
    """Frozen at 0, without damping, the estimates leave the plant open-loop unstable."""
    controller = state_feedback_controller(adaptation=robust)
    loop = close(strict_feedback_plant(), controller, {"damping": 0, "adapt": 0})
    segment = SmoothPiece(0, 500, lambda t: [-30.0, 2.0])
    solution = loop.solve([segment], loop.start({"x": [2, -1]}), np.linspace(0, 500, 101))
    assert not solution.success
    assert "step size" in solution.message
    assert 0 < len(solution.time) < 101
    assert len(solution.time) == len(solution.states) == len(solution.outputs)
    assert np.isfinite(solution.states).all()


def test_refusals():
    with pytest.raises(InvalidInput, match="MatchedController wants 2 numbers of 'x'"):
        close(scalar_plant(), matched_controller())
    loop, segment = figure_2(1, end=0.1)[0], SmoothPiece(0, 1, lambda t: [0, 0])
    with pytest.raises(InvalidInput, match="within the segments, 0 to 1"):
        loop.solve([segment], loop.start(), [0, 2])
