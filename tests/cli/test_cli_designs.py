"""`congelation certify` and `congelation check` as users meet them: real processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def congelation(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "congelation", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)


def test_certify_passes_a_certified_design():
    done = congelation("certify", "specs/scalar.toml", "--samples", "50")
    assert done.returncode == 0, done.stderr
    assert "holds" in done.stdout
    assert done.stderr == ""


def test_certify_names_the_state_of_a_violation():
    done = congelation("certify", "scenarios/fig2.toml", "--samples", "50")
    assert done.returncode == 3
    (line,) = done.stderr.splitlines()
    sentence = (
        "congelation: Controller 2: V' exceeds what the design promises: V' + promised rate = "
    )
    assert line.startswith(sentence)
    assert "plant.x[1] = " in line


def changed(folder: Path, spec: str, old: str, new: str) -> str:
    """A copy of a shipped spec with one change."""
    text = (ROOT / "specs" / f"{spec}.toml").read_text("utf-8")
    assert old in text
    file = folder / f"{spec}.toml"
    file.write_text(text.replace(old, new))
    return str(file)


def test_certify_refuses_a_broken_assumption(tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "delta = 1}", "delta = 0.5}"))
    assert done.returncode == 3
    assert done.stderr == (
        "congelation: Scalar example: an assumption of the theorem is broken: "
        "controller.start.delta: 0.5 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile\n"
    )
    assert "assumption" in done.stdout


def test_certify_names_an_unstable_zero(tmp_path):
    """b_0 is the second element of theta where n = 2, m = 1."""
    text = (ROOT / "specs" / "relative_degree_1.toml").read_text("utf-8")
    (line,) = (line for line in text.splitlines() if line.startswith('"theta[2]"'))
    file = changed(tmp_path, "relative_degree_1", line, '"theta[2]" = [{constant = -1.5}]')
    done = congelation("certify", file)
    assert done.returncode == 3
    (complaint,) = done.stderr.splitlines()
    assert "is not Hurwitz (Assumption 2): the plant has a zero at s = " in complaint


def test_certify_says_where_precision_ends(tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "epsilon = 1,", "epsilon = 1e-12,"))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "double precision does not suffice" in line
    assert "epsilon = 1e-12" in line


def test_certify_has_no_certificate_for_frozen_estimates(tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", "gamma = 1,", "adapt = false,"))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "no certificate is claimed for this adaptation law: frozen estimates" in line
    assert "no certificate" in done.stdout


def test_certify_warns_of_what_is_left_out(tmp_path):
    done = congelation("certify", changed(tmp_path, "scalar", ", delta = 1}", "}"))
    assert done.returncode == 0
    assert done.stderr == (
        "congelation: Scalar example: warning: controller.start.delta: it is left out, and so 1, "
        "which covers 1, the radius of the box that theta(t) fills; give delta = 1, or more\n"
    )


def test_certify_of_extreme_numbers_is_one_line(tmp_path):
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


def test_certify_without_a_file():
    done = congelation("certify", "specs/none.toml")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "no such file" in line


def test_check_reports_no_violation_of_our_own(tmp_path):
    """The package rules, which take no time; the dynamic ones have tests of their own."""
    report = tmp_path / "junit.xml"
    done = congelation(
        "check", "fmus/ScalarPlant.fmu", "--rule", "FMI2-XML", "--junit", str(report)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 violation" in done.stdout
    assert report.read_text("utf-8").startswith("<?xml")


def test_check_of_no_fmu():
    done = congelation("check", "fmus/None.fmu")
    assert done.returncode == 2
    assert "there is no FMU at 'fmus/None.fmu'" in " ".join(done.stderr.split())
