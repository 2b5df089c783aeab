"""The FMUs of this project (`make fmus`) break no rule but by the limits of their wrapper."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.conformance.accepted import LIMITS
from congelation.conformance.rule import Outcome, StaticRule
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check

FMUS = Path(__file__).parents[2] / "fmus"

# What these FMUs do not run into: PYTHONFMU-04 needs a constant, PYTHONFMU-13 an fmi2Error.
LIMITS_MET = {limit.id for limit in LIMITS} - {"PYTHONFMU-04", "PYTHONFMU-13"}


# One FMU of each run time. All rules look at the block; the other two leave out those about the
# binary, which is the same file in each.
BLOCK = "Delay.fmu"
PLANT_AND_CONTROLLER = ("ScalarPlant.fmu", "ScalarController.fmu")
BINARY = ("FMI2-EXP", "FMI2-HOST", "FMI2-LIB", "FMI2-URI")
# Dynamic rules about what is derived for each FMU anew: dependencies, start values, the accuracy of
# a step, derivatives. All others are about the wrapper's binary and the run time.
DERIVED = (
    "FMI2-FLAG-04",
    "FMI2-FLAG-05",
    "FMI2-STEP-01",
    "FMI2-STRUCT",
    "FMI2-VALUE-01",
    "FMI2-VALUE-02",
    "FMI2-VALUE-03",
)
# FMUs whose equations have a form of their own; `make fuzz` has every rule look at every FMU.
OF_EACH_FORM = (
    "BoundEstimatorController.fmu",
    "DisturbedOutputPlant.fmu",
    "FilteredTransformationController.fmu",
    "MatchedController.fmu",
    "Noise.fmu",
    "ObserverFormPlant.fmu",
    "OutputFeedbackController.fmu",
    "Saturation.fmu",
    "StateFeedbackController.fmu",
    "StrictFeedbackPlant.fmu",
    "StructuredController.fmu",
)


@pytest.mark.slow
def test_built_fmus_have_no_violation() -> None:
    paths = sorted(FMUS.glob("*.fmu"))
    assert paths, "there are no FMUs; make fmus builds them"
    by_name = {path.name: path for path in paths}
    groups = ([BLOCK], PLANT_AND_CONTROLLER, OF_EACH_FORM)
    block, pair, of_forms = ([by_name.pop(name) for name in group] for group in groups)
    of_slaves = [r.id for r in RULES if isinstance(r, StaticRule) or not r.id.startswith(BINARY)]
    derived = [r.id for r in RULES if isinstance(r, StaticRule) or r.id.startswith(DERIVED)]
    found = [
        *check(block).findings,
        *check(pair, rules=of_slaves).findings,
        *check(of_forms, rules=derived).findings,
        *check([*by_name.values()], static=True).findings,
    ]
    assert [str(finding) for finding in found if not finding.known] == []
    assert {f.known.partition(":")[0] for f in found} == LIMITS_MET


@pytest.mark.slow
def test_native_fmus_are_correct_model_exchanges() -> None:
    """A plant with jumps and a controller; `make fuzz` has every rule look at every native FMU."""
    names = ("ObserverFormPlant.fmu", "OutputFeedbackController.fmu")
    report = check([FMUS / "native" / name for name in names], rules=["FMI2-ME"])
    outcomes = {(str(v.rule.id), v.outcome) for fmu in report.fmus for v in fmu.verdicts}
    assert len(outcomes) == sum(rule.id.startswith("FMI2-ME") for rule in RULES)
    assert {outcome for _, outcome in outcomes} == {Outcome.PASS}
