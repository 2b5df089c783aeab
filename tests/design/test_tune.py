"""Tuning improves on the paper's gains, certified, and goes on where it stopped."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from congelation.design.tune import tune, write_proposals
from congelation.design.tuning_candidates import OBJECTIVES, Evaluator
from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.results.results import open_results
from congelation.verify.certify import certify_design, designs_of
from tests.scenarios import ROOT

SPEC = ROOT / "specs" / "state_feedback.toml"
SCALAR = ROOT / "specs" / "scalar.toml"


@pytest.mark.slow
def test_a_proposal_beats_the_papers_gains_in_settling_and_effort(tmp_path: Path) -> None:
    found = tune(SPEC, evaluations=60, proposals=2, out=tmp_path / "tried")
    assert found.own.objectives["settling"] == pytest.approx(1.8, rel=0.01)
    assert found.own.objectives["effort"] == pytest.approx(2.0e4, rel=0.03)
    assert found.nearest.objectives["settling"] < 1.8
    assert found.nearest.objectives["effort"] < 1.9e4
    assert found.unmet == ()
    columns = {*open_results(tmp_path / "tried").runs.columns}
    assert {"set.controller.c[1]", "set.controller.Gamma[1,1]", "metric.effort"} <= columns
    for file in write_proposals(found, tmp_path):
        read_spec(file)
        (design,) = designs_of(file)
        assert certify_design(design, 300).holds


def test_a_wish_that_cannot_be_met_is_said_with_the_nearest() -> None:
    wishes = {"settling": 1e-3, "effort": 1e-3}
    found = tune(SCALAR, wishes=wishes, evaluations=20, stop_time=5.0, proposals=1)
    assert len(found.unmet) == 2
    assert found.unmet[0].startswith("settling = 0.001: the nearest design has ")


def test_a_search_goes_on_from_its_result_directory(tmp_path: Path) -> None:
    options = {"evaluations": 20, "stop_time": 5.0, "out": tmp_path / "tried", "proposals": 1}
    whole = tune(SCALAR, **options)
    runs = open_results(tmp_path / "tried").runs
    assert len(runs) == whole.evaluations
    assert all(
        run.metrics["settling"] <= 5.0 or run.metrics["settling"] == math.inf
        for run in runs
        if run.status == "COMPLETED"
    )
    with pytest.raises(InvalidInput, match="--resume"):
        tune(SCALAR, **options)
    with sqlite3.connect(tmp_path / "tried" / "runs.sqlite") as database:  # as if killed early
        database.execute("DELETE FROM runs WHERE number >= 6")
    resumed = tune(SCALAR, **options, resume=True)
    assert resumed.nearest.objectives == whole.nearest.objectives
    assert len(open_results(tmp_path / "tried").runs) == whole.evaluations
    with pytest.raises(InvalidInput, match="another spec or horizon"):
        tune(SCALAR, **{**options, "stop_time": 6.0}, resume=True)


def test_a_wish_has_to_be_positive() -> None:
    with pytest.raises(InvalidInput, match="wish effort = -1"):
        tune(SPEC, wishes={"effort": -1.0})


def test_a_wish_for_a_long_settling_time_is_simulated_to_its_end() -> None:
    options = {"wishes": {"settling": 30.0, "effort": 1e9}, "evaluations": 10, "proposals": 1}
    found = tune(SCALAR, **options)
    assert found.stop_time == 60.0
    assert found.unmet == ()
    with pytest.raises(InvalidInput, match=r"settling = 30: the simulations end at 20 s"):
        tune(SCALAR, **options, stop_time=20.0)


def test_the_own_design_competes() -> None:
    """A wish that the spec meets by far, and hardly any other design."""
    own = Evaluator(SCALAR, 1e-2, 20.0).exact(np.zeros(3))
    wishes = {name: 1.001 * value for name, value in zip(OBJECTIVES, own, strict=True)}
    found = tune(SCALAR, wishes=wishes, evaluations=10, proposals=1)
    assert found.unmet == ()
    assert found.own.certified


def test_a_design_that_does_not_settle_is_said_with_the_stop_time() -> None:
    found = tune(SCALAR, wishes={"settling": 0.01}, evaluations=10, stop_time=0.02, proposals=1)
    (line,) = found.unmet
    assert line == (
        "settling = 0.01: the nearest design has not settled by 0.02 s (no candidate does)"
    )
