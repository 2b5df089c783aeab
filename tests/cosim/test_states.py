"""The state of a coupling is a value: a step returns the next one and leaves its own alone."""

import copy

import numpy as np
import pytest

from congelation.cosim import (
    Derivative,
    Experiment,
    GaussSeidel,
    Hermite,
    Jacobi,
    Output,
    Sampled,
    SlavePool,
    perform,
    simulate,
)
from congelation.cosim.columns import Columns
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.session import Session
from congelation.errors import InvalidInput

ADAPTIVE = [Derivative(), Derivative("jacobi"), Hermite(), Hermite(order=6), Hermite(iterations=2)]
FIXED = [Jacobi(), GaussSeidel(), Sampled(0.03), Sampled(0.03, delay=1)]


def parts(state):
    """Every number in a state, flat."""
    if isinstance(state, tuple):
        return [number for part in state for number in parts(part)]
    return [] if state is None else np.ravel(state).tolist()


@pytest.fixture
def session(loop):
    """A function that gives a session of the test loop, initialised, and the state it begins in."""
    with SlavePool() as pool:
        system = loop().resolve()
        with pool.lend(system.members) as slaves:

            def make(coupling, tolerance=None):
                ensemble = Ensemble(
                    system,
                    slaves,
                    (),
                    derivatives=coupling.needs_derivatives,
                    slopes=False,
                    events=coupling.lands_on_events,
                )
                columns = Columns(ensemble, (), latched=False)
                made = Session(ensemble, coupling, columns, 0.0, 1.0, tolerance, None)
                made.begin(system, (), None)
                return made, made.initialise(None)

            yield make


@pytest.mark.parametrize("coupling", [*ADAPTIVE, *FIXED], ids=repr)
def test_a_step_leaves_the_state_that_it_is_given_alone(session, coupling):
    made, state = session(coupling)
    for k in range(4):
        before = copy.deepcopy(state)
        after = made.stepper.advance(state, 0.02 * k, 0.02 * (k + 1))
        assert parts(state) == parts(before)
        state = after


@pytest.mark.parametrize("coupling", ADAPTIVE, ids=repr)
def test_a_trial_that_is_dropped_can_be_repeated_to_the_bit(session, coupling):
    made, state = session(coupling, 1e-4)
    stepper, ensemble = made.stepper, made.ensemble
    for k in range(5):
        ensemble.save()
        first = stepper.attempt(state, 0.02 * k, 0.02 * (k + 1))
        read = ensemble.Y.copy()
        ensemble.restore()
        stepper.attempt(state, 0.02 * k, 0.02 * k + 0.2)  # far off, and dropped
        ensemble.restore()
        again = stepper.attempt(state, 0.02 * k, 0.02 * (k + 1))
        assert parts(again) == parts(first)
        assert np.array_equal(ensemble.Y, read)
        state = again.state


def test_simulate_is_the_experiment_of_its_arguments(loop):
    by_name = simulate(
        loop(), stop_time=1.0, tolerance=1e-4, coupling="hermite", options={"order": 4}
    )
    experiment = Experiment(stop_time=1.0, tolerance=1e-4, coupling=Hermite(order=4))
    as_value = perform(loop(), experiment)
    assert np.array_equal(by_name.time, as_value.time)
    assert np.array_equal(by_name.values, as_value.values)
    assert by_name.names == ("plant.x[1]", "plant.x[2]", "controller.u", "controller.q")


def test_an_experiment_says_which_rows_are_kept(loop):
    every = Experiment(stop_time=1.0, step=0.1, output_every=5)
    assert perform(loop(), every).time.tolist() == [0.0, 0.5, 1.0]
    grid = Experiment(stop_time=1.0, step=0.1, output_interval=0.25)
    assert perform(loop(), grid).time.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert len(perform(loop(), grid, output=Output()).time) == 11


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"stop_time": 0.0, "step": 0.1}, "after start_time"),
        ({"stop_time": 1.0}, "give a communication step or a tolerance"),
        ({"stop_time": 1.0, "tolerance": 2.0}, "between 0 and 1"),
        ({"stop_time": 1.0, "step": 0.1, "coupling": "jakobi"}, "did you mean 'jacobi'"),
        (
            {"stop_time": 1.0, "step": 0.1, "coupling": Hermite(), "options": {"order": 4}},
            "options go with the name",
        ),
    ],
)
def test_an_experiment_that_no_run_can_have_does_not_exist(keys, message):
    with pytest.raises(InvalidInput, match=message):
        Experiment(**keys)
