"""The measurements of error bars, work and precision, on one problem each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.coupling import coverage, work
from benchmarks.coupling.__main__ import WORK, sources
from benchmarks.coupling.parts import build
from benchmarks.coupling.problems import problem


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parts")
    build(folder)
    return folder


def test_the_page_names_the_source_of_every_problem() -> None:
    assert "\n".join(sources()) in WORK.read_text("utf-8")


def test_error_bars_of_a_problem(parts: Path) -> None:
    pairs, ended = coverage.measure(parts, problem("ladder"))
    assert not ended
    count = sum(1 for _ in coverage.settings(problem("ladder")))
    assert len(pairs) == 3 * count
    assert all(pair.bar >= pair.error for pair in pairs if pair.error > 1e-8)
    assert np.nanmedian([pair.ratio for pair in pairs]) < 2.0
    table = "\n".join([*coverage.goals(pairs), *coverage.per_problem(pairs)])
    assert f"{count} runs, {3 * count} pairs." in table
    assert "| line of resistors and capacitors (new) |" in table


def test_engines_of_others_approach_the_solution(parts: Path, tmp_path: Path) -> None:
    case = work.of_problem(problem("two_masses_force"), parts)
    methods = tuple(m for m in work.METHODS if m.engine in ("fmpy_loop", "ecco"))
    points, failures = work.measure(case, methods)
    assert not failures
    held = [point.error for point in points if point.method == "FMPy loop"]
    assert held[0] > held[1] > held[2] > held[3] > 0.01
    chosen = [point.error for point in points if point.method == "libcosim, ECCO"]
    assert chosen[0] > chosen[-1]
    solved = [point.error for point in points if point.method == "monolithic, DOP853"]
    assert solved[-1] < 1e-9
    work.draw(points, tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").stat().st_size > 10_000
    assert len(work.table(points)) == 2 + 4


def test_a_figure_is_measured_with_its_native_fmus() -> None:
    case = replace(work.of_figure("fig2", 0.05), steps=(1e-3,))
    methods = tuple(m for m in work.METHODS if m.label in ("derivative", "FMPy loop"))
    points, failures = work.measure(case, methods)
    assert not failures
    errors = {point.method: point.error for point in points}
    assert errors["derivative"] < errors["FMPy loop"] < 1.0
    assert errors["monolithic, LSODA"] < 1e-8
    assert all(point.problem == "Fig. 2, Controller 1" for point in points)
