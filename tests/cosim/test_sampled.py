"""Sampled connections: a digital controller, against the sampled-data loop solved by hand."""

import numpy as np
import pytest
from scipy.linalg import expm

from congelation.cosim import Component, Connection, System, make_coupling, simulate
from congelation.errors import InvalidInput

T, STOP = 0.1, 2.0
K, D = 2.0, 1.0


def closed_loop(delay):
    """(x1, x2, q, u) at k T: exact discretisation of plant and controller under held samples."""
    plant = expm(T * np.array([[0.0, 1.0, 0.0], [-2.25, -0.2, 1.0], [0.0, 0.0, 0.0]]))
    x, q, held = np.array([1.0, 0.5]), 0.0, np.array([1.0, 0.5])
    u = -K * x[0] - D * x[1]
    rows = [[*x, q, u]]
    for _ in range(round(STOP / T)):
        x = (plant @ [*x, u])[:2]
        q += T * held[0]
        # With a delay the output follows from the samples of before, with q as it is now.
        seen = held if delay else x
        u = -K * seen[0] - D * seen[1] - 0.5 * q
        held = x
        rows.append([*x, q, u])
    return np.array(rows)


def linear(loop):
    return loop(controller={"c": 0.0, "k": K, "d": D})


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("step", [0.1, 0.05, 0.03, 0.25])
def test_samples_follow_the_sampled_data_loop_at_any_communication_step(loop, delay, step):
    result = simulate(
        linear(loop),
        stop_time=STOP,
        step=step,
        coupling="sampled",
        options={"sample_time": T, "delay": delay},
        record=["plant.x", "controller.q", "plant.u"],
    )
    assert result.completed
    instants = [
        (round(t / T), row)
        for t, row in zip(result.time, result.values, strict=True)
        if abs(t / T - round(t / T)) < 1e-6
    ]
    assert len(instants) >= 5
    expected = closed_loop(delay)
    for k, row in instants:
        assert row == pytest.approx(expected[k], abs=1e-9)


def test_inputs_are_held_between_samples(loop):
    result = simulate(
        linear(loop),
        stop_time=1.0,
        step=0.02,
        coupling="sampled",
        options={"sample_time": 0.1},
        record=["plant.u", "plant.x[1]", "controller.x[1]"],
    )
    u, x, seen = result.values.T
    for k in range(10):
        assert len(set(u[5 * k : 5 * k + 5])) == 1
        assert set(seen[5 * k : 5 * k + 5]) == {x[5 * k]}
    assert len(set(u)) == 11
    assert len(set(x)) == 51


def test_a_delay_of_one_sample_is_what_jacobi_does_at_that_step(loop):
    record = ["plant.x", "controller.q", "controller.u"]
    one = simulate(loop(), stop_time=1.0, step=0.1, coupling="jacobi", record=record)
    two = simulate(
        loop(),
        stop_time=1.0,
        step=0.1,
        coupling="sampled",
        record=record,
        options={"sample_time": 0.1, "delay": 1},
    )
    assert np.array_equal(one.values, two.values)


def test_a_shorter_sample_time_comes_nearer_to_the_continuous_loop(loop):
    from .monolithic import order, solution

    times = (0.08, 0.04, 0.02)
    errors = [
        np.abs(
            simulate(
                loop(),
                stop_time=2.0,
                step=0.08,
                coupling="sampled",
                options={"sample_time": h},
                record=["plant.x"],
            ).values[-1]
            - solution([0.0, 2.0])[-1, :2]
        ).max()
        for h in times
    ]
    assert order(times, errors) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "needs the option 'sample_time'"),
        ({"sample_time": 0.0}, "must be positive"),
        ({"sample_time": 0.1, "delay": 2}, "0 or 1"),
        ({"sample_time": "fast"}, "coupling 'sampled'"),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(InvalidInput, match=message):
        make_coupling("sampled", options)


def test_sampling_takes_no_tolerance(loop):
    with pytest.raises(InvalidInput, match="takes a fixed step"):
        simulate(
            loop(), stop_time=1.0, tolerance=1e-3, coupling="sampled", options={"sample_time": 0.1}
        )


def test_integers_are_sampled_too(fmus):
    file = fmus / "TestDiscrete.fmu"
    system = System(
        (Component("a", file), Component("b", file)), (Connection("a.n_out", "b.n_in"),)
    )
    result = simulate(
        system,
        stop_time=1.0,
        step=0.5,
        coupling="sampled",
        options={"sample_time": 0.5, "delay": 1},
        record=["a.n_out", "b.n_out"],
    )
    assert result.values.tolist() == [[0, 0], [1, 1], [1, 2]]
