"""``congelation run --trust``: error bars of black boxes in one command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.coupling.parts import build
from benchmarks.coupling.problems import problem
from congelation.results.results import open_results
from tests.studies import command

SCENARIO = """
title = "A line of black boxes"
connections = [{links}]
{components}
[experiment]
stop_time = 8.0
step = {step}
{coupling}
record = ["first.y1", "second.y1", "third.y1"]

[metrics]
last = {{metric = "peak", of = "third.y1"}}

[[figures]]
name = "line"
panels = ["first.y1", "second.y1"]
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parts")
    build(folder, ["fixed"])
    return folder


def written(
    folder: Path, parts: Path, name: str, step: float, coupling: str = 'coupling = "jacobi"'
) -> Path:
    found = problem(name)
    components = "".join(
        f'[components.{part}]\nfmu = "{parts / model}_fixed.fmu"\n[components.{part}.start]\n'
        + "".join(f'"{key}" = {value!r}\n' for key, value in start.items())
        for part, (model, start) in found.parts.items()
    )
    links = ", ".join(f'"{link}"' for link in found.links)
    text = SCENARIO.format(links=links, components=components, step=step, coupling=coupling)
    file = folder / "line.toml"
    file.write_text(text, "utf-8")
    return file


def test_black_boxes_without_states_get_error_bars(tmp_path: Path, parts: Path) -> None:
    file = written(tmp_path, parts, "ladder", 0.02)
    done = command(
        "run", file, "--out", tmp_path / "results" / "line", "--trust", "--progress", "quiet"
    )
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "trust: " in line]
    assert "trust: within" in line
    assert "of each peak (worst third.y1 at t =" in line
    assert "3.0 runs" in line
    results = open_results(tmp_path / "results" / "line")
    (record,) = results.runs
    assert record.trust_verdict == "resolved"
    assert 0.01 < record.trust_error < 0.1
    assert record.trust_line in line
    trajectory = results.store.trajectory(record.run_id)
    assert trajectory.columns[3:] == tuple(f"error({name})" for name in trajectory.columns[:3])
    exact = problem("ladder").exact(trajectory.time)
    assert (np.abs(trajectory.values[:, :3] - exact) <= trajectory.values[:, 3:] + 1e-9).all()


def test_black_boxes_need_no_coupling_to_be_stated(tmp_path: Path, parts: Path) -> None:
    file = written(tmp_path, parts, "ladder", 0.02, coupling="")
    folder = tmp_path / "results" / "line"
    done = command("run", file, "--out", folder, "--trust", "--progress", "quiet")
    assert done.returncode == 0, done.stderr
    chosen, bars = (line for line in done.stdout.splitlines() if line.startswith("line: "))
    assert "auto: derivative, as not all FMUs can save their state and take polynomials" in chosen
    assert "trust: within" in bars
    results = open_results(folder)
    (record,) = results.runs
    assert (record.coupling, record.coupling_why) == ("derivative", chosen.removeprefix("line: "))
    trajectory = results.store.trajectory(record.run_id)
    exact = problem("ladder").exact(trajectory.time)
    error = np.abs(trajectory.values[:, :3] - exact)
    assert error.max() < 1e-3  # far nearer than with held inputs, above
    assert (error <= trajectory.values[:, 3:] + 1e-9).all()


def test_further_runs_are_asked_for_by_name(tmp_path: Path, parts: Path) -> None:
    file = written(tmp_path, parts, "ladder", 0.1)
    done = command(
        "run", file, "--out", tmp_path / "results" / "line", "--trust=order", "--progress", "quiet"
    )
    assert done.returncode == 0, done.stderr
    assert "3.5 runs" in done.stdout
    done = command("run", file, "--out", tmp_path / "results" / "line", "--trust=all")
    assert done.returncode == 2
    assert "'order', 'probe'" in " ".join(done.stderr.replace("│", " ").split())
