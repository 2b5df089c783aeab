"""An FMU that pythonfmu builds from a first-time user's slave: every finding is a known one."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import lag
import pytest

from congelation.conformance.accepted import LIMITS
from congelation.conformance.checker import Checker
from congelation.conformance.finding import FmuReport
from congelation.conformance.rule import BY_ID, Outcome
from congelation.conformance.runner import check

# What a slave or its builder can do something about.
FINDINGS = {
    "FMI2-XML-04": "the date has an offset in place of Z",
    "FMI2-VARS-03": "the default variability is illegal for a parameter",
    "FMI2-STRUCT-02": "InitialUnknowns are not written",
    "FMI2-HOST-02": "libpython is needed and not documented",
    "FMI2-EXP-04": "stopTime is not looked at",
    "FMI2-STATE-02": "a step is made in any state",
    "FMI2-STEP-03": "any step size is taken",
    "FMI2-STEP-04": "any step size is taken",
    "FMI2-VALUE-06": "the exception for a wrong reference becomes fmi2Fatal",
    "FMI2-FMUSTATE-01": "the state holds registered variables alone",
    "FMI2-FMUSTATE-05": "the same",
    "FMI2-FMUSTATE-07": "the same",
    "FMI2-SERIAL-01": "the same",
    "FMI2-SERIAL-02": "the same",
    "FMI2-SERIAL-04": "the exception for wrong bytes becomes fmi2Fatal",
    "FMI2-LOG-01": "the message of fmi2Fatal has no category",
    "FMI2-ROBUST-04": "the exception for wrong bytes becomes fmi2Fatal",
}

# PYTHONFMU-04 needs a constant, PYTHONFMU-05 a step that is discarded.
LIMITS_MET = {limit.id for limit in LIMITS} - {"PYTHONFMU-04", "PYTHONFMU-05"}


def built(script: Path, folder: Path) -> Path:
    """Build an FMU with pythonfmu's own command."""
    options = ["--handle-state", "--serialize-state"]
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", folder, *options]
    subprocess.run(command, check=True, capture_output=True)
    (path,) = folder.glob("*.fmu")
    return path


@pytest.fixture(scope="module")
def naive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU of naive_slave.py."""
    return built(lag.SOURCES / "naive_slave.py", tmp_path_factory.mktemp("naive"))


@pytest.fixture(scope="module")
def findings(naive: Path) -> FmuReport:
    """What the checker finds in it."""
    (report,) = check([naive]).fmus
    return report


def test_findings_in_a_naive_slave(findings: FmuReport) -> None:
    found = {f.rule for f in findings.findings if not f.known}
    assert found == set(FINDINGS)


def test_limits_of_the_wrapper(findings: FmuReport) -> None:
    found = {f.known.partition(":")[0] for f in findings.findings if f.known}
    assert found == LIMITS_MET


def test_limits_name_rules_once() -> None:
    assert len({limit.id for limit in LIMITS}) == len(LIMITS)
    assert len({limit.rule for limit in LIMITS}) == len(LIMITS)
    assert {limit.rule for limit in LIMITS} <= set(BY_ID)


def test_two_slaves_in_modules_of_the_same_name(naive: Path, tmp_path: Path) -> None:
    script = tmp_path / "naive_slave.py"
    text = (lag.SOURCES / "naive_slave.py").read_text()
    script.write_text(text.replace("NaiveLag", "OtherLag").replace("2.0 *", "3.0 *"))
    other = built(script, tmp_path)
    shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
    with Checker(naive, other) as checker:
        verdict = checker.check(BY_ID["FMI2-INST-06"])
    assert verdict.outcome is Outcome.FOUND
