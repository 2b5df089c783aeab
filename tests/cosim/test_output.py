"""Which rows are kept, and where."""

from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from congelation.cosim import (
    Component,
    Memory,
    Output,
    ParquetFile,
    Status,
    System,
    simulate,
    sinks,
)
from congelation.cosim.sinks import BLOCK_ROWS
from congelation.errors import InvalidInput

from .monolithic import order, solution

RECORD = ["plant.x", "controller.q"]


def test_every_nth_point_the_first_and_the_last_are_kept(loop):
    whole = simulate(loop(), stop_time=1.05, step=0.1)
    thinned = simulate(loop(), stop_time=1.05, step=0.1, output=Output(every=4))
    kept = [0, 4, 8, 11]
    assert thinned.time.tolist() == whole.time[kept].tolist()
    assert np.array_equal(thinned.values, whole.values[kept])
    assert thinned.statistics.macro_steps == whole.statistics.macro_steps


@pytest.mark.parametrize(
    "kwargs",
    [
        {"coupling": "hermite", "tolerance": 1e-7},
        {"coupling": "hermite", "step": 0.03},
        {"coupling": "derivative", "step": 0.001},
    ],
)
@pytest.mark.parametrize("interval", [0.01, 0.0625, 0.5])
def test_an_output_grid_is_filled_from_whatever_steps_are_made(loop, kwargs, interval):
    result = simulate(
        loop({"a": 1.0}), stop_time=3.0, record=RECORD, output=Output(interval=interval), **kwargs
    )
    assert result.completed
    assert result.time == pytest.approx(np.arange(round(3.0 / interval) + 1) * interval)
    assert result.time[-1] == 3.0
    error = np.abs(result.values - solution(result.time, a=1.0)).max(axis=0)
    assert (error < 3e-5).all()


def test_dense_output_is_of_the_order_of_the_coupling(loop):
    steps = (0.1, 0.05, 0.025)
    errors = []
    for step in steps:
        result = simulate(
            loop(),
            stop_time=3.0,
            record=RECORD,
            step=step,
            coupling="hermite",
            output=Output(interval=0.007),
        )
        errors.append(np.abs(result.values - solution(result.time)).max(axis=0))
    for column in np.array(errors).T:
        assert order(steps, column) > 3.3


def test_dense_output_keeps_to_the_tolerance(loop):
    """At order 6 a step is so long that its cubic is a hundred times as far off."""
    errors = {}
    for output in (None, Output(interval=0.007)):
        kwargs = {} if output is None else {"output": output}
        result = simulate(
            loop(), stop_time=3.0, record=RECORD, tolerance=1e-7, coupling="hermite", **kwargs
        )
        errors[output] = np.abs(result.values - solution(result.time)).max(axis=0)
    at_steps, between = errors.values()
    # q has no derivative among the outputs, and its values are all there is.
    assert between[0] < at_steps[0] + 3e-7
    assert between[1] < at_steps[1] + 3e-7


def test_a_run_can_be_recorded_twice(loop):
    kwargs = {"stop_time": 3.0, "tolerance": 1e-6, "coupling": "hermite", "record": RECORD}
    system = loop({"a": 1.0})
    grid = Memory()
    both = simulate(system, output=[Output(), Output(interval=0.01, sink=grid)], **kwargs)
    alone = simulate(system, output=Output(interval=0.01), **kwargs)
    assert np.array_equal(grid.rows(), np.column_stack([alone.time, alone.values]))
    assert len(both.time) == 1 + alone.statistics.macro_steps < len(alone.time)
    # Without a tolerance, what is recorded changes no step.
    kwargs = {"stop_time": 3.0, "step": 0.03, "coupling": "hermite", "record": RECORD}
    both = simulate(system, output=[Output(), Output(interval=0.01, sink=Memory())], **kwargs)
    assert np.array_equal(both.values, simulate(system, **kwargs).values)


def test_only_the_first_output_may_be_without_a_sink(loop):
    for outputs in ([], [Output(), Output(every=2)]):
        with pytest.raises(InvalidInput, match="need a sink"):
            simulate(loop(), stop_time=1.0, step=0.1, output=outputs)


def test_grid_points_that_are_communication_points_are_taken_as_they_are(loop):
    whole = simulate(loop(), stop_time=1.0, step=0.1, coupling="hermite", record=RECORD)
    grid = simulate(
        loop(),
        stop_time=1.0,
        step=0.1,
        coupling="hermite",
        record=RECORD,
        output=Output(interval=0.2),
    )
    assert np.array_equal(grid.values, whole.values[::2])


