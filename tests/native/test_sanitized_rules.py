"""The conformance rules call native FMUs that are compiled with the sanitizers.

A fault ends the process in which a rule looks, which is a finding of that rule.
"""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import fmpy
import pytest

from congelation.conformance.rule import Outcome
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check
from tests.native.test_calls import in_fuzz
from tests.native.test_twins import NATIVE

NAMES = ("ObserverFormPlant", "OutputFeedbackController", "Delay")
FLAGS = ("-shared", "-fPIC", "-g", "-O1", "-fsanitize=address,undefined")
# These measure memory and open files, which the sanitizers use themselves; and the host of another
# one is a program without them.
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
