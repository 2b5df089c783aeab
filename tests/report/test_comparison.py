"""Result directories beside each other: runs matched, differences, what cannot be compared."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.report.comparison import (
    changes_by_run,
    changes_by_variant,
    compare,
    folder_names,
    relative_change,
    verdict,
)
from congelation.report.comparison_page import write_comparison
from congelation.results.record import RunRecord, Study
from tests.report.stored import ABOUT, record, results, stored, stored_study, trajectory
from tests.report.test_run_page import Page


def study(*runs: RunRecord, **about: object) -> Study:
    return Study(runs, {**ABOUT, **about})


def point(number: int, omega: float, peak: float, variant: int = 1) -> RunRecord:
    return record(
        f"r{number}",
        number,
        variant=f"Controller {variant}",
        settings={"plant.omega": omega},
        metrics={"peak_x": peak, "settling_x": 1.0},
    )


SWEPT = {"swept": True, "varied": ["plant.omega"]}


@pytest.mark.parametrize(
    ("before", "after", "change"),
    [
        (2.0, 3.0, 0.5),
        (-2.0, -3.0, -0.5),
        (2.0, 2.0, 0.0),
        (0.0, 0.0, 0.0),
        (None, None, 0.0),
        (None, math.nan, 0.0),
        (math.inf, math.inf, 0.0),
        (math.inf, 2.0, math.inf),
        (2.0, math.inf, math.inf),
        (0.0, 1.0, math.inf),
        (1.0, None, math.inf),
    ],
)
def test_the_change_of_a_number(before: float | None, after: float | None, change: float) -> None:
    assert relative_change(before, after) == change


def test_runs_are_matched_by_variant_and_settings() -> None:
    first = study(point(1, 0.1, 1.0), point(2, 1.0, 2.0), point(3, 0.1, 5.0, 2), **SWEPT)
    second = study(point(7, 1.0, 3.0), point(8, 0.1, 5.0, 2), point(9, 10.0, 1.0), **SWEPT)
    found = compare(("a", "b"), (first, second))
    assert [(pair.before.run_id, pair.after.run_id) for pair in found.pairs] == [
        ("r2", "r7"),
        ("r3", "r8"),
    ]
    assert found.alone == (
        ("Controller 1, plant.omega = 0.1", "a"),
        ("Controller 1, plant.omega = 10", "b"),
    )
    said = " ".join(verdict(found))
    assert "b against a: 2 runs can be compared; 2 have no counterpart" in said
    assert "most of all peak_x of Controller 1, plant.omega = 1: 2 before, 3 now (+50 %)." in said


def test_a_setting_that_variants_differ_in_may_change() -> None:
    """A variant is matched by its name: its own parameters are what was changed."""
    first = study(
        record("r1", 1, settings={"controller.epsilon": 1.0}), varied=["controller.epsilon"]
    )
    second = study(
        record("r9", 1, settings={"controller.epsilon": 2.0}), varied=["controller.epsilon"]
    )
    assert len(compare(("a", "b"), (first, second)).pairs) == 1


def test_runs_that_are_not_unique_are_not_matched() -> None:
    """The second study varies what the first one does not know: which run is the counterpart?"""
    first = study(record("r1", 1, settings={}), varied=[])
    runs = [point(k, omega, 1.0) for k, omega in enumerate((0.1, 1.0))]
    found = compare(("a", "b"), (first, study(*runs, **SWEPT)))
    assert not found.pairs
    assert len(found.alone) == 3


def test_replicates_are_matched_by_their_number() -> None:
    runs = [replace(point(k, 1.0, float(k)), replicate=k) for k in (1, 2)]
    found = compare(("a", "b"), (study(*runs, **SWEPT), study(*reversed(runs), **SWEPT)))
    assert [(p.before.metrics, p.after.metrics) for p in found.pairs] == [
        (run.metrics, run.metrics) for run in runs
    ]
    assert "All metrics are equal to the last digit." in [*verdict(found)]


def test_metrics_that_are_defined_otherwise_are_left_out() -> None:
    metrics = dict(ABOUT["metrics"])  # type: ignore[call-overload]
    metrics["peak_x"] = {**metrics["peak_x"], "of": "plant.y"}
    found = compare(("a", "b"), (study(record("r1", 1)), study(record("r1", 1), metrics=metrics)))
    assert [*found.metrics] == ["settling_x"]
    assert found.own == (("peak_x", "a"), ("peak_x", "b"))


def test_differences_of_runs_and_of_a_study() -> None:
    before = record("r1", 1, metrics={"peak_x": 2.0, "settling_x": math.inf})
    after = record("r2", 1, metrics={"peak_x": 3.0, "settling_x": 2.5}, status="DIVERGED")
    found = compare(("a", "b"), (study(before), study(after)))
    assert [*changes_by_run(found)] == [
        ("Controller 1: status", ["COMPLETED", "DIVERGED", "–", "–"]),
        ("Controller 1: peak_x [m]", ["2", "3", "+1", "+50 %"]),
        ("Controller 1: settling_x [s]", ["not settled", "2.5", "–", "–"]),
        ("Controller 1: macro steps", ["5000", "5000", "0", "equal"]),
    ]
    assert "The status changed: Controller 1 was COMPLETED and is DIVERGED." in [*verdict(found)]
    runs = [point(k, float(k), 1.0) for k in range(1, 4)]
    later = [
        replace(run, metrics={**run.metrics, "peak_x": 1.0 + 0.1 * k}) for k, run in enumerate(runs)
    ]
    (peak, cells), (_, settling) = changes_by_variant(
        compare(("a", "b"), (study(*runs, **SWEPT), study(*later, **SWEPT)))
    )
    assert peak == "Controller 1: peak_x [m]"
    assert cells == ["3", "1", "1", "1.1", "+10 %", "+20 %", "0"]
    assert settling == ["3", "3", "1", "1", "equal", "equal", "0"]


def test_folders_are_called_by_what_tells_them_apart(tmp_path: Path) -> None:
    a, b = tmp_path / "old" / "fig2", tmp_path / "new" / "fig2"
    assert folder_names([a, tmp_path / "new"]) == ("fig2", "new")
    assert folder_names([a, b]) == (str(a), str(b))
    with pytest.raises(InvalidInput, match="is given twice"):
        folder_names([a, b, a])


def test_the_page_has_both_and_what_changed(tmp_path: Path) -> None:
    old = stored(tmp_path / "old")
    new = results(
        tmp_path / "new",
        [(record("r1", 1), trajectory(900.0)), (record("r2", 2), trajectory(1.0))],
        scenario='title = "Three <runs>"\n',
        versions={"congelation": "0.2.0", "Python": "3.11"},
    )
    write_comparison([old, new], tmp_path / "page.html")
    page = Page()
    page.feed((tmp_path / "page.html").read_text("utf-8"))
    for text in (
        "new against old: each of the 2 runs has a counterpart.",
        "Controller 1 settled in 1 of 1 runs before, and settles in 0 now.",
        "1 of 4 metrics differ, most of all settling_x of Controller 1: 2.5 before, "
        "not settled now.",
        "Controller 1, old",
        "Controller 1, new",
        "Controller 1: settling_x [s]",
        '-title = "Two <runs>"',
        '+title = "Three <runs>"',
        "0.2.0",
    ):
        assert text in page.text, text
    assert "sha256" not in page.text  # the FMUs are the same


def test_of_a_study_the_largest_changes_are_listed(tmp_path: Path) -> None:
    first, second = stored_study(tmp_path / "a"), stored_study(tmp_path / "b")
    write_comparison([first, second], tmp_path / "page.html")
    page = Page()
    page.feed((tmp_path / "page.html").read_text("utf-8"))
    assert "All metrics are equal to the last digit." in page.text
    assert "Changes by variant" in page.text
    assert "Trajectories are drawn where every variant has one run" in page.text
