"""The ways in: the command `check` and the pytest plugin."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lag
import pytest
import typer
from typer.testing import CliRunner

from congelation.conformance.command import check

APP = typer.Typer()
APP.command()(check)


@pytest.fixture
def broken(library: Callable[[str], bytes], tmp_path: Path) -> Path:
    """An FMU with one fault."""
    return lag.build(tmp_path, library("version_wrong"))


def test_command_passes_a_correct_fmu(correct: Path) -> None:
    result = CliRunner().invoke(APP, [str(correct), "--rule", "FMI2-LIB"])
    assert result.exit_code == 0
    assert "5 pass, 0 violation" in result.output


def test_command_fails_on_a_violation(broken: Path, tmp_path: Path) -> None:
    junit, data = tmp_path / "report.xml", tmp_path / "report.json"
    options = ["--rule", "FMI2-LIB-02", "--junit", str(junit), "--json", str(data)]
    result = CliRunner().invoke(APP, [str(broken), *options])
    assert result.exit_code == 1
    assert "FMI2-LIB-02" in result.output
    assert 'failures="1"' in junit.read_text()
    assert json.loads(data.read_text())["violations"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["missing.fmu"], "there is no FMU"), (["{fmu}", "--rule", "FMI2-LAB-01"], "did you mean")],
)
def test_command_refuses_bad_usage(arguments: list[str], message: str, correct: Path) -> None:
    result = CliRunner().invoke(APP, [text.format(fmu=correct) for text in arguments])
    assert result.exit_code == 2
    assert message in " ".join(result.output.replace("│", " ").split())


def run_pytest(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """pytest in a process of its own, with this plugin alone."""
    root = Path(__file__).parents[2]
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "congelation.conformance.pytest_plugin", *arguments],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(root)},
        text=True,
        capture_output=True,
        check=False,
    )


def test_plugin_makes_a_case_of_every_rule(broken: Path, tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "--fmu", str(broken), "-k", "LIB-02 or LIB-03 or PACK", "-rA")
    assert done.returncode == 1
    assert "1 failed, 14 passed" in done.stdout
    assert "FMI2-LIB-02 (FMI 2.0.5, section 2.1.4): fmi2GetVersion returns" in done.stdout
    assert "fmi2GetVersion returns b'2.1'" in done.stdout
    assert "Traceback" not in done.stdout


def test_plugin_runs_next_to_other_tests(broken: Path, tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text("def test_mine():\n    pass\n")
    done = run_pytest(tmp_path, "--fmu", str(broken), "-k", "mine or FMI2-LIB-03")
    assert done.returncode == 0
    assert "2 passed" in done.stdout
    marked = run_pytest(tmp_path, "--fmu", str(broken), "-k", "mine or FMI2-LIB-03", "-m", "fmu")
    assert "1 passed" in marked.stdout


def test_plugin_refuses_a_missing_fmu(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "--fmu", "missing.fmu")
    assert done.returncode == 4
    assert "there is no FMU at 'missing.fmu'" in done.stderr


def test_plugin_is_silent_when_not_asked(tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text("def test_mine():\n    pass\n")
    done = run_pytest(tmp_path)
    assert "1 passed" in done.stdout
