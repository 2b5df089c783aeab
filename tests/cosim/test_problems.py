"""The coupling problems: the coupled FMUs approach solutions that owe nothing to them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coupling.problems import PROBLEMS, REFERENCE, Linear, Smooth, problem
from congelation.cosim import Status, simulate

from .monolithic import order

SMOOTH = [p for p in PROBLEMS if isinstance(p.solution, Linear | Smooth)]


def error(found, parts, ability, coupling, step, stop):
    """Largest error of any variable over its peak."""
    result = simulate(
        found.system(parts, ability),
        stop_time=stop,
        step=step,
        coupling=coupling,
        record=found.record,
    )
    assert result.status is Status.COMPLETED, result.message
    exact = replace(found, stop=stop).exact(result.time)
    return (np.abs(result.values - exact).max(axis=0) / np.abs(exact).max(axis=0)).max()


@pytest.mark.parametrize("found", SMOOTH, ids=lambda found: found.name)
def test_exchanged_polynomials_approach_the_solution_with_order_four(parts, found):
    stop = min(found.stop, 100 * found.steps[0])
    steps = np.array(found.steps[:2])
    errors = [error(found, parts, "full", "hermite", step, stop) for step in steps]
    assert errors[-1] < 1e-3
    assert order(steps, errors) > 3.5


@pytest.mark.parametrize("name", ["relay", "thermostat"])
def test_relays_switch_within_two_steps(parts, name):
    found = problem(name)
    step = found.steps[-1]
    result = simulate(
        found.system(parts, "held"), stop_time=found.stop, step=step, record=["relay.y"]
    )
    switches, _, _ = found.solution.pieces(found, result.time, **REFERENCE)
    seen = result.time[1:][np.diff(result.values[:, 0]) != 0.0]
    assert len(seen) == len(switches) > 3
    # The first ones: later delays come from earlier ones, too.
    for late, true in itertools.islice(zip(seen, switches, strict=True), 2):
        assert abs(late - true) <= 2.0 * step + 1e-9


def test_names_and_sources_are_there_and_differ():
    assert len({p.name for p in PROBLEMS}) == len({p.title for p in PROBLEMS}) == len(PROBLEMS)
    assert all(p.source for p in PROBLEMS)
    assert sum(not p.known for p in PROBLEMS) >= 6
