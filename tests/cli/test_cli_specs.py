"""The commands on specs and FMUs, and `check`, run in this process as users run them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from congelation import cli
from congelation.cli import specs
from congelation.cli.shared import EXIT_CODES
from tests.studies import environment

ROOT = Path(__file__).resolve().parents[2]


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def congelation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Done]:
    """The command line, called from the top of the checkout."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: object) -> Done:
        with pytest.raises(SystemExit) as ended:
            cli.main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Done(int(ended.value.code or 0), said.out, said.err)

    return call


def test_certify_passes_a_certified_design(congelation):
    done = congelation("certify", "specs/scalar.toml", "--samples", "50")
    assert done.returncode == 0, done.stderr
    assert "holds" in done.stdout
    assert done.stderr == ""


def test_certify_names_the_state_of_a_violation(congelation):
    done = congelation("certify", "scenarios/fig2.toml", "--samples", "50")
    assert done.returncode == 3
    (line,) = done.stderr.splitlines()
    sentence = (
        "congelation: Controller 2: V' exceeds what the design promises: V' + promised rate = "
    )
    assert line.startswith(sentence)
    assert "plant.x[1] = " in line


def changed(folder: Path, spec: str, old: str, new: str, name: str = "") -> str:
    """A copy of a shipped spec with one change."""
    text = (ROOT / "specs" / f"{spec}.toml").read_text("utf-8")
    assert old in text
    file = folder / f"{name or spec}.toml"
    file.write_text(text.replace(old, new))
    return str(file)


def test_certify_refuses_a_broken_assumption(congelation, tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "delta = 1}", "delta = 0.5}"))
    assert done.returncode == 3
    assert done.stderr == (
        "congelation: Scalar example: an assumption of the theorem is broken: "
        "controller.start.delta: 0.5 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile\n"
    )
    assert done.stdout == ""


def test_certify_names_an_unstable_zero(congelation, tmp_path):
    """b_0 is the second element of theta where n = 2, m = 1."""
    text = (ROOT / "specs" / "relative_degree_1.toml").read_text("utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith('"theta[2]"'))
    file = changed(tmp_path, "relative_degree_1", line, '"theta[2]" = [{constant = -1.5}]')
    done = congelation("certify", file)
    assert done.returncode == 3
    (complaint,) = done.stderr.splitlines()
    assert "is not Hurwitz (Assumption 2): the plant has a zero at s = " in complaint


@pytest.mark.parametrize(
    ("b_1", "b_0", "said"),
    [
        ("{constant = 0.5}", "{constant = -1.0}", "(Assumption 2): the plant has a zero at s = 2"),
        (
            "{constant = 0.5}, {sine = {amplitude = 0.2, omega = 1.0}}",
            "{constant = 0.1774}",
            "varies between 0.3 and 0.7, and output feedback is proved for constant b",
        ),
    ],
)
@pytest.mark.slow
def test_a_numerator_outside_the_theorem_is_refused_and_warned_of(
    congelation, tmp_path, b_1, b_0, said
):
    """The observer form with n = 3, m = 1, as built FMUs: certify refuses, run warns."""
    text = (ROOT / "scenarios" / "stable_zero3.toml").read_text("utf-8")
    for old, new in (
        ('"theta[1]" = [{constant = 1.151}]', f'"theta[1]" = [{b_1}]'),
        ('"theta[2]" = [{constant = 0.1774}]', f'"theta[2]" = [{b_0}]'),
        ("stop_time = 20.0", "stop_time = 0.1"),
    ):
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "zero.toml"
    file.write_text(text, encoding="utf-8")
    done = congelation("certify", file, "--samples", "10")
    assert done.returncode == 3
    assert all(said in line for line in done.stderr.splitlines())
    done = congelation("run", file, "--out", tmp_path / "out", "--progress", "quiet")
    assert done.returncode == 0
    warnings = [line for line in done.stderr.splitlines() if said in line]
    assert len(warnings) == 2  # of each controller
    assert all(line.startswith("congelation: warning: ") for line in warnings)


def test_certify_says_where_precision_ends(congelation, tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "epsilon = 1,", "epsilon = 1e-12,"))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "double precision does not suffice" in line
    assert "epsilon = 1e-12" in line


def test_certify_has_no_certificate_for_frozen_estimates(congelation, tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "gamma = 1,", "adapt = false,"))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "no certificate is claimed for this adaptation law: frozen estimates" in line
    assert done.stdout == ""


def test_certify_warns_of_what_is_left_out(congelation, tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", ", delta = 1}", "}"))
    assert done.returncode == 0
    assert done.stderr == (
        "congelation: Scalar example: warning: controller.start.delta: it is left out, and so 1, "
        "which covers 1, the radius of the box that theta(t) fills; give delta = 1, or more "
        "(docs/theory.md, 'The idea')\n"
    )


