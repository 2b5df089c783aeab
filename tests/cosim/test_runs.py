"""Whole runs: times, rows, statuses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from congelation.cosim import (
    COUPLINGS,
    Component,
    Connection,
    Output,
    Sampled,
    SlavePool,
    Status,
    System,
    make_coupling,
    perform,
    simulate,
)
from congelation.cosim.coupling import Hermite
from congelation.cosim.experiment import step_count
from congelation.errors import InvalidInput
from congelation.fmi.slave import Slave
from congelation.scenario.load import load_scenario
from tests.scenarios import ROOT

FIXED = ("jacobi", "gauss_seidel", "derivative", "hermite")


@pytest.mark.parametrize("coupling", FIXED)
def test_rows_stand_at_the_grid_points(loop, coupling):
    result = simulate(loop(), start_time=0.2, stop_time=0.9, step=0.1, coupling=coupling)
    assert result.status is Status.COMPLETED
    assert result.time.tolist() == [*(0.2 + k * 0.1 for k in range(7)), 0.9]
    assert result.values.shape == (8, 4)
    assert result.statistics.macro_steps == 7


@pytest.mark.parametrize("coupling", FIXED)
def test_the_last_step_is_shortened(loop, coupling):
    result = simulate(loop(), stop_time=1.0, step=0.3, coupling=coupling)
    assert result.time.tolist() == [0.0, 0.3, 0.6, 3 * 0.3, 1.0]


def test_many_steps_do_not_drift(fmus):
    system = System((Component("d", fmus / "TestDiscrete.fmu"),))
    result = simulate(system, stop_time=1000.0, step=0.1, coupling="jacobi", record=["d.y"])
    assert result.time[-1] == 1000.0
    assert np.array_equal(result.time[1:-1], 0.1 * np.arange(1, 10000))
    assert np.array_equal(result.values[1:, 0], result.time[1:])


@pytest.mark.parametrize(
    ("start", "stop", "step", "count"),
    [
        (0, 1, 0.1, 10),
        (0, 0.3, 0.1, 3),
        (0, 1, 0.3, 4),
        (0, 1, 5, 1),
        (2, 12, 1e-3, 10000),
        (0, 1e4, 1e-3, 10**7),
        (0, 1.0000001, 0.1, 11),
        (86400, 86400.7, 0.1, 7),
        (86400, 86400.7001, 0.1, 8),
    ],
)
def test_the_step_count(start, stop, step, count):
    assert step_count(start, stop, step) == count


@pytest.mark.parametrize("coupling", FIXED)
def test_the_first_row_is_consistent_at_the_start(loop, coupling):
    result = simulate(loop(), stop_time=0.1, step=0.1, coupling=coupling)
    x1, x2, u, q = result.values[0]
    assert (x1, x2, q) == (1.0, 0.5, 0.0)
    assert u == -2.0 * 1.0 - 1.0 * 0.5 - 0.3


def test_a_recorded_input_has_the_value_of_its_source(loop):
    result = simulate(
        loop(),
        stop_time=0.5,
        step=0.1,
        coupling="jacobi",
        record=["plant.u", "controller.u", "controller.x", "plant.x", "plant.w"],
    )
    assert np.array_equal(result.column("plant.u"), result.column("controller.u"))
    assert np.array_equal(result.column("controller.x"), result.column("plant.x"))
    assert set(result.column("plant.w")) == {1.5}


def test_an_unconnected_input_is_held_at_its_start_value(fmus):
    system = System((Component("g", fmus / "TestGain.fmu", {"k": 2.0, "u": 3.0}),))
    result = simulate(system, stop_time=1.0, step=0.25)
    assert set(result.column("g.y")) == {6.0}


def test_integers_booleans_and_strings_are_carried_over(fmus):
    file = fmus / "TestDiscrete.fmu"
    system = System(
        (Component("a", file, {"n_in": 5, "b_in": True, "s_in": "x"}), Component("b", file)),
        (
            Connection("a.n_out", "b.n_in"),
            Connection("a.b_out", "b.b_in"),
            Connection("a.s_out", "b.s_in"),
        ),
    )
    result = simulate(
        system, stop_time=3.0, step=1.0, coupling="jacobi", record=["a.n_out", "b.n_out", "b.b_out"]
    )
    # b sees at the start of each step what a gave at the end of the step before.
    assert result.column("a.n_out").tolist() == [0, 6, 6, 6]
    assert result.column("b.n_out").tolist() == [0, 1, 7, 7]
    assert result.column("b.b_out").tolist() == [0, 1, 1, 1]


@pytest.mark.parametrize("coupling", ["jacobi", "gauss_seidel", "derivative"])
def test_the_order_of_discrete_connections_does_not_matter(fmus, coupling):
    """A chain a -> b -> c that counts, against a loop written out."""
    file = fmus / "TestDiscrete.fmu"
    components = tuple(Component(name, file) for name in "abc")
    links = (Connection("a.n_out", "b.n_in"), Connection("b.n_out", "c.n_in"))
    one, two = (
        simulate(
            System(components, chosen),
            stop_time=5.0,
            step=1.0,
            coupling=coupling,
            record=["a.n_out", "b.n_out", "c.n_out"],
        )
        for chosen in (links, links[::-1])
    )
    given, found, rows = [0, 0, 0], [0, 0, 0], [[0, 0, 0]]
    for _ in range(5):
        if coupling == "gauss_seidel":  # each with the newest values there are
            for m in range(3):
                given[1:] = found[:2]
                found[m] = given[m] + 1
        else:
            found = [number + 1 for number in given]
            given[1:] = found[:2]
        rows.append(list(found))
    assert one.values.tolist() == two.values.tolist() == rows


@pytest.mark.parametrize("kwargs", [{"step": 0.01}, {"tolerance": 1e-6, "coupling": "hermite"}])
def test_max_steps_ends_a_run(loop, kwargs):
    result = simulate(loop(), stop_time=10.0, max_steps=7, **kwargs)
    assert result.status is Status.TOO_MANY_STEPS
    assert len(result.time) == 8 - result.statistics.rejected
    assert f"reached t = {result.time[-1]:.9g} of 10" in result.message
    enough = simulate(loop(), stop_time=0.07, step=0.01, max_steps=7)
    assert enough.completed


@pytest.mark.parametrize("coupling", FIXED)
def test_a_failing_fmu_ends_the_run_and_keeps_its_rows(fmus, coupling):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 1.0, "at": 0.5}),))
    options = {"iterations": 1} if coupling == "hermite" else None
    result = simulate(system, stop_time=1.0, step=0.125, coupling=coupling, options=options)
    assert result.status is Status.SLAVE_FAILED
    assert result.message == "f at t = 0.5: the valve is stuck, 100% open"
    assert result.time.tolist() == [0.0, 0.125, 0.25, 0.375, 0.5]
    assert not result.completed


def test_an_fmu_that_crashes_ends_the_run(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 2.0, "at": 0.5}),))
    result = simulate(system, stop_time=1.0, step=0.125)
    assert result.status is Status.SLAVE_FAILED
    assert "the slave fell over" in result.message
    assert len(result.time) == 5


def test_ctrl_c_inside_an_fmu_interrupts_the_run(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 4.0, "at": 0.5}),))
    with pytest.raises(KeyboardInterrupt):
        simulate(system, stop_time=1.0, step=0.125)


def test_a_refused_parameter_ends_the_run_before_it_begins(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"r": -200.0}),))
    result = simulate(system, stop_time=1.0, step=0.125)
    assert result.status is Status.SLAVE_FAILED
    assert "r = -200 is refused: it must be at least -100" in result.message
    assert len(result.time) == 0


@pytest.mark.parametrize("coupling", FIXED)
def test_a_value_that_is_not_finite_is_named(fmus, coupling):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 3.0, "at": 0.5}),))
    options = {"iterations": 1} if coupling == "hermite" else None
    result = simulate(
        system, stop_time=1.0, step=0.125, coupling=coupling, options=options, record=["f.y"]
    )
    assert result.status is Status.NON_FINITE
    assert result.message == "f.y at t = 0.625 is nan"
    assert result.time[-1] == 0.5
    assert np.isfinite(result.values).all()


@pytest.mark.parametrize("kwargs", [{"step": 0.5}, {"tolerance": 1e-4}])
def test_a_diverging_run_is_named(fmus, kwargs):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"r": 40.0}),))
    coupling = "derivative" if "step" in kwargs else "hermite"
    result = simulate(system, stop_time=100.0, coupling=coupling, record=["f.y"], **kwargs)
    assert result.status is Status.DIVERGED
    assert "f.y at t = " in result.message
    assert result.message.endswith("past 1e+100")
    assert np.abs(result.values).max() <= 1e100


def test_an_unstable_coupling_is_a_status(loop):
    result = simulate(
        loop(controller={"k": 1e4, "d": 1e4}), stop_time=50.0, step=0.1, coupling="jacobi"
    )
    assert result.status in (Status.DIVERGED, Status.NON_FINITE)
    assert np.isfinite(result.values).all()


@pytest.mark.parametrize("status", Status)
def test_every_status_is_a_sentence(status):
    assert status.value.endswith(".")
    assert status.value[0].isupper()


def test_a_pool_gives_the_same_run_again(loop):
    with SlavePool() as pool:
        one, two = (
            simulate(loop(), stop_time=1.0, step=0.1, coupling="hermite", pool=pool)
            for _ in range(2)
        )
    fresh = simulate(loop(), stop_time=1.0, step=0.1, coupling="hermite")
    assert np.array_equal(one.values, two.values)
    assert np.array_equal(one.values, fresh.values)


def test_a_pool_survives_a_failing_run(fmus):
    file = fmus / "TestFaulty.fmu"
    with SlavePool() as pool:
        for mode in (1.0, 2.0, 0.0):
            system = System((Component("f", file, {"mode": mode, "at": 0.5}),))
            result = simulate(system, stop_time=1.0, step=0.25, pool=pool)
    assert result.completed


def test_progress_goes_from_the_start_to_one(loop):
    heard = []
    simulate(loop(), stop_time=1.0, step=0.1, progress=heard.append)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"stop_time": 0.0, "step": 0.1}, "must be finite and after start_time"),
        ({"stop_time": math.inf, "step": 0.1}, "stop_time = inf is not valid; give a finite"),
        ({"stop_time": 1.0}, "give a communication step or a tolerance"),
        ({"stop_time": 1.0, "step": -0.1}, "step -0.1 must be positive"),
        ({"stop_time": 1.0, "step": math.nan}, "step = nan is not valid; give a finite"),
        ({"stop_time": 1.0, "step": 1e-300}, "step 1e-300 is too small from 0 to 1"),
        ({"stop_time": 1.0, "tolerance": 1e-3, "step": 1e-17}, "too small"),
        ({"start_time": 1e17, "stop_time": 1e17 + 1e4, "step": 10.0}, "it is at least 2.6e+02"),
        ({"stop_time": 1e308, "step": 0.1}, "too small from 0 to 1e+308"),
        ({"start_time": -1e308, "stop_time": 1e308, "step": 0.1}, "must be finite"),
        ({"stop_time": 1.0, "step": 0.1, "output": Output(interval=0.0)}, "output interval 0"),
        ({"stop_time": 1.0, "step": 0.1, "output": Output(interval=1e-13)}, "output interval"),
        (
            {"stop_time": 1.0, "step": 0.1, "coupling": Sampled(1e-300)},
            "sample_time 1e-300 is too small",
        ),
        (
            {"stop_time": 1.0, "step": 0.1, "max_steps": 0},
            "max_steps = 0 is not valid; give a whole",
        ),
        ({"stop_time": 1.0, "step": 0.1, "max_steps": 1.5}, "max_steps = 1.5 is not valid"),
        ({"stop_time": 1.0, "step": 0.1, "max_steps": True}, "max_steps = true is not valid"),
        ({"stop_time": None, "step": 0.1}, "stop_time = None is not valid; give a number"),
        ({"stop_time": 10**400, "step": 0.1}, "is not valid; give a finite number"),
        ({"stop_time": 1.0, "step": 0.1, "coupling": None}, "coupling = None is not valid; give"),
        ({"stop_time": 1.0, "step": 0.1, "coupling": Hermite}, "coupling = the class Hermite"),
        (
            {"stop_time": 1.0, "step": 0.1, "output": 0.5},
            "output = 0.5 is not valid; give",
        ),
        ({"stop_time": 1.0, "step": 0.1, "output": ["x"]}, "output = ['x'] is not valid"),
        ({"stop_time": 1.0, "step": 0.1, "record": "plant.x"}, "record = 'plant.x' is not valid"),
        ({"stop_time": 1.0, "step": 0.1, "record": [1]}, "record = [1] is not valid"),
        ({"stop_time": 1.0, "step": 0.1, "options": "x"}, "options = 'x' is not valid"),
        ({"stop_time": 1.0, "step": 0.1, "slave_tolerance": -1.0}, "slave_tolerance -1 must be"),
        ({"stop_time": 1.0, "tolerance": 0.0}, "must lie between 0 and 1"),
        ({"stop_time": 1.0, "tolerance": 1e-150}, "1e-15 at least"),
        ({"stop_time": 1.0, "step": 0.1, "coupling": "jakobi"}, "did you mean 'jacobi'"),
        (
            {"stop_time": 1.0, "step": 0.1, "coupling": "hermite", "options": {"iteration": 2}},
            "did you mean 'iterations'",
        ),
        ({"stop_time": 1.0, "tolerance": 1e-3, "coupling": "jacobi"}, "takes a fixed step"),
    ],
)
def test_wrong_requests_are_refused(loop, kwargs, message):
    with pytest.raises(InvalidInput) as caught:
        simulate(loop(), **kwargs)
    assert message in str(caught.value)


def test_options_belong_to_a_name(loop):
    with pytest.raises(InvalidInput, match="options go with the name"):
        simulate(
            loop(),
            stop_time=1.0,
            step=0.1,
            coupling=make_coupling("hermite"),
            options={"iterations": 2},
        )


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("hermite", {"iterations": 0}, "iterations 0"),
        ("hermite", {"max_iterations": 0}, "max_iterations 0"),
        ("hermite", {"tolerance": -1.0}, "must lie between 0 and 1"),
        ("hermite", {"tolerance": math.inf}, "must lie between 0 and 1"),
        ("hermite", {"iterations": 1.5}, "iterations = 1.5 is not valid; give an integer"),
        ("hermite", {"iterations": True}, "iterations = true is not valid; give an integer"),
        ("hermite", {"order": 5}, "order 5; valid: 4, 6"),
        ("hermite", {"order": "6"}, "order = '6' is not valid; give an integer"),
        ("hermite", {"acceleration": 1}, "acceleration = 1 is not valid; give a text"),
        ("sampled", {"sample_time": "0.1"}, "sample_time = '0.1' is not valid; give a number"),
        ("sampled", {"sample_time": 0.1, "delay": 2}, "delay 2"),
        ("hermite", {"acceleration": "magic"}, "broyden"),
        ("derivative", {"sequence": "zeidel"}, "gauss_seidel"),
        ("jacobi", {"step": 1.0}, "takes no options"),
    ],
)
def test_options_are_checked(name, options, message):
    with pytest.raises(InvalidInput, match=message):
        make_coupling(name, options)


def test_the_registry_holds_every_coupling_by_its_name():
    assert all(kind.name == name for name, kind in COUPLINGS.items())


def test_a_result_gives_columns_and_vectors(loop):
    result = simulate(loop(), stop_time=0.2, step=0.1)
    assert result.column("plant.x").shape == (3, 2)
    assert result.column("plant.x[2]").tolist() == result.column("plant.x")[:, 1].tolist()
    with pytest.raises(InvalidInput, match="no column"):
        result.column("plant.y")


def test_a_system_may_have_no_links_and_nothing_to_record(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu"),))
    result = simulate(system, stop_time=1.0, step=0.5, record=[], coupling="jacobi")
    assert result.values.shape == (3, 0)


def test_a_pool_keeps_what_is_set_up_and_nothing_of_earlier_runs() -> None:
    """Start values, couplings and steps change; each run is as in a pool of its own."""
    case = load_scenario(ROOT / "scenarios" / "fig2.toml").case({})
    plant, controller = case.system.components
    held = {"coupling": "jacobi", "tolerance": None, "step": 1e-3}
    derivative = {"coupling": "derivative", "tolerance": None, "step": 1e-3}
    changes = [
        ({}, 0.3),
        ({}, 0.26),
        (held, 0.3),
        (derivative, 0.3),
        (held, 0.26),
        ({"max_steps": 20}, 0.3),
        (derivative, 0.26),
        ({}, 0.3),
    ]
    with SlavePool() as pool:
        for change, epsilon in changes:
            start = {**controller.start, "epsilon": epsilon}
            system = replace(case.system, components=(plant, replace(controller, start=start)))
            short = replace(case.experiment, stop_time=0.5, output_interval=None, **change)
            found, wanted = perform(system, short, pool=pool), perform(system, short)
            assert (found.status, found.message) == (wanted.status, wanted.message)
            np.testing.assert_array_equal(found.values, wanted.values)
            assert replace(found.statistics, wall_time=0.0) == replace(
                wanted.statistics, wall_time=0.0
            )


def test_strings_of_reset_instances_are_read_only_where_runs_set_them(fmus, monkeypatch):
    """Some FMUs (libcosim's quarter truck) give addresses of Strings that hold none."""
    kinds, get_values = [], Slave.get_values

    def noted(self, kind, references):
        kinds.append(kind)
        return get_values(self, kind, references)

    monkeypatch.setattr(Slave, "get_values", noted)
    file = fmus / "TestDiscrete.fmu"
    plain, worded = (System((Component("a", file, start),)) for start in ({}, {"s_in": "x"}))
    read = []
    with SlavePool() as pool:
        for system in (plain, plain, worded, plain, plain):
            kinds.clear()
            result = simulate(
                system, stop_time=2.0, step=1.0, coupling="jacobi", record=["a.y"], pool=pool
            )
            assert result.completed
            read.append(("Integer" in kinds, "String" in kinds))
    # Instances are compared before the first use again, and anew once a String was set.
    assert read == [(False, False), (True, False), (False, False), (True, True), (False, False)]
