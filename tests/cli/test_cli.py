"""The command ``congelation``: output, exit codes, one line for what a user can set right."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.scenarios import FMUS, ROOT, SCALAR, UNDRAWN, write
from tests.studies import COMMAND, children, environment, is_alive, process, start, until
from tests.studies import command as congelation
from tests.studies import last_line as one_line


def test_run_and_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run as users start it, in a process of its own."""
    file = write(tmp_path)
    done = process("run", file, "--verify", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "results" / "loop"
    for text in ("A short loop", "Controller 1", "Controller 2", "peak_x", "settling_x [s]"):
        assert text in done.stdout
    for text in ("wall time [s]", "macro steps", "error of plant.x / peak", "not settled"):
        assert text in done.stdout
    assert "100%" in done.stderr
    last = done.stdout.splitlines()[-1]
    assert last == f"to look at them: congelation open {Path('results', 'loop')}"
    assert sorted(str(p.relative_to(out)) for p in out.glob("figures/*")) == [
        "figures/loop.pdf",
        "figures/loop.png",
    ]
    assert (out / "runs.parquet").is_file()
    assert "results/loop/runs.parquet" in done.stdout

    (out / "figures" / "loop.png").unlink()
    file.unlink()  # the report needs the stored results alone
    monkeypatch.chdir(tmp_path)
    done = congelation("report", "results/loop", "--html", "loop.html")
    assert done.returncode == 0, done.stderr
    assert "peak_x" in done.stdout
    assert (out / "figures" / "loop.png").is_file()
    assert "A short loop" in (tmp_path / "loop.html").read_text()


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    unknown = write(tmp_path, SCALAR, ("stop_time", "stop_tme"))
    line = one_line(congelation("run", unknown), 2)
    assert "loop.toml: experiment.stop_tme is not known here; did you mean 'stop_time'?" in line
    missing = write(tmp_path, SCALAR, (f"{FMUS}/ScalarPlant.fmu", "ScalarPlantt"))
    assert "congelation build" in one_line(congelation("run", missing), 2)
    assert "no such file" in one_line(congelation("run", tmp_path / "absent.toml"), 2)
    good = write(tmp_path)
    (tmp_path / "file").write_text("")
    line = one_line(congelation("run", good, "--out", tmp_path / "file" / "out"), 2)
    assert "no files can be written there" in line
    assert "is no result directory" in one_line(congelation("report", tmp_path), 2)


def test_a_run_that_fails_is_told_and_exit_code_1(tmp_path: Path) -> None:
    text = SCALAR.replace('{"controller.damping" = false}', '{"controller.epsilon" = -1.0}')
    done = congelation("run", write(tmp_path, text, UNDRAWN), "--out", tmp_path / "out")
    line = one_line(done, 1)
    assert "Controller 2: controller at t = 0: " in line
    assert "epsilon" in line
    assert "SLAVE_FAILED" in done.stdout
    assert "COMPLETED" in done.stdout
    assert congelation("report", tmp_path / "out").returncode == 0


def test_a_run_far_from_the_reference_is_told_and_exit_code_1(tmp_path: Path) -> None:
    held = ("step = 0.01", 'step = 0.05\ncoupling = "jacobi"')
    coarse = write(tmp_path, SCALAR, UNDRAWN, held)
    line = one_line(congelation("run", coarse, "--verify", "--out", tmp_path / "out"), 1)
    assert "is off the monolithic solution by" in line
    assert "give a smaller tolerance or, where the step is fixed, a shorter step" in line
    assert congelation("run", coarse, "--out", tmp_path / "out").returncode == 0


@pytest.mark.parametrize("arguments", [["run"], ["rnu", "x"], ["run", "x", "--ouut", "y"]])
def test_wrong_usage_is_exit_code_2(arguments: list[str]) -> None:
    done = congelation(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--help"], "co-simulated"),
        (["run", "--help"], "--verify"),
        (["report", "--help"], "--html"),
        (["--version"], "congelation "),
    ],
)
def test_help_and_version(arguments: list[str], text: str) -> None:
    done = congelation(*arguments)
    assert (done.returncode, done.stderr) == (0, "")
    assert text in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupting_a_run_is_one_line(tmp_path: Path, number: int) -> None:
    long = write(tmp_path, SCALAR, ("stop_time = 1.0", "stop_time = 10000.0"))
    running = subprocess.Popen(
        [*COMMAND, "run", str(long), "--out", str(tmp_path / "out")],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while not (tmp_path / "out").is_dir():
        time.sleep(0.05)
    time.sleep(0.5)
    running.send_signal(number)
    _, errors = running.communicate(timeout=30)
    assert running.returncode == 130
    assert "Traceback" not in errors
    assert errors.strip().splitlines()[-1].startswith("congelation: interrupted")


@pytest.mark.slow
def test_interrupting_a_search_is_one_line_and_ends_its_processes(tmp_path: Path) -> None:
    """A terminal sends Ctrl-C to all processes of the command."""
    running = start("attack", ROOT / "scenarios" / "fig2.toml", "--workers", "2")
    until(lambda: len(children(running.pid)) == 2)
    workers = children(running.pid)
    os.killpg(running.pid, signal.SIGINT)
    _, errors = running.communicate(timeout=30)
    assert running.returncode == 130, errors
    assert "Traceback" not in errors
    assert errors.strip().splitlines()[-1].startswith("congelation: interrupted: ")
    until(lambda: not any(map(is_alive, workers)))
