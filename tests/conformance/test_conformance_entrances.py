"""The ways in: the command `check` and the pytest plugin."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import lag
import pytest
import typer
from mutant import swap
from typer.testing import CliRunner

from congelation.cli.check import check
from congelation.conformance import runner
from tests.studies import command

APP = typer.Typer()
APP.command()(check)


@pytest.fixture
def broken(library: Callable[[str], bytes], tmp_path: Path) -> Path:
    """An FMU with one fault."""
    return lag.build(tmp_path, library("version_wrong"))


def test_command_passes_a_correct_fmu(correct: Path) -> None:
    result = CliRunner().invoke(APP, [str(correct), "--rule", "FMI2-LIB", "--table"])
    assert result.exit_code == 0
    assert "0 violation, 0 warning, 0 robustness, 5 pass" in result.output


def test_command_fails_on_a_violation(broken: Path, tmp_path: Path) -> None:
    junit, data = tmp_path / "report.xml", tmp_path / "report.json"
    options = ["--rule", "FMI2-LIB-02", "--junit", str(junit), "--json", str(data)]
    result = CliRunner().invoke(APP, [str(broken), *options])
    assert result.exit_code == 1
    assert "FMI2-LIB-02 violation: fmi2GetVersion returns b'2.1' - " in result.output
    assert 'failures="1"' in junit.read_text()
    assert json.loads(data.read_text())["counts"]["violation"] == 1


def test_report_is_shown_in_a_few_lines(broken: Path) -> None:
    lines = repr(runner.check([broken], rules=["FMI2-LIB"])).splitlines()
    assert lines[0] == "1 FMU: 4 pass, 1 found"
    assert "FMI2-LIB-02 violation: fmi2GetVersion returns b'2.1' - " in lines[1]
    assert len(lines) == 2


@pytest.mark.parametrize(
    ("options", "code"),
    [([], 0), (["--fail-on", "warning"], 1), (["--fail-on", "robustness"], 1)],
)
def test_command_fails_on_what_was_asked_for(
    options: list[str], code: int, library: Callable[[str], bytes], tmp_path: Path
) -> None:
    path = lag.build(tmp_path, library("line_break_logged"))
    result = CliRunner().invoke(APP, [str(path), "--rule", "FMI2-LOG-07", *options])
    assert result.exit_code == code
    assert "FMI2-LOG-07 warning" in result.output


def test_command_explains_a_rule() -> None:
    result = CliRunner().invoke(APP, ["--explain", "FMI2-PACK-03"])
    assert result.exit_code == 0
    assert "violation, static rule, FMI 2.0.5 section 2.3" in result.output
    assert "must be either 8 (deflate), or 0 (store)" in result.output
    assert "Remedy: Pack with deflate" in result.output


def test_nothing_checked_is_no_success(library: Callable[[str], bytes], tmp_path: Path) -> None:
    edit = swap('fmiVersion="2.0"', 'fmiVersion="3.0"')
    path = lag.build(tmp_path, library(""), edit=edit)
    result = CliRunner().invoke(APP, [str(path)])
    assert result.exit_code == 2
    assert "FMI 3.0: not checked" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.fmu"], "there is no FMU"),
        (["{fmu}", "--rule", "FMI2-LAB-01"], "did you mean"),
        (["--explain", "FMI2-LAB-01"], "did you mean"),
        (["{fmu}", "--json", "no/such/folder/x.json"], "there is no folder"),
    ],
)
def test_command_refuses_bad_usage(arguments: list[str], message: str, correct: Path) -> None:
    done = command("check", *(text.format(fmu=correct) for text in arguments))
    assert done.returncode == 2
    assert message in " ".join(done.stderr.replace("│", " ").split())
    assert "--explain" in arguments or done.stderr.count("\n") == 1


def processes_in(folder: Path) -> list[int]:
    """Processes that work somewhere below a folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if entry.joinpath("cwd").resolve().is_relative_to(folder):
                found.append(int(entry.name))
        except OSError:
            continue
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_command_with_its_children(
    number: signal.Signals, library: Callable[[str], bytes], tmp_path: Path
) -> None:
    path = lag.build(tmp_path, library("hangs"))
    command = [sys.executable, "-m", "congelation", "check", str(path)]
    folder = tmp_path / "temporary"
    folder.mkdir()
    root = str(Path(__file__).parents[2])
    process = subprocess.Popen(
        command,
        env={**os.environ, "TMPDIR": str(folder), "PYTHONPATH": root},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while not processes_in(folder):
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(number)
        output, error = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "Traceback" not in output + error
    # What is checked is printed before the rules run.
    assert output.startswith(f"{path}: FMI 2.0 co-simulation, static rules and dynamic rules on ")
    assert processes_in(folder) == []
    assert list(folder.iterdir()) == []


def test_interrupt_while_starting_shows_no_traceback(correct: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "congelation", "check", str(correct)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    # The import of the commands has begun, and takes much longer than the signal.
    while "congelation.errors" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    output, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in output + error


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_findings_go_to_a_file_while_the_bar_is_on_the_terminal(
    correct: Path, tmp_path: Path
) -> None:
    terminal, end = os.openpty()
    with (tmp_path / "findings").open("w") as file:
        command = [sys.executable, "-m", "congelation", "check", str(correct), "--static"]
        code = subprocess.run(command, stdout=file, stderr=end, check=False).returncode
    os.close(end)
    os.close(terminal)
    assert code == 0
    scope, dynamic, counts = (tmp_path / "findings").read_text().splitlines()
    assert "static rules only: dynamic rules were not asked for" in scope
    assert "rules not evaluated: dynamic rules were not asked for" in dynamic
    assert "0 violation" in counts


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
    assert "FMI2-LIB-02 violation: fmi2GetVersion returns b'2.1' - " in done.stdout
    assert "FMI 2.0.5 section 2.1.4" in done.stdout
    assert "Traceback" not in done.stdout


def test_plugin_runs_next_to_other_tests(broken: Path, tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text("def test_mine():\n    pass\n")
    done = run_pytest(tmp_path, "--fmu", str(broken), "-k", "mine or FMI2-LIB-03")
    assert done.returncode == 0
    assert "2 passed" in done.stdout
    marked = run_pytest(tmp_path, "--fmu", str(broken), "-k", "mine or FMI2-LIB-03", "-m", "fmu")
    assert "1 passed" in marked.stdout


@pytest.mark.parametrize("name", ["../lag.fmu", "odd [1] a::b.fmu", "unpacked"])
def test_plugin_takes_paths_of_any_form(name: str, correct: Path, tmp_path: Path) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    if name == "unpacked":
        with zipfile.ZipFile(correct) as archive:
            archive.extractall(folder / name)
    else:
        shutil.copy(correct, folder / name)
    done = run_pytest(folder, "--fmu", name, "-k", "FMI2-LIB-02 or FMI2-XML-01")
    assert "2 passed" in done.stdout


def test_plugin_refuses_a_missing_fmu(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "--fmu", "missing.fmu")
    assert done.returncode == 4
    assert "there is no FMU at 'missing.fmu'" in done.stderr


def test_plugin_is_silent_when_not_asked(tmp_path: Path) -> None:
    (tmp_path / "test_mine.py").write_text("def test_mine():\n    pass\n")
    done = run_pytest(tmp_path)
    assert "1 passed" in done.stdout
