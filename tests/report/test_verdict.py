"""Sentences about runs and studies: of many variants, of random axes, of settings with units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from congelation.report.verdict import axes_of, run_verdict, short_names, study_verdict
from congelation.results.record import RunRecord, Study
from congelation.scenario.load import load_scenario
from congelation.sweep.plan import plan_study
from tests.report.stored import ABOUT, record
from tests.scenarios import ROOT

OMEGA, PERIOD = "plant.profile[1].sine[1].omega", "plant.profile[1].square[1].period"


def study(runs: Sequence[RunRecord], **about: object) -> Study:
    metrics = {
        "settling_x": {"metric": "settling_time", "of": "plant.x", "unit": "s"},
        "peak_u": {"metric": "peak", "of": "controller.u", "unit": ""},
    }
    return Study(tuple(runs), {**ABOUT, "metrics": metrics, **about})


def variants(outcomes: Mapping[str, tuple[float, float]]) -> list[RunRecord]:
    """A run of each variant with its settling time and its peak of |u|."""
    return [
        record(f"r{k}", k, variant=name, metrics={"settling_x": time, "peak_u": peak})
        for k, (name, (time, peak)) in enumerate(outcomes.items())
    ]


def test_a_price_that_is_none_is_not_told() -> None:
    runs = variants({"A": (1.0, 10.0), "B": (2.0, 10.01), "C": (math.inf, 30.0)})
    assert list(run_verdict(study(runs), {})) == [
        "A settles after 1 s and B after 2 s; C does not settle.",
        "C pays 3 times the peak of |u| of A.",
    ]


def test_many_variants_are_told_by_their_extremes() -> None:
    outcomes = {f"V{k}": (float(k), 10.0 * k) for k in range(1, 7)}
    outcomes |= {"W": (math.inf, 5.0), "X": (math.inf, 5.0)}
    assert list(run_verdict(study(variants(outcomes)), {})) == [
        "6 variants settle, from V1 after 1 s to V6 after 6 s; W and X do not settle.",
        "6 variants pay, from V1 2 times to V6 12 times the peak of |u| of W.",
    ]


def test_variants_with_the_same_outcome_share_a_sentence() -> None:
    """C settles where omega is 10 rad/s or more, the others everywhere."""
    peaks = {"A": 60.0, "B": 6.0, "C": 6.0}
    runs = [
        record(
            f"{name}{k}",
            k,
            variant=name,
            settings={OMEGA: omega},
            metrics={"settling_x": 1.0 if name != "C" or omega >= 10 else math.inf, "peak_u": peak},
        )
        for k, omega in enumerate((0.1, 1.0, 10.0, 100.0))
        for name, peak in peaks.items()
    ]
    about = {"varied": [OMEGA], "axes": [[OMEGA]], "units": {OMEGA: "rad/s"}}
    assert list(study_verdict(study(runs, **about))) == [
        "A and B settle in all 4 runs, after 1 s.",
        "C settles in 2 of 4 runs: in all from omega = 10 rad/s on and in none up to "
        "omega = 1 rad/s.",
        "A pays with a peak of |u| that is 10 times that of B and C.",
    ]


def test_every_random_axis_counts_and_what_follows_from_another_does_not() -> None:
    """Values that are never drawn twice do not make one axis of two."""
    drawn = np.random.default_rng(1).uniform(size=(20, 2))
    runs = [
        record(f"r{k}", k, variant="A", settings={OMEGA: w, PERIOD: 6.28 / w, "plant.x0[1]": x})
        for k, (w, x) in enumerate(drawn)
    ]
    names = [OMEGA, PERIOD, "plant.x0[1]"]
    found = axes_of(study(runs, varied=names, axes=[[OMEGA, PERIOD], ["plant.x0[1]"]]))
    assert list(found) == [OMEGA, "plant.x0[1]"]


def test_the_plan_tells_the_axes_and_their_units(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios/study_drift.toml")
    about = plan_study(scenario, tmp_path, swept=True).store.about()
    assert about["axes"] == [[OMEGA, "experiment.stop_time"]]
    assert about["units"] == {OMEGA: "rad/s", "experiment.stop_time": "s"}


def test_names_are_as_short_as_they_can_be() -> None:
    omegas = ("plant.sine[1].omega", "plant.sine[2].omega", "controller.c")
    assert short_names(omegas) == dict(
        zip(omegas, ("sine[1].omega", "sine[2].omega", "c"), strict=True)
    )