def test_certify_of_extreme_numbers_is_one_line(congelation, tmp_path):
    """Refused as a spec; as a scenario, which does not start there, nowhere finite."""
    for name, old, code in (("specs", "epsilon = 1,", 2), ("scenarios", "epsilon = 0.3", 1)):
        text = (ROOT / name / "scalar.toml").read_text("utf-8")
        assert old in text
        text = text.replace(old, old.split("=")[0] + "= 1e-300" + ("," if "," in old else ""))
        for fmu in ("ScalarPlant", "ScalarController"):
            text = text.replace(f'fmu = "{fmu}"', f'fmu = "{ROOT}/fmus/{fmu}.fmu"')
        file = tmp_path / f"{name}.toml"
        file.write_text(text)
        done = congelation("certify", str(file), "--samples", "20")
        assert done.returncode == code
        line = done.stderr.splitlines()[0]
        assert "epsilon = 1e-300" in line


def test_certify_without_a_file(congelation):
    done = congelation("certify", "specs/none.toml")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "no such file" in line


def test_check_reports_no_violation_of_our_own(congelation, tmp_path):
    """The package rules, which take no time; the dynamic ones have tests of their own."""
    report = tmp_path / "junit.xml"
    done = congelation(
        "check", "fmus/ScalarPlant.fmu", "--rule", "FMI2-XML", "--junit", str(report)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 violation" in done.stdout
    assert report.read_text("utf-8").startswith("<?xml")


def test_check_of_no_fmu(congelation):
    done = congelation("check", "fmus/None.fmu")
    assert done.returncode == 2
    assert "there is no FMU at 'fmus/None.fmu'" in " ".join(done.stderr.split())


def test_every_exit_code_is_in_the_help(congelation):
    done = congelation("--help")
    said = " ".join(done.stdout.split())
    for code, meaning in EXIT_CODES.items():
        assert f"{code} {meaning}" in said


def test_build_lists_what_it_wrote(congelation, tmp_path):
    done = congelation("build", "specs/scalar.toml", "--out", tmp_path)
    assert done == (0, f"{tmp_path}/ScalarPlant.fmu\n{tmp_path}/ScalarController.fmu\n", "")
    for name in ("ScalarPlant.fmu", "ScalarController.fmu"):
        assert (tmp_path / name).read_bytes() == (ROOT / "fmus" / name).read_bytes()


def test_build_warns_of_a_broken_assumption(congelation, tmp_path):
    spec = changed(tmp_path, "scalar", "delta = 1}", "delta = 0.5}")
    done = congelation("build", spec, "--out", tmp_path / "fmus")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 2
    assert done.stderr == (
        "congelation: warning: spec 'scalar': controller.start.delta: 0.5 is less than 1, the "
        "radius of the box that theta(t) fills; give delta = 1, or narrow the profile\n"
    )


def test_build_of_a_bad_spec_is_one_line(congelation, tmp_path):
    (tmp_path / "bad.toml").write_text('form = "scaler"\n')
    done = congelation("build", tmp_path / "bad.toml", "--out", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert "form = 'scaler' is not known; did you mean 'scalar'?" in line


def test_an_interruption_is_one_line(congelation, monkeypatch, tmp_path):
    def interrupted(*specs: Path, **options: object) -> list[Path]:
        raise KeyboardInterrupt

    monkeypatch.setattr(specs, "build_fmus", interrupted)
    done = congelation("build", "specs/scalar.toml", "--out", tmp_path)
    assert done == (130, "", f"congelation: {INTERRUPTION}\n")


INTERRUPTION = "interrupted: each file that is there is whole; give the command again for the rest"

PATCHED = """
import signal, sys, time
import congelation.__main__ as program
from congelation import cli
from congelation.cli import specs

def interrupt(*anything, **options):
    signal.raise_signal(signal.SIGINT)

class Finalized:
    __del__ = interrupt

def act(*anything, **options):
    ACTION

PLACE = act
sys.argv = ["congelation", "build", "spec.toml"]
program.main()
"""


@pytest.mark.parametrize(
    ("place", "action", "line"),
    [
        ("cli.load", "interrupt()", "interrupted: nothing was begun"),
        ("specs.build_fmus", "interrupt()", INTERRUPTION),
        # Python would end by the signal, as it does for code that it is given as a text.
        ("specs.build_fmus", 'exec("interrupt()", {"interrupt": interrupt})', INTERRUPTION),
        # Out of a finalizer no exception comes.
        ("specs.build_fmus", "Finalized(); time.sleep(60)", INTERRUPTION),
    ],
)
def test_wherever_ctrl_c_comes_it_is_one_line(place: str, action: str, line: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PATCHED.replace("PLACE", place).replace("ACTION", action)],
        capture_output=True,
        text=True,
        env=environment(),
        timeout=50,
    )
    assert (done.returncode, done.stderr) == (130, f"congelation: {line}\n")


@pytest.mark.parametrize("whole", [0, 1])
@pytest.mark.parametrize(
    "words",
    [
        ("new", "servo"),
        ("examples", "copied"),
        ("build", ROOT / "specs" / "scalar.toml", "--out", "fmus"),
        ("build", ROOT / "specs" / "scalar.toml", "--out", "fmus", "--c-code"),
    ],
)
def test_an_interruption_leaves_no_part_of_a_file(congelation, monkeypatch, tmp_path, words, whole):
    """Half of a file is written when Ctrl-C comes, after some whole ones."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus" / "manifest.json").write_text("{}")
    contents: list[bytes] = [b"{}"]
    write = Path.write_bytes

    def write_bytes(self: Path, data: bytes) -> int:
        if not self.absolute().is_relative_to(tmp_path):
            return write(self, data)
        if len(contents) > whole:
            write(self, data[: len(data) // 2])
            raise KeyboardInterrupt
        contents.append(data)
        return write(self, data)

    def write_text(self: Path, text: str, encoding: str | None = None) -> int:
        return self.write_bytes(text.encode(encoding or "utf-8"))

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    monkeypatch.setattr(Path, "write_text", write_text)
    assert congelation(*words).returncode == 130
    left = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert all(file.read_bytes() in contents for file in left)
    assert len(left) == (1 if words[0] == "new" else len(contents))


def test_info_as_json(congelation):
    found = json.loads(congelation("info", "fmus/ScalarPlant.fmu", "--json").stdout)
    assert found["pair"] is None
    assert [v["name"] for v in found["fmus"][0]["connect"]] == ["u"]


def test_info_of_a_pair(congelation):
    fmus = ("fmus/ScalarPlant.fmu", "fmus/ScalarController.fmu")
    done = congelation("info", *fmus, "--stop-time", "1")
    assert done.returncode == 0
    assert "largest communication step with held inputs" in done.stdout
    assert "Found by runs from the start values to t = 1 s" in done.stdout
    done = congelation("info", *fmus, "--stop-time", "1", "--json")
    pair = json.loads(done.stdout)["pair"]
    assert pair["accurate_step"] < pair["stable_step"]
    assert len(pair["connections"]) == 2


def test_certify_as_json(congelation):
    done = congelation("certify", "scenarios/fig2.toml", "--samples", "50", "--json")
    found = {design["design"]: design["verdict"] for design in json.loads(done.stdout)}
    assert found == {"Controller 1": "HOLDS", "Controller 2": "VIOLATED"}
    assert done.returncode == 3


def test_certify_takes_several_files(congelation, tmp_path):
    """A line for each design; the exit code is the highest of those of the files."""
    good, block, bad = "specs/scalar.toml", "specs/noise.toml", "specs/none.toml"
    short = changed(tmp_path, "scalar", "delta = 1}", "delta = 0.5}")
    frozen = changed(tmp_path, "scalar", "gamma = 1,", "adapt = false,", name="frozen")
    few = ("--samples", "20")
    done = congelation("certify", good, block, *few)
    assert done.returncode == 0
    assert re.fullmatch(
        r"specs/scalar.toml: Scalar example: holds \(worst margin \S+, relative margin \S+, "
        r"delta 1, radius of theta 1\)\n",
        done.stdout,
    )
    assert done.stderr.startswith("congelation: specs/noise.toml: this is the spec of a block")
    for files, code in (((good, frozen), 1), ((frozen, bad, good), 2), ((bad, short, frozen), 3)):
        done = congelation("certify", *files, *few)
        assert done.returncode == code
        assert len(done.stdout.splitlines()) == len([file for file in files if file is not bad])
    assert f"congelation: {short}: Scalar example: an assumption of the theorem" in done.stderr
    done = congelation("certify", good, bad, "--json", *few)
    assert done.returncode == 2
    first, second = json.loads(done.stdout)
    assert (first["file"], first["error"]) == (good, None)
    assert [design["verdict"] for design in first["designs"]] == ["HOLDS"]
    assert (second["designs"], second["error"]) == ([], done.stderr.strip().partition(": ")[2])
    done = congelation("certify", good, short, "--html", tmp_path / "page.html")
    assert (done.returncode, "--html is the page of one file" in done.stderr) == (2, True)


def test_examples_and_new_say_what_they_wrote(congelation, tmp_path, monkeypatch):
    done = congelation("examples", tmp_path)
    assert f"files in {tmp_path}/specs and {tmp_path}/scenarios" in done.stdout
    monkeypatch.chdir(tmp_path)
    done = congelation("new", "wing_flap")
    assert done.stdout.splitlines()[0] == (
        "congelation build wing_flap/spec.toml --out wing_flap/fmus"
    )
    done = congelation("new", "wing_flap")
    assert (done.returncode, done.stdout) == (2, "")
    assert "wing_flap is there already" in done.stderr
