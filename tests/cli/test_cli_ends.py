"""Where output ends, and what `run` takes in place of what a scenario states."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from typing import TextIO

import pyarrow.parquet
import pytest

from congelation.cli import main
from congelation.results.results import open_results
from congelation.sweep.local import Local
from tests.cosim.c_fmus import SOURCES, plain_fmu, signals_fmu
from tests.scenarios import FMUS, ROOT, SCALAR, UNDRAWN, write
from tests.studies import COMMAND, children, environment, process, rows, start
from tests.studies import command as congelation
from tests.studies import last_line as one_line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_a_full_disk_behind_the_output_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, "info", FMUS / "ScalarPlant.fmu"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
        )
    assert done.returncode == 1
    assert done.stderr == ("congelation: the output cannot be written: No space left on device\n")


@contextmanager
def unread() -> Iterator[TextIO]:
    """A pipe that nobody reads."""
    read, written = os.pipe()
    os.close(read)
    stream = os.fdopen(written, "w")
    yield stream
    with suppress(BrokenPipeError):  # of what is left in its buffer
        stream.close()


def test_a_reader_that_has_enough_gets_no_traceback() -> None:
    with unread() as pipe:
        done = subprocess.run(
            [*COMMAND, "info", FMUS / "ScalarPlant.fmu"],
            stdout=pipe,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
        )
    assert (done.returncode, done.stderr) == (141, "")


def test_what_prints_ends_quietly_where_nobody_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 1 would be that of a failed run, 3 that of a violated certificate."""
    monkeypatch.chdir(tmp_path)
    file, out = write(tmp_path), tmp_path / "out"
    assert congelation("run", file, "--out", out).returncode == 0
    plant = FMUS / "ScalarPlant.fmu"
    for words in (
        ("--help",),
        ("run", "--help"),
        ("run", file, "--out", out, "--progress", "quiet"),
        ("ls", out),
        ("ls", out, "--json"),
        ("show", out, rows(out)[0]["run_id"]),
        ("report", out),
        ("export", out, "--csv", tmp_path / "csv"),
        ("info", plant),
        ("info", plant, "--json"),
        ("certify", ROOT / "specs" / "scalar.toml", "--samples", 20),
        ("schema", "scenario"),
        ("check", plant, "--static", "--table"),
        ("examples", tmp_path / "copies"),
        ("new", "servo"),
    ):
        errors = io.StringIO()
        with (
            unread() as pipe,
            redirect_stdout(pipe),
            redirect_stderr(errors),
            pytest.raises(SystemExit) as ended,
        ):
            main([*map(str, words)])
        assert (words, ended.value.code, errors.getvalue()) == (words, 141, "")


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_title_that_the_terminal_cannot_show_is_escaped(tmp_path: Path, encoding: str) -> None:
    file = write(tmp_path, SCALAR, UNDRAWN, ("A short loop", "Fast \u03b8(t)"))
    done = subprocess.run(
        [*COMMAND, "run", file, "--progress", "quiet"],
        capture_output=True,
        text=True,
        encoding=encoding,
        cwd=tmp_path,
        env={**environment(), "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert r"Fast \u03b8(t)" in done.stdout


@pytest.mark.parametrize("option", ["--junit", "--json"])
def test_a_report_that_cannot_be_written_is_refused_before_the_check(
    tmp_path: Path, option: str
) -> None:
    done = congelation("check", FMUS / "ScalarPlant.fmu", option, tmp_path)
    assert done.returncode == 2
    assert f"{option} {tmp_path}" in " ".join(done.stderr.replace("│", " ").split())
    assert "Traceback" not in done.stderr


def test_run_takes_times_and_coupling_from_its_options(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR, UNDRAWN)
    out = tmp_path / "out"
    done = congelation(
        "run", file, "--out", out, "--stop-time", "0.5", "--tolerance", "1e-4",
        "--coupling", "hermite", "--fmu-log", tmp_path / "log.txt",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    results = open_results(out)
    for run in results.runs:
        assert run.estimated_error is not None
        assert run.estimated_error <= 1e-4
        assert results.trajectory(run.run_id).time[-1] == 0.5
    assert (tmp_path / "log.txt").is_file()
    done = congelation("run", file, "--out", tmp_path / "steps", "--step", "0.25")
    assert [run.steps for run in open_results(tmp_path / "steps").runs] == [
        9,
        9,
    ]  # at 0.25 k and 0.15 k


def test_what_options_replaced_is_told_apart_wherever_runs_are_listed(tmp_path: Path) -> None:
    """Runs with and without options in one folder, and in two that are compared."""
    file = write(tmp_path, SCALAR, UNDRAWN)
    out, other = tmp_path / "out", tmp_path / "other"
    for folder, options in (
        (out, ()),
        (out, ("--tolerance", 1e-3, "--coupling", "hermite")),
        (out, ("--stop-time", 0.5)),
        (other, ()),
    ):
        assert congelation("run", file, "--out", folder, *options).returncode == 0
    columns = ["set.experiment.tolerance", "set.experiment.coupling", "set.experiment.stop_time"]
    found = [[row[name] for name in columns] for row in rows(out)]
    wanted = ([None] * 3, [1e-3, "hermite", None], [None, None, 0.5])
    assert found == [row for row in wanted for _ in range(2)]
    assert pyarrow.parquet.read_table(out / "runs.parquet").select(columns).to_pylist() == [
        dict(zip(columns, row, strict=True)) for row in found
    ]
    header, *lines = congelation("ls", out).stdout.splitlines()
    assert [name.removeprefix("set.") in header.split() for name in columns] == [True] * 3
    assert header.split()[1] == "study"
    assert len({line.split()[1] for line in lines}) == 3
    shown = json.loads(congelation("show", out, rows(out)[2]["run_id"], "--json").stdout)
    assert [shown[name] for name in columns] == [1e-3, "hermite", None]
    compared = congelation("report", other, out).stdout
    assert "changed experiment.stop_time: that of the scenario before, 0.5 now." in compared
    page = (out / "comparison.html").read_text(encoding="utf-8")
    assert "0.5 by an option" in page


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--stop-time", "-1"), "experiment.stop_time = -1 is not valid; give a time after"),
        (("--step", "0"), "experiment.step = 0.0 is not valid"),
        (("--tolerance", "2"), "experiment.tolerance = 2.0 is not valid"),
        (
            ("--coupling", "hermit"),
            "experiment.coupling = 'hermit' is not known; did you mean 'hermite'?",
        ),
        (("--stop-time", "nan"), "experiment.stop_time"),
        (("--fmu-log", "."), "--fmu-log .: this is a folder"),
    ],
)
def test_a_wrong_option_of_run_is_one_line(
    tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    done = congelation("run", write(tmp_path), "--out", tmp_path / "out", *options)
    assert message in one_line(done, 2)


def test_an_option_that_a_variant_sets_is_refused(tmp_path: Path) -> None:
    change = ('"controller.damping" = true', '"experiment.step" = 0.02')
    done = congelation("run", write(tmp_path, SCALAR, change), "--step", "0.1")
    assert "experiment.step is what the variant 'Controller 1' sets" in one_line(done, 2)


def test_messages_of_fmus_go_to_the_log(tmp_path: Path) -> None:
    # A gain that the FMU refuses: it logs the reason.
    file = write(tmp_path, SCALAR, ("epsilon = 0.3", "epsilon = -0.3"))
    log = tmp_path / "log.txt"
    done = congelation("run", file, "--out", tmp_path / "out", "--fmu-log", log)
    assert done.returncode != 0
    assert any("controller" in line and "epsilon" in line for line in log.read_text().splitlines())


def test_the_most_frequent_causes_end_a_study_with_failures(tmp_path: Path) -> None:
    axis = '\n[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [-0.1, -0.2, 0.3]\n'
    done = congelation("sweep", write(tmp_path, SCALAR + axis), "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "4 of 6 runs failed" in done.stderr
    assert any(line.startswith("congelation: 4 x, such as run ") and "epsilon" in line
               for line in done.stderr.splitlines())  # fmt: skip


def test_an_archive_without_a_stop_time_runs_with_one(tmp_path: Path) -> None:
    file = tmp_path / "loop.ssp"
    scenario = write(tmp_path, SCALAR, UNDRAWN)
    assert congelation("export-ssp", scenario, file).returncode == 0
    with zipfile.ZipFile(file) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    text = entries["SystemStructure.ssd"].decode()
    text = text.replace(' stopTime="1.0"', "").replace('"stop_time": 1.0', '"start_time": 0.0')
    entries["SystemStructure.ssd"] = text.replace('"start_time": 0.0,\n', "", 1).encode()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    done = congelation("run", file, "--out", tmp_path / "out")
    assert "run with --stop-time" in one_line(done, 2)
    done = congelation("run", file, "--out", tmp_path / "out", "--stop-time", "0.2")
    assert done.returncode == 0, done.stderr


def test_a_pipe_is_written_to_and_a_link_stays(tmp_path: Path) -> None:
    """Both were replaced by a file of their name; so would a device have been."""
    pipe, link, target = (tmp_path / name for name in ("pipe", "link", "target"))
    os.mkfifo(pipe)
    target.write_text("")
    link.symlink_to(target)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    fmu = FMUS / "ScalarPlant.fmu"
    done = congelation("check", fmu, "--static", "--json", pipe, "--junit", link)
    reader.join(timeout=60.0)
    assert done.returncode == 0, done.stderr
    assert pipe.is_fifo()
    assert json.loads(read[0])["counts"]["violation"] == 0
    assert link.is_symlink()
    assert "<testsuite" in target.read_text()


def test_a_spec_with_a_byte_order_mark_is_certified(tmp_path: Path) -> None:
    spec = tmp_path / "marked.toml"
    spec.write_bytes(b"\xef\xbb\xbf" + (ROOT / "specs" / "scalar.toml").read_bytes())
    done = congelation("certify", spec)
    assert done.returncode == 0, done.stderr
    assert "holds" in done.stdout


SLOW = """
title = "A spring of k = 1e5, held inputs, and a tolerance beyond reach"
connections = ["mass.y -> spring.u1", "spring.y -> force.u1", "force.y -> mass.u1"]
open = ["mass.u2", "spring.u2", "force.u2"]
components.mass = {{fmu = "{fmu}", start = {{b1 = 0.01, x0 = 0.1}}}}
components.spring = {{fmu = "{fmu}", start = {{b1 = 1.0}}}}
components.force = {{fmu = "{fmu}", start = {{d1 = -1e5}}}}

[experiment]
stop_time = 100000
tolerance = 1e-6
coupling = "derivative"
"""


@pytest.mark.slow
@pytest.mark.parametrize("form", ["bar", "json"])
def test_steps_that_collapse_are_told_while_the_run_goes_on(tmp_path: Path, form: str) -> None:
    file = tmp_path / "slow.toml"
    file.write_text(SLOW.format(fmu=plain_fmu(tmp_path)))
    ended = process("run", file, "--out", tmp_path / "out", "--timeout", "5", "--progress", form)
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    said = [line for line in ended.stderr.splitlines() if "the steps are" in line]
    assert len(said) == 1, ended.stderr
    if form == "json":
        line = json.loads(said[0])["notice"]
    else:
        assert said[0].startswith("congelation: ")
        line = said[0].removeprefix("congelation: ")
    assert re.fullmatch(
        r"slow: at t = \S+ of 100000 s the steps are \S+ s long: "
        r"if they stay so, the rest takes \S+ steps and about \S+ (s|min); a larger "
        r"tolerance makes them longer, max_steps or --timeout ends the run",
        line,
    )
    (row,) = open_results(tmp_path / "out").runs.rows()
    assert row["status"] == "TIMED_OUT"


def test_a_run_that_max_steps_ends_has_nothing_to_tell_before(tmp_path: Path) -> None:
    file = tmp_path / "slow.toml"
    file.write_text(SLOW.format(fmu=plain_fmu(tmp_path)) + "max_steps = 500\n")
    ended = congelation("run", file, "--out", tmp_path / "few", "--progress", "json")
    (row,) = open_results(tmp_path / "few").runs.rows()
    assert row["status"] == "TOO_MANY_STEPS"
    assert "the steps are" not in ended.stderr


ONE = """
title = "One decay"
open = ["a.u1", "a.u2"]
connections = []
components.a = {{fmu = "{fmu}", start = {{a = -1.0, x0 = 2.0, {setting}}}}}

[experiment]
stop_time = 1.0
step = 0.125
coupling = "jacobi"
record = ["a.y"]

[metrics]
peak_y = {{metric = "peak", of = "a.y"}}
"""


def test_a_run_that_its_fmu_ends_has_a_row_and_is_terminated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, out, notes = tmp_path / "one.toml", tmp_path / "out", tmp_path / "notes"
    monkeypatch.setenv("PLAIN_FMU_NOTES", str(notes))
    file.write_text(ONE.format(fmu=plain_fmu(tmp_path), setting="ends = 0.6"))
    done = congelation("run", file, "--out", out)
    results = open_results(out)
    (found,) = results.runs
    assert (done.returncode, found.status) == (0, "TERMINATED"), done.stderr
    assert found.metrics["peak_y"] == 2.0
    assert results.trajectory(found.run_id).time[-1] == 0.5
    assert notes.read_text() == "T"


THREE = """
[[sweep.axes]]
set = "a.x0"
values = [2.0, 3.0, 4.0]
"""


@pytest.mark.workers
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (0, None),
        (9, r"ended the worker process \(SIGSEGV\), after the run; no result is lost"),
        (12, "returned fmi2Error: the report cannot be written"),
        pytest.param(
            11,
            r"did not return within \d+ s, after the run; no result is lost",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_fmi2terminate_is_called_once_per_run_and_loses_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: int, said: str | None
) -> None:
    """The FMU notes each call; in it, it does nothing special, crashes, refuses or hangs."""
    file, out, notes = tmp_path / "one.toml", tmp_path / "out", tmp_path / "notes"
    monkeypatch.setenv("PLAIN_FMU_NOTES", str(notes))
    monkeypatch.setattr(sys.modules[Local.__module__], "GRACE", 1.0)
    text = ONE.format(fmu=plain_fmu(tmp_path), setting=f"fault = {fault}")
    file.write_text(text + THREE)
    done = congelation("sweep", file, "--out", out, "--progress", "json")
    assert done.returncode == 0, done.stderr
    runs = open_results(out).runs
    assert sorted(run.metrics["peak_y"] for run in runs) == [2.0, 3.0, 4.0]
    assert {run.status for run in runs} == {"COMPLETED"}
    # A run whose row had not been sent when its worker process ended is done a second time.
    calls = notes.read_text().count("T")
    assert calls == 3 if fault in (0, 12) else 3 <= calls <= 4
    notices = [json.loads(line)["notice"] for line in done.stderr.splitlines() if "notice" in line]
    if said is None:
        assert notices == []
    else:
        (line,) = notices
        assert re.fullmatch(rf"fmi2Terminate of a \(plain\S*\.fmu\) {said}", line), line
    assert children(os.getpid()) == []


def test_warnings_of_an_fmu_are_counted_and_kept(tmp_path: Path) -> None:
    """One at each of the four steps past t = 0.5."""
    file, out, log = tmp_path / "one.toml", tmp_path / "out", tmp_path / "log.txt"
    file.write_text(ONE.format(fmu=plain_fmu(tmp_path), setting="fault = 10"))
    done = congelation("run", file, "--out", out, "--fmu-log", log)
    assert done.returncode == 0, done.stderr
    (found,) = open_results(out).runs
    assert (found.status, found.warnings) == ("COMPLETED", 4)
    assert log.read_text().count("is large") == 4


MARKS = """
#include "{plain}"
__attribute__((constructor)) static void loaded(void) {{ fclose(fopen("{mark}", "w")); }}
"""


def test_what_is_only_described_is_not_loaded(tmp_path: Path) -> None:
    """An FMU whose library writes a file as soon as it is loaded."""
    mark = tmp_path / "loaded"
    source = tmp_path / "plain.c"
    source.write_text(MARKS.format(plain=SOURCES / "plain.c", mark=mark))
    fmu = plain_fmu(tmp_path, source=source)
    file = tmp_path / "one.toml"
    file.write_text(ONE.format(fmu=fmu, setting="ends = 0"))
    for arguments in (
        ("info", fmu),
        ("check", fmu, "--static"),
        ("export-ssp", file, tmp_path / "one.ssp"),
    ):
        done = congelation(*arguments)
        assert done.returncode in (0, 1), done.stderr
        assert not mark.exists(), arguments
    assert congelation("run", file, "--out", tmp_path / "out").returncode == 0
    assert mark.exists()


def test_a_closed_stdout_is_no_error(tmp_path: Path) -> None:
    """Whoever started the command may have closed it, as `>&-` does."""
    line = f"exec {shlex.join(map(str, COMMAND))} examples {tmp_path} >&-"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, env=environment())
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_scheduler_ends_a_run_like_ctrl_c(tmp_path: Path, number: signal.Signals) -> None:
    long = write(tmp_path, SCALAR, ("stop_time = 1.0", "stop_time = 1e6"))
    run = start(
        "run", long, "--out", tmp_path / "out", "--progress", "json",
        # What started the tests may ignore it, as nohup does SIGHUP, and processes inherit that.
        preexec_fn=partial(signal.signal, number, signal.SIG_DFL),
    )  # fmt: skip
    assert run.stdout is not None
    assert run.stderr is not None
    run.stderr.readline()  # it is under way
    os.kill(run.pid, number)
    try:
        _, errors = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 130
    assert "Traceback" not in errors
    assert errors.splitlines()[-1] == "congelation: interrupted after 0 of 2 runs"


@pytest.mark.parametrize("after", [0.3, 3.0], ids=["while it is loaded", "while processes start"])
def test_an_interrupted_search_leaves_no_traceback_of_its_processes(
    tmp_path: Path, after: float
) -> None:
    """A terminal sends Ctrl-C to the command and to its processes."""
    run = start("attack", write(tmp_path), "--workers", 2, "--effort", 9, "--out", tmp_path / "a")
    time.sleep(after)
    os.killpg(run.pid, signal.SIGINT)
    _, errors = run.communicate(timeout=60)
    assert run.returncode == 130, errors
    assert "Traceback" not in errors


def test_dollars_in_a_name_are_no_formula(tmp_path: Path) -> None:
    name = ('"Controller 2"', "'5$ of 10$_x, \\frac{1$'")
    scenario = write(tmp_path, SCALAR, name)
    done = congelation("run", scenario, "--out", tmp_path / "out", "--progress", "quiet")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out" / "figures" / "loop.png").is_file()


def test_a_search_from_standard_input_has_processes_too() -> None:
    script = (
        "import congelation as cg\n"
        "found = cg.attack('scenarios/scalar.toml', variants=['Controller 2'],\n"
        "                  objectives=['peak', 'ise'], effort=0.01, workers=2)\n"
        "print(len(found.finds))\n"
    )
    done = subprocess.run(
        [sys.executable, "-"],
        input=script,
        capture_output=True,
        text=True,
        env=environment(),
        cwd=ROOT,
        timeout=120,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "2\n", "")


def test_what_a_completed_run_has_to_say_is_told(tmp_path: Path) -> None:
    """Here that the points are too few for an integral; each kind once."""
    file = write(
        tmp_path,
        SCALAR,
        ("{square = {amplitude = 0.4, period = 0.3}}", "{sine = {amplitude = 0.4, omega = 200.0}}"),
        ("{constant = -3.0}, ", ""),
        ("[metrics]", '[metrics]\nise_theta = {metric = "ise", of = "plant.theta"}'),
    )
    done = congelation("run", file, "--out", tmp_path / "out", "--progress", "quiet")
    assert done.returncode == 0
    assert done.stderr.splitlines()[-1] == (
        "congelation: warning: Controller 1 (and 1 other run): The points are too far apart for "
        "metric ise_theta, as the signal turns between them; give an output_interval or a shorter "
        "step."
    )


def test_a_folder_whose_name_is_too_long_or_empty_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = write(tmp_path, SCALAR)
    long = "a" * 300
    assert f"results {long}: no files can be written there (File name too long)" in one_line(
        congelation("run", file, "--out", long), 2
    )
    for words in (["--out", ""], ["--out="]):
        assert one_line(congelation("run", file, *words), 2) == (
            "congelation: an argument is empty after --out; give it a value, or leave it out"
        )
    assert [entry.name for entry in tmp_path.iterdir()] == ["loop.toml"]


def test_a_current_folder_that_was_removed_is_named(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    call = (
        f"cd {gone} && rmdir {gone} && {' '.join(COMMAND)} run {write(tmp_path)} --out {tmp_path}/o"
    )
    done = subprocess.run(
        ["sh", "-c", call], capture_output=True, text=True, env=environment(), timeout=60
    )
    assert "the current folder was removed; change to one that exists" in one_line(done, 2)


def test_metrics_of_an_enumeration_are_warned_of(tmp_path: Path) -> None:
    """Its numbers stand for names."""
    items = '<Item name="off" value="0"/><Item name="on" value="1"/>'
    typed = f'<TypeDefinitions><SimpleType name="T"><Enumeration>{items}</Enumeration></SimpleType>'
    fmu = signals_fmu(tmp_path)
    with zipfile.ZipFile(fmu) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    text = entries["modelDescription.xml"].decode()
    text = text.replace("<Integer/>", '<Enumeration declaredType="T"/>')
    text = text.replace("<DefaultExperiment", f"{typed}</TypeDefinitions><DefaultExperiment")
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, text if name == "modelDescription.xml" else content)
    file = tmp_path / "s.toml"
    file.write_text(
        f"""
        title = "Signals"
        connections = []
        open = ["s.u", "s.switch", "s.level"]
        components.s.fmu = "{fmu}"
        experiment = {{stop_time = 0.1, step = 0.05}}
        metrics.mean = {{metric = "ise", of = "s.count"}}
        """
    )
    done = congelation("run", file, "--out", tmp_path / "out", "--progress", "quiet")
    assert done.returncode == 0
    assert "metrics.mean: 's.count' is an enumeration, whose numbers stand for names" in done.stderr
