"""Metrics of a run that somebody else wrote: one that fails leaves the others."""

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.results.record import Trajectory
from congelation.scenario.metrics import METRICS, Metric
from congelation.scenario.parts import MetricSpec
from congelation.verify.measure import measure

TRAJECTORY = Trajectory(np.arange(3.0), ("plant.x",), np.array([[2.0], [1.0], [0.5]]), {})


def measured(monkeypatch, error):
    def fails(time, values):
        raise error

    monkeypatch.setitem(METRICS, "mine", Metric("mine", fails, "fails", str))
    specs = [MetricSpec("m", "mine", "plant.x", {}), MetricSpec("p", "peak", "plant.x", {})]
    return measure(specs, None, TRAJECTORY)  # neither is of the case


def test_a_metric_that_fails_is_named_and_leaves_the_others(monkeypatch) -> None:
    values, failed = measured(monkeypatch, ValueError("too few points"))
    assert values == {"m": None, "p": 2.0}
    assert failed == ("metrics.m (mine): ValueError: too few points",)


def test_a_metric_that_cannot_be_of_such_a_run_refuses_it(monkeypatch) -> None:
    with pytest.raises(InvalidInput, match="no such group"):
        measured(monkeypatch, InvalidInput("no such group"))
