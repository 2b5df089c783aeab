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
from congelation.results.records import Study

METRICS = {name: {"metric": "peak", "of": "a.x", "unit": "s"} for name in ("time", "cost")}
ABOUT = {"varied": ["a.k"], "metrics": METRICS, "sweep": {}}


def row(k: float, time: float | None, cost: float | None) -> dict[str, Any]:
    status = "COMPLETED" if time is not None else "DIVERGED"
    return {"variant": "v", "status": status, "a.k": k, "time": time, "cost": cost}


def test_groups_are_sorted_and_have_the_median_between_outer_quantiles() -> None:
    rows = [row(10.0, 1.0, 4.0), row(2.0, 3.0, 5.0), row(10.0, 2.0, 4.0), row(10.0, None, None)]
    rows.append(row(10.0, 9.0, 4.0))
    summary = summarise_groups(Study(tuple(rows), ABOUT), ["a.k"])
    assert summary.columns == ("runs", "completed", "time [s]", "cost [s]")
    assert summary.lines == (
        ("2", ("1", "1", "3", "5")),
        ("10", ("4", "3", "2 [1, 9]", "4")),
    )


COSTS = st.integers(0, 5) | st.sampled_from([math.inf, math.nan])


@given(st.lists(st.tuples(COSTS, COSTS), min_size=1, max_size=30))
def test_the_pareto_front_is_what_no_run_beats(costs: list[tuple[float, float]]) -> None:
    rows = tuple(row(k, float(t), float(c)) for k, (t, c) in enumerate(costs))
    front = pareto_front(Study(rows, ABOUT), ["time", "cost"])
    finite = [r for r in rows if math.isfinite(r["time"]) and math.isfinite(r["cost"])]

    def beats(a: dict[str, Any], b: dict[str, Any]) -> bool:
        one, other = (a["time"], a["cost"]), (b["time"], b["cost"])
        return one != other and one[0] <= other[0] and one[1] <= other[1]

    expected = [r["a.k"] for r in finite if not any(beats(other, r) for other in finite)]
    assert sorted(r["a.k"] for r in front) == expected
    assert [r["time"] for r in front] == sorted(r["time"] for r in front)


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
