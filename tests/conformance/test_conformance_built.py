"""The FMUs of this project (`make fmus`) break no rule but by the limits of their wrapper."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.conformance.known import LIMITS
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check

FMUS = Path(__file__).parents[2] / "fmus"

# What these FMUs do not run into: PYTHONFMU-04 needs a constant, PYTHONFMU-13 an fmi2Error.
LIMITS_MET = {limit.id for limit in LIMITS} - {"PYTHONFMU-04", "PYTHONFMU-13"}


# Rules about the wrapper's binary and the run time, which all of these FMUs share.
OF_ALL_ALIKE = ("FMI2-HOST", "FMI2-INST", "FMI2-LIB", "FMI2-LOG", "FMI2-URI")
# The FMUs that these rules look at: a plant and a controller, those with most variables.
LARGEST = ("ObserverFormPlant.fmu", "OutputFeedbackController.fmu")


@pytest.mark.slow
def test_built_fmus_have_no_violation() -> None:
    paths = sorted(FMUS.glob("*.fmu"))
    assert paths, "there are no FMUs; make fmus builds them"
    others = [path for path in paths if path.name not in LARGEST]
    of_each = [rule.id for rule in RULES if not rule.id.startswith(OF_ALL_ALIKE)]
    found = [
        *check([path for path in paths if path.name in LARGEST]).findings,
        *check(others, rules=of_each).findings,
    ]
    assert [str(finding) for finding in found if not finding.known] == []
    assert {f.known.partition(":")[0] for f in found} == LIMITS_MET
