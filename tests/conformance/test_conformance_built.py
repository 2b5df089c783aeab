"""The FMUs of this project (`make fmus`) break no rule but by the limits of their wrapper."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.conformance.limits import LIMITS
from congelation.conformance.rule import Outcome
from congelation.conformance.runner import run

FMUS = Path(__file__).parents[2] / "fmus"

# What these FMUs do not run into: PYTHONFMU-04 needs a constant, PYTHONFMU-13 an fmi2Error.
LIMITS_MET = {limit.id for limit in LIMITS} - {"PYTHONFMU-04", "PYTHONFMU-13"}


@pytest.mark.slow
def test_built_fmus_have_no_violation() -> None:
    paths = sorted(FMUS.glob("*.fmu"))
    assert paths, "there are no FMUs; make fmus builds them"
    report = run(paths)
    findings = [(fmu.path.stem, finding) for fmu in report.fmus for finding in fmu.findings]
    broken = [(name, f.rule.id, f.lines) for name, f in findings if f.outcome is Outcome.VIOLATION]
    assert broken == []
    assert {f.limit for _, f in findings if f.limit} == LIMITS_MET
