"""Summaries of sweeps: groups and Pareto fronts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.errors import InvalidInput
from congelation.report.pareto import draw_front, pareto_front
from congelation.report.summary import summarise_groups
from congelation.results.record import RunRecord, Study

METRICS = {name: {"metric": "peak", "of": "a.x", "unit": "s"} for name in ("time", "cost")}
ABOUT = {"varied": ["a.k"], "metrics": METRICS, "swept": True}


def row(k: float, time: float | None, cost: float | None) -> RunRecord:
    status = "COMPLETED" if time is not None else "DIVERGED"
    metrics = {"time": time, "cost": cost}
    return RunRecord(run_id="", variant="v", status=status, settings={"a.k": k}, metrics=metrics)


def number(run: RunRecord) -> Any:
    return run.settings["a.k"]


def test_groups_are_sorted_and_have_the_median_between_outer_quantiles() -> None:
    rows = [row(10.0, 1.0, 4.0), row(2.0, 3.0, 5.0), row(10.0, 2.0, 4.0), row(10.0, None, None)]
    rows.append(row(10.0, 9.0, 4.0))
    summary = summarise_groups(Study(tuple(rows), ABOUT), ["a.k"])
    assert summary.columns == ("runs", "completed", "time [s]", "cost [s]")
    assert summary.lines == (
        ("2", ("1", "1", "3", "5")),
        ("10", ("4", "3", "2 [1, 9]", "4")),
    )


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1.0, 2.0], "1.5 [1, 2]"),
        ([4.0, 1.0, 2.0, 9.0, None], "3 [1, 9]"),
        ([1.0, math.inf], "not settled in half [1, not settled]"),
        ([1.0, math.inf, math.inf, math.inf], "not settled [1, not settled]"),
        ([1.0, 2.0, 3.0, math.inf], "2.5 [1, not settled]"),
        ([math.inf, math.inf], "not settled"),
    ],
)
def test_the_median_is_the_mean_of_the_middle_values(
    values: list[float | None], expected: str
) -> None:
    rows = tuple(row(1.0, value, 0.0) for value in values)
    about = {name: dict(metric) for name, metric in ABOUT["metrics"].items()}
    about["time"]["metric"] = "settling_time"
    (found,) = summarise_groups(Study(rows, {**ABOUT, "metrics": about}), ["a.k"]).lines
    assert found[1][2] == expected


COSTS = st.integers(0, 5) | st.sampled_from([math.inf, math.nan])


@given(st.lists(st.tuples(COSTS, COSTS), min_size=1, max_size=30))
def test_the_pareto_front_is_what_no_run_beats(costs: list[tuple[float, float]]) -> None:
    rows = tuple(row(k, float(t), float(c)) for k, (t, c) in enumerate(costs))
    front = pareto_front(Study(rows, ABOUT), ["time", "cost"])
    finite = [row(k, *c) for k, c in enumerate(costs) if all(map(math.isfinite, c))]

    def beats(a: RunRecord, b: RunRecord) -> bool:
        one, other = (tuple(map(float, r.metrics.values())) for r in (a, b))  # type: ignore[arg-type]
        return one != other and one[0] <= other[0] and one[1] <= other[1]

    expected = [number(r) for r in finite if not any(beats(other, r) for other in finite)]
    assert sorted(number(r) for r in front) == expected
    assert [r.metrics["time"] for r in front] == sorted(r.metrics["time"] or 0.0 for r in front)


def test_the_figure_shows_all_runs_and_the_front() -> None:
    rows = (row(1.0, 1.0, 3.0), row(2.0, 2.0, 2.0), row(3.0, 3.0, 4.0), row(4.0, None, None))
    study = Study(rows, ABOUT)
    (axes,) = draw_front(study, ["time", "cost"]).axes
    runs, front = (line.get_xydata() for line in axes.get_lines())
    assert np.array_equal(runs, [[1.0, 3.0], [2.0, 2.0], [3.0, 4.0]])
    assert np.array_equal(front, [[1.0, 3.0], [2.0, 2.0]])
    assert (axes.get_xlabel(), axes.get_xscale()) == ("time [s]", "log")
    with pytest.raises(InvalidInput, match="has two metrics, not 1"):
        draw_front(study, ["time"])


def test_unknown_names_are_told() -> None:
    study = Study((row(1.0, 2.0, 3.0),), ABOUT)
    with pytest.raises(InvalidInput, match=r"'a\.q' is no column to group by"):
        summarise_groups(study, ["a.q"])
    with pytest.raises(InvalidInput, match="'tim' is no metric; did you mean 'time'"):
        pareto_front(study, ["tim"])


OMEGA = {f"p.profile[{j}].{term}.omega": f"p.profile.theta[{j}].{term}.omega"
         for j, term in ((1, "sine[1]"), (1, "sine[2]"), (2, "sine[1]"))}  # fmt: skip
SPELLED = {**OMEGA, "p.profile[1].mean": "p.profile.theta[1].constant"}


@pytest.mark.parametrize(
    ("asked", "labels"),
    [
        ("p.profile[2].sine[1].omega", ["3"]),
        ("p.profile.theta[2].sine[1].omega", ["3"]),
        ("p.profile.theta[2].sine.omega", ["3"]),
        ("set.p.profile.theta[1].constant", ["4"]),
        ("p.profile.theta[1]", ["1, 2, 4"]),
        ("p.x0", ["5, 6"]),
    ],
)
def test_columns_are_named_as_in_the_fmu_or_in_the_scenario(asked: str, labels: list[str]) -> None:
    settings = {name: float(k) for k, name in enumerate([*SPELLED, "p.x0[1]", "p.x0[2]"], 1)}
    run = RunRecord(run_id="", variant="v", status="COMPLETED", settings=settings)
    study = Study((run,), {"varied": [*settings], "spelled": SPELLED, "metrics": {}})
    assert [label for label, _ in summarise_groups(study, [asked]).lines] == labels
    with pytest.raises(InvalidInput, match="is one of 2; give p"):
        summarise_groups(study, ["p.profile.theta[1].sine.omega"])
    with pytest.raises(InvalidInput, match="no column to group by"):
        summarise_groups(study, ["p.profile.theta.constant"])
