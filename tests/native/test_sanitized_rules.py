"""The conformance rules call native FMUs that are compiled with the sanitizers, or under valgrind.

A fault that a sanitizer sees ends the process in which a rule looks: a finding of that rule.
"""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest

from congelation.conformance.rule import Outcome
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check
from tests.native.test_calls import in_fuzz, needs_valgrind
from tests.native.test_twins import NATIVE

NAMES = ("ObserverFormPlant", "OutputFeedbackController", "Delay")
FLAGS = ("-shared", "-fPIC", "-g", "-O1", "-fsanitize=address,undefined")
# These measure memory and open files, which sanitizers and valgrind use themselves; and the host of
# another one is a program without them.
NOT_UNDER_SANITIZERS = ("FMI2-INST-08", "FMI2-INST-09", "FMI2-INST-10", "FMI2-HOST")


def runtime(name: str) -> str:
    done = subprocess.run(
        ["gcc", f"-print-file-name={name}"], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def sanitized(name: str, folder: Path) -> Path:
    """The FMU with a library that its sources were compiled into anew."""
    root = Path(fmpy.extract(str(NATIVE / f"{name}.fmu"), str(folder / name)))
    sources = sorted(str(path) for path in (root / "sources").glob("*.c"))
    library = root / "binaries" / "linux64" / f"{name}.so"
    command = ["gcc", *FLAGS, "-fno-sanitize-recover=all", *sources, "-lm", "-o", str(library)]
    subprocess.run(command, check=True)
    file = folder / f"{name}.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(root.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(root))
    return file


@pytest.mark.fuzz
@pytest.mark.slow
@in_fuzz
@pytest.mark.parametrize("name", NAMES)
def test_no_rule_meets_a_fault(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = sanitized(name, tmp_path)
    monkeypatch.setenv("LD_PRELOAD", f"{runtime('libasan.so')}:{runtime('libubsan.so')}")
    # Python itself leaves memory behind; and there may be no memory for what a rule asks for.
    monkeypatch.setenv(
        "ASAN_OPTIONS", "detect_leaks=0:abort_on_error=1:allocator_may_return_null=1"
    )
    rules = [r.id for r in RULES if not r.id.startswith(NOT_UNDER_SANITIZERS)]
    (fmu,) = check([file], rules=rules).fmus
    assert "\n".join(map(str, fmu.findings)) == ""
    outcomes = [v.outcome for v in fmu.verdicts]
    assert Outcome.NOT_EVALUATED not in outcomes
    assert outcomes.count(Outcome.PASS) > 80


@pytest.mark.fuzz
@pytest.mark.slow
@in_fuzz
@needs_valgrind
def test_valgrind_sees_no_fault_under_any_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every process of the check runs under valgrind; faults of Python itself are none of ours."""
    logs, name = tmp_path / "logs", "OutputFeedbackController"
    logs.mkdir()
    python = tmp_path / "python"
    under = f"PYTHONMALLOC=malloc exec valgrind --quiet --log-file={logs}/%p"
    python.write_text(f'#!/bin/sh\n{under} "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    rules = [r.id for r in RULES if not r.id.startswith(NOT_UNDER_SANITIZERS)]
    (fmu,) = check([NATIVE / f"{name}.fmu"], rules=rules, time_limit=600.0).fmus
    assert "\n".join(map(str, fmu.findings)) == ""
    assert [v.outcome for v in fmu.verdicts].count(Outcome.PASS) > 80
    # What faults is in the FMU's library, or called by it; Python's callbacks are deeper.
    fault = re.compile(rf"at 0x[^\n]*(\n==\d+==    by 0x[^\n]*)?/{name}\.so\)")
    assert len(list(logs.iterdir())) > 80
    found = [match[0] for log in logs.iterdir() for match in fault.finditer(log.read_text())]
    assert found == []
