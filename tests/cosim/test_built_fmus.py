"""The master on the FMUs of this project, against the loop solved as one system."""

from dataclasses import replace

import numpy as np
import pytest

from congelation.cosim import Output, SlavePool, adaptive_step, compiled, simulate
from congelation.cosim.step_size import StepSize
from congelation.scenario.load import load_scenario
from congelation.verify.reference import reference
from tests.scenarios import ROOT

from .monolithic import order

RECORD = ["plant.x", "controller.theta_hat", "controller.u"]


def shipped(name, variant):
    """A variant of a shipped scenario, recording what the loop feeds back and adapts."""
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    return scenario.case(scenario.variants[variant].settings)


def smooth(case):
    """The same with the square waves of theta(t) taken out."""
    components = tuple(
        replace(
            component,
            start={
                name: 0.0 if name.endswith("square[1].amplitude") else value
                for name, value in component.start.items()
            },
        )
        for component in case.system.components
    )
    return replace(case, system=replace(case.system, components=components))


def relative_error(case, result):
    """Largest error of each recorded variable over its peak."""
    assert result.completed, result.message
    solution = reference(case).solve(result.time)
    return max(
        np.abs(result.column(name) - solution[name]).max() / np.abs(solution[name]).max()
        for name in result.names
    )


@pytest.fixture(scope="module")
def pool():
    with SlavePool() as shared:
        yield shared


@pytest.mark.parametrize(
    ("coupling", "steps", "expected"),
    [
        ("jacobi", (4e-4, 2e-4, 1e-4), 1.0),
        ("gauss_seidel", (4e-4, 2e-4, 1e-4), 1.0),
        ("derivative", (4e-4, 2e-4, 1e-4), 2.0),
        ("hermite", (2e-3, 1e-3, 5e-4), 4.0),
    ],
)
def test_orders_on_a_smooth_profile(pool, coupling, steps, expected):
    case = smooth(shipped("fig2", 0))
    errors = [
        relative_error(
            case,
            simulate(
                case.system,
                stop_time=0.5,
                step=step,
                coupling=coupling,
                record=RECORD,
                slave_tolerance=1e-11,
                pool=pool,
            ),
        )
        for step in steps
    ]
    assert order(steps, errors) > expected - 0.25
    if expected < 4.0:
        assert order(steps, errors) < expected + 0.4


@pytest.mark.parametrize(("name", "share"), [("fig2", 0.9), ("fig3", 0.75)])
def test_a_chosen_order_takes_fewer_steps_than_order_four(pool, name, share):
    """Though order 6 alone would be unstable at the steps that Fig. 2 allows in the end."""
    case = shipped(name, 0)
    steps = {}
    for wanted in (None, 4):
        result = simulate(
            case.system,
            stop_time=case.experiment.stop_time,
            tolerance=1e-7,
            coupling="hermite",
            options={} if wanted is None else {"order": wanted},
            record=RECORD,
            pool=pool,
        )
        assert relative_error(case, result) < 1e-6
        steps[wanted] = result.statistics.macro_steps
    assert steps[None] < share * steps[4]


@pytest.mark.parametrize("name", ["fig2", "fig3", "fig3_r11"])
@pytest.mark.parametrize("variant", [0, 1])
def test_a_tolerance_of_1e_6_holds_over_the_whole_horizon_with_the_jumps_in(pool, name, variant):
    case = shipped(name, variant)
    stop = case.experiment.stop_time
    result = simulate(
        case.system, stop_time=stop, tolerance=1e-6, coupling="hermite", record=RECORD, pool=pool
    )
    assert result.statistics.events == int(stop / 0.65)
    assert result.statistics.estimated_error <= 1e-6
    assert relative_error(case, result) < 1e-5


def test_rejected_steps_leave_no_trace(pool, monkeypatch):
    """Every fourth attempt that would be kept is taken back once, and made again."""
    case = shipped("fig2", 0)
    kwargs = {
        "stop_time": 1.0,
        "tolerance": 1e-5,
        "coupling": "hermite",
        "record": RECORD,
        "pool": pool,
    }
    plain = simulate(case.system, **kwargs)
    tried, refused = adaptive_step.attempted, StepSize.refused
    good, forced_error = [], 2.0**1000

    def sometimes_refused(*arguments):
        trial, error = tried(*arguments)
        if error <= 1.0:
            good.append(error)
            if len(good) % 4 == 0:
                return trial, forced_error
        return trial, error

    def same_again(self, error, length, order):
        return self if error == forced_error else refused(self, error, length, order)

    monkeypatch.setattr(
        compiled.library, "loaded", lambda: None
    )  # what is patched is the Python loop
    monkeypatch.setattr(adaptive_step, "attempted", sometimes_refused)
    monkeypatch.setattr(StepSize, "refused", same_again)
    forced = simulate(case.system, **kwargs)
    count = len(good) // 4
    assert count > 20
    assert forced.statistics.rejected == plain.statistics.rejected + count
    assert np.array_equal(forced.time, plain.time)
    assert np.array_equal(forced.values, plain.values)


def test_what_no_input_sees_is_recorded_between_long_steps(pool):
    """theta_2 of Fig. 2 swings at 20 rad/s and has no der(.): steps are as short as that needs."""
    case = shipped("fig2", 1)
    result = simulate(
        case.system,
        coupling="hermite",
        tolerance=1e-6,
        stop_time=4.0,
        record=["plant.x", "plant.theta"],
        output=Output(interval=1e-3),
        pool=pool,
    )
    t = result.time
    theta_2 = 2.0 + 0.6 * np.cos(0.25 * t) + 0.4 * np.sin(20.0 * t)
    assert np.abs(result.values[:, result.names.index("plant.theta[2]")] - theta_2).max() < 1e-4
    assert result.statistics.macro_steps < 500
