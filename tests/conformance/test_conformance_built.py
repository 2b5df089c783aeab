"""The FMUs of this project (`make fmus`) break no rule but by the limits of their wrapper."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.conformance.known import LIMITS
from congelation.conformance.runner import check

FMUS = Path(__file__).parents[2] / "fmus"

# What these FMUs do not run into: PYTHONFMU-04 needs a constant, PYTHONFMU-13 an fmi2Error.
LIMITS_MET = {limit.id for limit in LIMITS} - {"PYTHONFMU-04", "PYTHONFMU-13"}


@pytest.mark.slow
def test_built_fmus_have_no_violation() -> None:
    paths = sorted(FMUS.glob("*.fmu"))
    assert paths, "there are no FMUs; make fmus builds them"
    report = check(paths)
    assert [str(finding) for finding in report.findings if not finding.known] == []
    assert {f.known.partition(":")[0] for f in report.findings} == LIMITS_MET