def test_the_last_point_is_recorded_beside_the_grid(loop):
    result = simulate(loop(), stop_time=1.0, step=0.25, output=Output(interval=0.3))
    assert result.time.tolist() == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0])


def test_a_jump_is_not_interpolated_across(loop):
    result = simulate(
        loop({"a": 1.0}),
        stop_time=1.0,
        step=0.05,
        coupling="hermite",
        record=["plant.der(x[2])", "plant.x"],
        output=Output(interval=0.01),
    )
    slope = np.gradient(result.values[:, 2], result.time)
    away = np.abs(result.time - 0.65) > 0.015
    inside = slice(1, -1)
    assert result.values[inside, 0][away[inside]] == pytest.approx(
        slope[inside][away[inside]], abs=5e-3
    )


def test_a_failing_run_keeps_its_grid_rows(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 1.0, "at": 0.5}),))
    result = simulate(system, stop_time=1.0, step=0.125, output=Output(interval=0.0625))
    assert result.status is Status.SLAVE_FAILED
    assert result.time == pytest.approx(np.arange(9) * 0.0625)


def test_a_file_holds_what_memory_would(loop, monkeypatch, tmp_path):
    path = tmp_path / "run.parquet"
    block = BLOCK_ROWS // 8
    monkeypatch.setattr(sinks, "BLOCK_ROWS", block)
    kept = simulate(loop(), stop_time=1.0, step=4e-4, coupling="jacobi")
    written = simulate(
        loop(), stop_time=1.0, step=4e-4, coupling="jacobi", output=Output(sink=ParquetFile(path))
    )
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == ["time", *kept.names]
    assert np.array_equal(table["time"].to_numpy(), kept.time)
    for name in kept.names:
        assert np.array_equal(table[name].to_numpy(), kept.column(name))
    assert len(kept.time) > 2 * block
    assert pyarrow.parquet.ParquetFile(path).num_row_groups == 3
    assert np.array_equal(written.values[0], kept.values[-1])
    assert not list(tmp_path.glob("*.part"))


def test_a_broken_off_run_leaves_a_part(loop, tmp_path):
    path = tmp_path / "run.parquet"

    def interrupt(fraction):
        if fraction > 0.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(
            loop(),
            stop_time=1.0,
            step=0.01,
            output=Output(sink=ParquetFile(path)),
            progress=interrupt,
        )
    assert not path.exists()
    assert pyarrow.parquet.read_table(path.with_name("run.parquet.part")).num_rows >= 1


@pytest.mark.slow
def test_a_long_run_to_disk_needs_no_more_memory_than_a_short_one(fmus, tmp_path, monkeypatch):
    import tracemalloc

    rows = BLOCK_ROWS // 4
    monkeypatch.setattr(sinks, "BLOCK_ROWS", rows)
    system = System((Component("g", fmus / "TestGain.fmu"),))
    peaks = []
    for steps in (2 * rows, 8 * rows):
        tracemalloc.start()
        simulate(
            system,
            stop_time=1e-3 * steps,
            step=1e-3,
            coupling="jacobi",
            output=Output(sink=ParquetFile(tmp_path / f"{steps}.parquet")),
        )
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"every": 0}, "at least 1"),
        ({"interval": 0.1, "every": 2}, "give one of the two"),
    ],
)
def test_outputs_are_checked(kwargs, message):
    with pytest.raises(InvalidInput, match=message):
        Output(**kwargs)


@pytest.mark.parametrize("name", ["missing/rows.parquet", "."])
def test_a_file_that_cannot_be_written_is_refused(loop, tmp_path, name):
    sink = ParquetFile(tmp_path / name)
    with pytest.raises(InvalidInput, match="cannot be written"):
        simulate(loop(), stop_time=1.0, step=0.1, output=Output(sink=sink))


def test_an_fmu_that_changes_the_working_directory_moves_no_results(fmus, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    system = System((Component("w", fmus / "TestWanderer.fmu"),))
    result = simulate(
        system, stop_time=1.0, step=0.25, output=Output(sink=ParquetFile("rows.parquet"))
    )
    assert result.completed, result.message
    assert Path.cwd() == tmp_path
    assert len(pyarrow.parquet.read_table(tmp_path / "rows.parquet")) == 5
