"""Panels of the pages: which variables share one, and what their curves and numbers are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from congelation.report.curves import EVERY, STEPS, curve_panels, panel_groups
from congelation.results.record import Steps, Study, Trajectory
from tests.report.stored import record, trajectory


def test_vectors_bounds_and_errors_share_panels() -> None:
    columns = (
        "controller.theta_hat[1]",
        "plant.x[1]",
        "plant.x[2]",
        "controller.V",
        "controller.V_bound",
        "error(plant.x[1])",
        "error(controller.u)",
        "certificate.V",
        "certificate.rate",
        "certificate.bound",
    )
    assert panel_groups(columns, ("|plant.x|", "|plant.y|")) == {
        "plant.x": ("plant.x[1]", "plant.x[2]"),
        "controller.theta_hat": ("controller.theta_hat[1]",),
        "Lyapunov function V": ("controller.V", "controller.V_bound", "certificate.V"),
        "V' and what the certificate allows": ("certificate.rate", "certificate.bound"),
        "estimated error": ("error(plant.x[1])", "error(controller.u)"),
        "|plant.x|": ("plant.x[1]", "plant.x[2]"),
    }


def test_what_all_variants_share_is_one_curve_and_numbers_are_of_all_points() -> None:
    panels = {p.title: p for p in curve_panels([(0, trajectory(2.0)), (1, trajectory(3.0))])}
    assert [curve.variant for curve in panels["plant.theta"].curves] == [EVERY]
    first, second = panels["controller.u"].curves
    assert (first.variant, second.variant) == (0, 1)
    t = np.linspace(0.0, 10.0, 5001)
    values = 2.0 * np.exp(-t)
    assert first.numbers == (2.0, values.min(), 2.0, values[-1])
    assert len(first.time) <= 2002


def test_a_signal_that_variants_share_is_one_curve_on_whatever_rows() -> None:
    """Of the run with most rows, unless another one went further."""
    fine, coarse = trajectory(1.0), trajectory(1.0)
    coarse = replace(coarse, time=coarse.time[::7], values=coarse.values[::7])
    column = "plant.theta[1]"

    def drawn(*runs: Trajectory) -> list[tuple[int, int]]:
        panels = {p.title: p for p in curve_panels([*enumerate(runs)])}
        return [(curve.variant, len(curve.time)) for curve in panels["plant.theta"].curves]

    def marked(run: Trajectory, what: object) -> Trajectory:
        return replace(run, signals={column: what})

    separate = drawn(coarse, fine)
    assert [variant for variant, _ in separate] == [0, 1]
    assert drawn(marked(coarse, "a"), marked(fine, "b")) == separate
    assert drawn(marked(coarse, "a"), marked(fine, "a")) == [(EVERY, separate[1][1])]
    stopped = replace(fine, time=fine.time[:-500], values=fine.values[:-500])
    assert drawn(marked(coarse, "a"), marked(stopped, "a")) == [(EVERY, separate[0][1])]


def test_runs_with_equal_profiles_and_fmus_share_a_curve_whatever_study_they_are_of() -> None:
    """Two folders whose theta differs: a curve for each, not one for each run."""
    column = "plant.theta[1]"
    profile = {"plant.profile[1].mean": 1.0, "plant.profile[1].table.file": ""}

    def marked(mean: float, sha: str, file: str = "") -> Trajectory:
        about = {"profiles": {column: profile}, "fmus": {"plant": {"sha256": sha}}}
        settings = {"plant.profile[1].mean": mean, "plant.profile[1].table.file": file}
        run = record("r", 1, settings=settings, study=f"s{len(runs)}")
        rows = trajectory(1.0)
        every = len(runs) + 1  # other rows in each, so that values are not compared
        rows = replace(rows, time=rows.time[::every], values=rows.values[::every])
        return replace(rows, signals=Study((run,), about).signals(run))

    runs: list[Trajectory] = []
    for mean, sha in ((1.0, "a"), (2.0, "a"), (1.0, "a"), (2.0, "a"), (1.0, "b")):
        runs.append(marked(mean, sha))
    runs += [marked(1.0, "a", "t.csv")]  # a file may have been another one in another study
    runs += [marked(1.0, "a", "t.csv")]
    (panel,) = (p for p in curve_panels([*enumerate(runs)]) if p.title == "plant.theta")
    found = [(curve.variant, curve.others) for curve in panel.curves]
    assert found == [(0, (2,)), (1, (3,)), (4, ()), (5, ()), (6, ())]


def test_a_variable_without_finite_values_is_no_error() -> None:
    run = Trajectory(np.array([0.0, 1.0]), ("plant.x",), np.full((2, 1), np.nan), {})
    (panel,) = curve_panels([(0, run)])
    assert len(panel.curves[0].time) == 0
    assert np.all(np.isnan(panel.curves[0].numbers))


def test_step_sizes_have_a_panel_of_their_own() -> None:
    points = np.cumsum(np.linspace(1e-3, 2e-3, 4000))
    chosen = replace(trajectory(1.0), steps=Steps.between(points))
    fixed = replace(trajectory(2.0), steps=Steps.between(np.arange(11) * 1e-3))
    panel = {p.title: p for p in curve_panels([(0, chosen), (1, fixed)])}[STEPS]
    assert panel.unit == "s"
    assert [curve.variant for curve in panel.curves] == [0, 1]
    assert panel.curves[0].numbers[1:3] == (points[1] - points[0], points[-1] - points[-2])
    assert panel.curves[1].value == pytest.approx([0.001, 0.001])
    assert panel.note.startswith("Each step at its end. Of up to 3999 steps, ")
    assert STEPS not in {p.title for p in curve_panels([(0, trajectory(1.0))])}
