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
    done = congelation("certify", "scenarios/scalar.toml", "--samples", "50")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("congelation: Controller 2: V' + promised rate = ")
    assert "plant.x = " in line


def test_certify_of_extreme_numbers_is_one_line(tmp_path):
    """Refused as a spec; as a scenario, which does not start there, nowhere finite."""
    for name, old, code in (("specs", "epsilon = 1,", 2), ("scenarios", "epsilon = 0.3", 2)):
        text = (ROOT / name / "scalar.toml").read_text("utf-8")
        assert old in text
        text = text.replace(old, old.split("=")[0] + "= 1e-300" + ("," if "," in old else ""))
        for fmu in ("ScalarPlant", "ScalarController"):
            text = text.replace(f'fmu = "{fmu}"', f'fmu = "{ROOT}/fmus/{fmu}.fmu"')
        file = tmp_path / f"{name}.toml"
        file.write_text(text)
        done = congelation("certify", str(file), "--samples", "20")
        assert done.returncode == code
        (line,) = done.stderr.splitlines()
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
