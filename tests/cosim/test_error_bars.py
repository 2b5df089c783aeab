"""Error bars: what they cover, what they cost, and what is said where there are none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.coupling.problems import Problem, problem
from congelation.cosim import (
    Component,
    Output,
    ParquetFile,
    Status,
    System,
    rerun_process,
    simulate,
)
from congelation.cosim.bands import FLOOR, MARGIN, amplified, bands, error_name, variable_of
from congelation.cosim.error_bars import trusted
from congelation.cosim.experiment import Experiment
from congelation.cosim.master import perform
from congelation.errors import InvalidInput


def run(found: Problem, parts, ability, coupling, **more):
    return simulate(
        found.system(parts, ability),
        **{"stop_time": found.stop, "coupling": coupling, "record": found.record, **more},
    )


def test_a_band_is_laid_over_the_maxima_of_the_difference():
    time = np.linspace(0.0, 10.0, 1001)
    difference = 0.1 * np.sin(5.0 * time)[:, None]
    found = bands(time, difference, 1.0)[:, 0]
    # Twice the difference is the error of order 1; its zeros leave no gaps but at the ends.
    assert found.max() == pytest.approx(MARGIN * 0.2, rel=1e-3)
    assert found[100:-100].min() > 0.99 * found.max()
    assert (found >= MARGIN * 2.0 * np.abs(difference[:, 0])).all()


def test_an_error_that_alternates_is_not_taken_for_half_of_the_other_run():
    """The second run has made twice as many steps, by which such errors decay."""
    time = np.linspace(0.0, 10.0, 1001)
    difference = ((-1.0) ** np.arange(1001) * np.sin(0.1 * np.pi * time) ** 2)[:, None]
    found = bands(time, difference, 1.0, every_step=True)[1:-1]
    usual = bands(time, difference, 1.0)[1:-1]
    np.testing.assert_allclose(found[100:-100] / usual[100:-100], 0.5, rtol=0.02)
    assert (found >= np.abs(difference[1:-1])).all()
    smooth = np.sin(5.0 * time)[:, None]
    same = bands(time, smooth, 1.0, every_step=True)
    np.testing.assert_allclose(same, bands(time, smooth, 1.0), rtol=1e-3)


def test_a_band_follows_the_times_and_not_the_rows():
    time = np.concatenate([np.linspace(0.0, 1.0, 1000), np.linspace(1.1, 10.0, 10)])
    difference = np.zeros((len(time), 1))
    difference[500] = 1.0
    near = np.abs(time - time[500]) <= 0.1
    found = bands(time, difference, 4.0)[:, 0]
    assert found[near] == pytest.approx(MARGIN * 16.0 / 15.0)
    assert found[-5:].max() == 0.0


def test_a_difference_that_grows_by_itself_is_told_from_errors_that_add_up():
    time = np.linspace(0.0, 10.0, 1001)
    grows = amplified(time, 1e-5 * np.exp(1.2 * time))
    # 40 times what it was at half of the time; rows up to 0.1 s later count.
    assert time[grows.argmax()] == pytest.approx((np.log(40.0) - 0.12) / 0.6, abs=0.011)
    assert grows[grows.argmax() :].all()
    for adds_up in (1e-3 * time, 1e-3 * time**4, 1e-3 * np.minimum(np.exp(5.0 * time - 15.0), 1.0)):
        assert not amplified(time, adds_up).any()
    assert not amplified(time, 1e-3 * FLOOR * np.exp(1.2 * time)).any()


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
def test_chaos_is_told_in_time(parts, tolerance):
    """At 1e-4, what grows of the early errors is by chance nearly the same in both runs."""
    lorenz = problem("lorenz")
    result = run(lorenz, parts, "full", "hermite", tolerance=tolerance, trust=True)
    assert result.trust.verdicts == ("not resolved",) * 3
    exact = lorenz.exact(result.time)
    wrong = np.abs(result.values[:, :3] - exact) > 0.1 * np.abs(exact).max(axis=0)
    for since, column in zip(result.trust.since, wrong.T, strict=True):
        assert since <= result.time[column.argmax()]


@pytest.mark.parametrize(
    ("name", "ability", "coupling", "how"),
    [
        ("two_masses_force", "fixed", "jacobi", {"step": 0.01}),
        ("two_masses_loop", "held", "derivative", {"step": 0.02}),
        ("chain", "full", "hermite", {"step": 0.1}),
        ("predator_prey", "full", "hermite", {"tolerance": 1e-4}),
        ("ladder", "state", "hermite", {"tolerance": 1e-3}),
        ("ladder", "state", "derivative", {"tolerance": 1e-3}),
    ],
)
def test_bars_cover_the_error_and_are_not_much_wider(parts, name, ability, coupling, how):
    found = problem(name)
    result = run(found, parts, ability, coupling, trust=True, **how)
    count = len(found.record)
    assert result.names == (*found.record, *map(error_name, found.record))
    error = np.abs(result.values[:, :count] - found.exact(result.time))
    assert (result.trust.bands == result.values[:, count:]).all()
    assert (result.trust.bands.max(axis=0) >= error.max(axis=0)).all()
    assert (result.trust.bands >= error - 1e-9).mean(axis=0).min() > 0.95
    floor = 1.1 * FLOOR * np.abs(result.values[:, :count]).max(axis=0)
    assert (result.trust.bands.max(axis=0) <= np.maximum(2.5 * error.max(axis=0), floor)).all()
    assert result.trust.runs <= 3.05
    assert result.trust.error == result.trust.relative.max()
    assert "of each peak" in result.trust.line


def test_bars_change_nothing_of_the_run(parts):
    found = problem("ladder")
    plain = run(found, parts, "full", "hermite", tolerance=1e-3)
    result = run(found, parts, "full", "hermite", tolerance=1e-3, trust=True)
    assert (result.values[:, :3] == plain.values).all()
    assert replace(result.statistics, wall_time=0.0) == replace(plain.statistics, wall_time=0.0)


def test_rows_of_their_own_times_get_bars_as_well(parts, tmp_path):
    found = problem("ladder")
    output = Output(interval=0.05)
    result = run(found, parts, "held", "jacobi", step=0.02, trust=True, output=output)
    error = np.abs(result.values[:, :3] - found.exact(result.time))
    assert (result.trust.bands.max(axis=0) >= error.max(axis=0)).all()
    kept = replace(output, sink=ParquetFile(tmp_path / "rows.parquet"))
    other = run(found, parts, "held", "jacobi", step=0.02, trust=True, output=kept)
    assert (other.trust.bands == result.trust.bands).all()
    assert len(other.values) == 1
    every = run(found, parts, "held", "jacobi", step=0.02, trust=True, output=Output(every=7))
    assert every.trust.error == pytest.approx(result.trust.error, rel=0.1)


@pytest.mark.parametrize(
    ("name", "ability", "coupling"),
    [("relay", "held", "jacobi"), ("ladder", "full", "hermite"), ("ladder", "state", "hermite")],
)
def test_a_second_process_finds_the_same(parts, monkeypatch, name, ability, coupling):
    found = problem(name)
    alone = run(found, parts, ability, coupling, step=0.02, trust=True)
    monkeypatch.setattr(rerun_process, "LOOKED_AT", 0.0)
    monkeypatch.setattr(rerun_process, "WORTH", 0.0)
    monkeypatch.setattr(rerun_process, "PROCESSORS", 1)
    started = []
    start = rerun_process.Ahead._start
    monkeypatch.setattr(
        rerun_process.Ahead, "_start", lambda self: (started.append(self), start(self))
    )
    beside = run(found, parts, ability, coupling, step=0.02, trust=True)
    assert len(started) == 1
    assert (beside.values == alone.values).all()
    assert beside.trust.line == alone.trust.line
    assert not Path(started[0]._folder.name).exists()


def test_a_second_process_that_dies_is_replaced(parts, monkeypatch):
    found = problem("relay")
    alone = run(found, parts, "held", "jacobi", step=0.02, trust=True)
    monkeypatch.setattr(rerun_process, "LOOKED_AT", 0.0)
    monkeypatch.setattr(rerun_process, "WORTH", 0.0)
    monkeypatch.setattr(rerun_process, "PROCESSORS", 1)
    monkeypatch.setattr(rerun_process, "MODULE", "congelation.no_such_module")
    assert run(found, parts, "held", "jacobi", step=0.02, trust=True).trust.line == alone.trust.line


def test_large_errors_are_flagged_with_the_time_from_which_on(parts):
    result = run(problem("van_der_pol_5"), parts, "held", "jacobi", step=0.02, trust=True)
    assert result.trust.verdict == "not resolved"
    assert "may be off by" in result.trust.line
    assert 0.0 < min(result.trust.since) < 20.0


def test_a_switched_variable_is_told_by_when_it_differs(parts):
    result = run(problem("relay"), parts, "held", "jacobi", step=0.005, trust=True)
    assert result.trust.relative[2] < 0.05
    assert result.trust.verdicts[2] == "resolved"
    exact = problem("relay").exact(result.time)[:, 2]
    wrong = exact != result.column("relay.y")
    assert (result.column("error(relay.y)")[wrong] > 0.0).mean() > 0.9


def test_steps_without_a_switch_make_no_band_of_late_switches(parts):
    """Chosen steps are short at switches, and long between them."""
    found = problem("thermostat")
    result = run(found, parts, "state", "hermite", tolerance=1e-2, trust=True)
    error = np.abs(result.values[:, :2] - found.exact(result.time)[:, :2])
    found_bands = result.trust.bands[:, :2]
    assert (found_bands >= error).mean(axis=0).min() > 0.95
    assert (found_bands.max(axis=0) >= error.max(axis=0)).all()
    assert result.trust.verdicts[:2] == ("rough", "resolved")  # of errors of 2 %


def test_a_second_run_that_fails_leaves_the_first_with_its_error_unknown(parts):
    result = run(problem("algebraic_loop_1.05"), parts, "held", "jacobi", step=1e-3, trust=True)
    assert result.completed
    assert result.trust.error is None
    assert result.trust.verdict == "DIVERGED"
    assert result.trust.line.startswith("trust: the error is unknown: the second run: ")
    assert result.names == ("a.y1", "b.y1")


def test_the_second_run_may_iterate_longer_as_its_steps_are_given(parts):
    loop = problem("algebraic_loop_0.3")
    result = run(loop, parts, "state", "hermite", tolerance=1e-2, trust=True)
    error = np.abs(result.values[:, : len(loop.record)] - loop.exact(result.time))
    assert result.trust.verdict == "resolved"
    assert (error <= result.trust.bands + 1e-9).all()


def test_a_run_that_fails_has_no_bars(parts):
    result = run(problem("algebraic_loop_1.05"), parts, "held", "jacobi", step=4e-4, trust=True)
    assert result.status is Status.DIVERGED
    assert result.trust.line == "trust: the error is unknown: the run did not come to its end"


def test_the_order_tells_a_loop_gain_above_one(parts):
    found = problem("algebraic_loop_1.05")
    result = run(found, parts, "held", "jacobi", step=0.02, trust="order")
    assert result.trust.order < 0.0
    assert result.trust.verdict == "not resolved"
    assert "gets worse as steps shrink" in result.trust.line
    good = run(found, parts, "full", "derivative", step=0.02, trust="order")
    assert good.trust.order == pytest.approx(2.0, abs=0.2)
    assert good.trust.runs == pytest.approx(3.5, abs=0.02)


def test_the_probe_finds_an_inner_step(parts):
    def pendulum(inner):
        start = {"g": 9.81, "x0[1]": 1.0, "inner": inner}
        return System((Component("pendulum", parts / "pendulum_fixed.fmu", start),))

    coarse = simulate(pendulum(0.2), stop_time=8.0, step=0.4, trust="probe")
    assert coarse.trust.error <= 1e-7  # nothing of it shows in two runs
    assert coarse.trust.verdict == "not resolved"
    assert "an FMU steps inside on a grid of its own" in coarse.trust.line
    fine = simulate(pendulum(1e-3), stop_time=8.0, step=0.4, trust="probe")
    assert fine.trust.verdict == "resolved"
    assert "no inner step" in fine.trust.line
    assert fine.trust.runs <= 5.0


def test_fmus_that_do_not_repeat_a_run_are_named(parts):
    found = problem("ladder")
    runs = []

    def forgetful(system, *arguments, **more):
        runs.append(system)
        first, *others = system.components
        changed = replace(first, start={**first.start, "x0[1]": float(len(runs))})
        return perform(System((changed, *others), system.connections), *arguments, **more)

    experiment = Experiment(stop_time=1.0, step=0.1, coupling="jacobi", record=found.record)
    result = trusted(forgetful, found.system(parts, "held"), experiment, True)
    assert len(runs) == 2
    assert "first.y1 starts from 1, and from 2 when the run is made again" in result.trust.line
    assert result.trust.error is None


def test_what_is_asked_of_trust_is_checked(parts):
    with pytest.raises(InvalidInput, match="trust = 'all' is not valid; give true, order or probe"):
        run(problem("ladder"), parts, "held", "jacobi", step=0.1, trust="all")


def test_columns_of_bars_are_named_after_variables():
    assert variable_of(error_name("a.x[1]")) == "a.x[1]"
    assert variable_of("a.error(x)") == "a.error(x)"
