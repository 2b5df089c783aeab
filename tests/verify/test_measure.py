"""Metrics are of all communication points, whatever rows are kept; some have no answer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from congelation.report.export_formats import write_csv
from congelation.results.record import Trajectory
from congelation.results.results import Results
from congelation.scenario.metrics import metric
from congelation.scenario.parts import MetricSpec
from congelation.sweep.engine import run
from congelation.verify.measure import Points, measure, unresolved
from tests.scenarios import SCALAR, write

STEP = "step = 0.01"
MEASURED = """[metrics]
ise_u = {metric = "ise", of = "controller.u"}
error = {metric = "deviation"}
margin = {metric = "lyapunov"}"""


def rows_of(folder: Path, *changes: tuple[str, str]) -> tuple[Results, list[dict[str, Any]]]:
    folder.mkdir()
    results = run(write(folder, SCALAR, *changes), out=folder / "out")
    return results, [dict(record.metrics) for record in results.runs]


@pytest.mark.parametrize("output", ["output_interval = 100", "output_every = 1000"])
def test_a_coarse_output_changes_no_metric(tmp_path: Path, output: str) -> None:
    metrics = ("[metrics]", MEASURED)
    _, fine = rows_of(tmp_path / "fine", metrics)
    store, coarse = rows_of(tmp_path / "coarse", metrics, (STEP, f"{STEP}\n{output}"))
    for one, other, run_id in zip(fine, coarse, store.runs["run_id"], strict=True):
        assert len(store.trajectory(run_id).time) < 10
        for name in ("peak_x", "settling_x", "ise_u", "error", "margin"):
            assert other[name] == one[name]


def test_an_output_finer_than_the_steps_finds_peaks_between_them(tmp_path: Path) -> None:
    long = (STEP, 'step = 0.05\ncoupling = "hermite"')
    fine = (long[0], f"{long[1]}\noutput_interval = 1e-3")
    peak = ("[metrics]", '[metrics]\npeak_u = {metric = "peak", of = "controller.u"}')
    start = ("start = {x0 = [1.0]}", "start = {x0 = [0.3]}")
    _, points = rows_of(tmp_path / "points", long, peak, start)
    store, both = rows_of(tmp_path / "both", fine, peak, start)
    for one, other, run_id in zip(points, both, store.runs["run_id"], strict=True):
        kept = store.trajectory(run_id)
        assert other["peak_u"] >= one["peak_u"]
        assert other["peak_u"] >= np.max(np.abs(kept.select(["controller.u"])))


def test_points_and_rows_are_joined_in_order_of_time() -> None:
    points = Points(["b"])
    points.open(["time", "a", "b"])
    points.write(np.array([[0.0, 1.0, 10.0], [2.0, 3.0, 30.0]]))
    kept = Trajectory(
        np.array([0.0, 1.0]), ("a", "b"), np.array([[1.0, 11.0], [2.0, 20.0]]), {"b": "m"}
    )
    joined = points.with_rows(kept)
    assert joined.columns == ("b",)
    assert joined.time.tolist() == [0.0, 1.0, 2.0]
    assert joined.values.tolist() == [[10.0], [20.0], [30.0]]


def test_a_metric_without_an_answer_is_empty(tmp_path: Path) -> None:
    text = '[metrics]\nover = {metric = "overshoot", of = "plant.x", reference = 1}'
    store, rows = rows_of(tmp_path / "a", ("[metrics]", text))
    assert [row["over"] for row in rows] == [None, None]
    write_csv(store, tmp_path / "csv")
    header, first, _ = (tmp_path / "csv" / "runs.csv").read_text().splitlines()
    assert first.split(",")[header.replace('"', "").split(",").index("metric.over")] == ""


def test_nan_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    from congelation.scenario.metrics import METRICS, Metric
    from congelation.scenario.scenario import MetricSpec
    from congelation.verify import measure as module

    entry = Metric("n", lambda time, values: float("nan"), "nan", str)
    monkeypatch.setattr(module, "metric", {**METRICS, "n": entry}.__getitem__)
    trajectory = Trajectory(np.array([0.0]), ("a.b",), np.array([[1.0]]), {})
    specs = [MetricSpec("n", "n", "a.b", {}), MetricSpec("p", "peak", "a.b", {})]
    assert measure(specs, None, trajectory) == {"n": None, "p": 1.0}  # type: ignore[arg-type]  # of no loop


def test_every_declared_metric_of_the_loop_has_its_function() -> None:
    from congelation.scenario.metrics import METRICS
    from congelation.verify.measure import LOOP_METRICS

    declared = {name for name, entry in METRICS.items() if entry.evaluate is None}
    assert declared == set(LOOP_METRICS)
    assert all(METRICS[name].loop for name in declared)


@pytest.mark.parametrize(("points", "named"), [(6, True), (9, True), (13, False), (41, False)])
def test_an_integral_over_too_few_points_is_named(points: int, named: bool) -> None:
    """Two periods of a sine, whose square has the integral 1."""
    time = np.linspace(0.0, 2.0, 2 * points + 1)
    values = np.sin(2.0 * np.pi * time)[:, None]
    specs = [MetricSpec("ise_v", "ise", "a.v"), MetricSpec("peak_v", "peak", "a.v")]
    trajectory = Trajectory(time, ("a.v",), values, {})
    lines = list(unresolved(specs, trajectory))
    assert [line.split(",")[0] for line in lines] == [
        "The points are too far apart for metric ise_v"
    ] * named
    if not named:
        assert metric("ise").function(time, values) == pytest.approx(1.0, rel=0.02)
