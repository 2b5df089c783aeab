"""Sentences about runs and studies: of many variants, of random axes, of settings with units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from congelation.report.axes import axes_of, short_names
from congelation.report.study_verdict import study_verdict
from congelation.report.verdict import bursts, reading_aids, run_verdict, settling_rule
from congelation.results.record import RunRecord, Study, Trajectory
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
        "C pays with a peak of |u| that is 3 times that of A.",
    ]


def test_peaks_that_are_alike_are_said_to_be_so() -> None:
    said = list(run_verdict(study(variants({"A": (1.0, 10.0), "B": (2.0, 10.01)})), {}))
    assert said[1:] == ["Their peaks of |u| differ by less than 5 %."]


def swept(outcomes: Mapping[str, Sequence[tuple[float, float]]]) -> Study:
    """Each variant's settling times and peaks of |u| at omega = 1, 10, 100 rad/s."""
    runs = [
        record(
            f"{name}{k}",
            k,
            variant=name,
            settings={OMEGA: 10.0**k},
            metrics={"settling_x": time, "peak_u": peak},
        )
        for name, found in outcomes.items()
        for k, (time, peak) in enumerate(found)
    ]
    return study(runs, varied=[OMEGA], axes=[[OMEGA]], units={OMEGA: "rad/s"})


def test_a_certificate_that_is_violated_is_counted_rounding_is_not() -> None:
    margins = {"A": [-0.1, 0.0, 5e-10], "B": [0.2, -0.1, 2e-9]}
    runs = [
        record(f"{name}{k}", k, variant=name, metrics={"margin": margin})
        for name, found in margins.items()
        for k, margin in enumerate(found)
    ]
    about = {"margin": {"metric": "lyapunov", "of": "the closed loop", "unit": ""}}
    said = "The Lyapunov certificate is violated"
    worst = "for the worst theta(t) within delta, whatever theta(t) is in the run"
    whole = list(study_verdict(study(runs, metrics=about)))
    assert whole[-1] == f"{said} in 2 of 3 runs of B, {worst}."
    once = [run for run in runs if run.number == 2]
    assert list(run_verdict(study(once, metrics=about), {}))[-1] == f"{said} for B, {worst}."
    aid = list(reading_aids(study(once, metrics=about)))[-1]
    assert aid.startswith("margin: by how much V'")
    assert worst in aid


def test_a_study_tells_what_is_dear_what_is_cheap_and_what_costs_the_same() -> None:
    peaks = {"A": 10.0, "dear": 30.0, "like": 10.2, "cheap": 5.0}
    found = swept({name: [(1.0, peak)] * 3 for name, peak in peaks.items()})
    assert list(study_verdict(found))[1:] == [
        "A needs only a peak of |u| that is 0.333 times that of dear.",
        "The peak of |u| of A is within 5 % of that of like.",
        "A pays with a peak of |u| that is 2 times that of cheap.",
    ]


def test_the_median_of_two_runs_is_their_mean() -> None:
    """The lower of the two would turn the conclusion about the price round."""
    peaks = {"A": (22.0, 0.5), "B": (1.0, 1.0)}
    found = swept({name: [(1.0 + k, p) for k, p in enumerate(of)] for name, of in peaks.items()})
    said = list(study_verdict(found))
    assert (
        said[0]
        == "A and B settle in all 2 runs, after 1 s at omega = 1 rad/s and after 2 s at 10 rad/s."
    )
    assert said[1] == (
        "A pays with a peak of |u| that is 11.2 times that of B (median at equal settings; 0.5 to "
        "22)."
    )


def test_an_unfinished_study_says_so_first() -> None:
    runs = [record(f"r{k}", k, metrics={"settling_x": 1.0}) for k in range(5)]
    assert next(iter(study_verdict(study(runs, planned=24)))) == (
        "5 of 24 runs are done, and what follows is of these alone; sweep --resume does the others."
    )
    assert "done" not in next(iter(study_verdict(study(runs, planned=5))))


def test_settling_that_follows_the_axis_is_told_by_its_ends() -> None:
    """That of A grows, that of B falls, that of C does neither, that of D hardly changes.

    Where it does neither, the settings of the least and the largest are named.
    """
    times = {
        "A": (1.0, 2.0, 4.0),
        "B": (9.0, 3.0, 3.01),
        "C": (2.0, 9.0, 3.0),
        "D": (1.0, 1.1, 1.2),
    }
    found = swept({name: [(time, 1.0) for time in of] for name, of in times.items()})
    assert list(study_verdict(found))[:4] == [
        "A settles in all 3 runs, after 1 s at omega = 1 rad/s and after 4 s at 100 rad/s.",
        "B settles in all 3 runs, after 9 s at omega = 1 rad/s and after 3.01 s at 100 rad/s.",
        "C settles in all 3 runs, after 3 s (median; 2 s at omega = 1 rad/s to "
        "9 s at omega = 10 rad/s).",
        "D settles in all 3 runs, after 1.1 s (median; 1 to 1.2 s).",
    ]


def test_the_rule_of_settling_names_the_stop_time() -> None:
    """What has not settled by then may settle later; a run that failed is none of these."""
    said = "A run settles when |plant.x| stays small until"
    both = variants({"A": (1.0, 10.0), "B": (math.inf, 10.0)})
    assert settling_rule(study(both, stop_time=12.0)) == (
        f"{said} the stop time, 12 s; one that is not settled then may settle later."
    )
    assert settling_rule(study(both[:1], stop_time=12.0)) == f"{said} the stop time, 12 s."
    failed = record("f", 2, metrics={"settling_x": math.inf}, status="DIVERGED")
    assert settling_rule(study([both[0], failed])) == f"{said} the stop time."  # not stored earlier
    varied = [
        record(f"r{t}", 1, settings={"experiment.stop_time": t}, metrics={"settling_x": 1.0})
        for t in (30.0, 400.0)
    ]
    assert settling_rule(study(varied, stop_time=30.0)) == f"{said} its stop time, 30 to 400 s."


def test_of_many_variants_the_first_and_the_last_to_settle_are_named() -> None:
    times = {f"V{k}": [(float(k), 1.0)] * 3 for k in range(1, 6)}
    times["never"] = [(math.inf, 1.0)] * 3
    assert list(study_verdict(swept(times)))[2] == (
        "The median settling time is least for V1 (1 s) and largest for V5 (5 s)."
    )


def test_many_variants_are_told_by_their_extremes() -> None:
    outcomes = {f"V{k}": (float(k), 10.0 * k) for k in range(1, 7)}
    outcomes |= {"W": (math.inf, 5.0), "X": (math.inf, 5.0)}
    assert list(run_verdict(study(variants(outcomes)), {})) == [
        "6 variants settle, from V1 after 1 s to V6 after 6 s; W and X do not settle.",
        "6 variants pay with a larger peak of |u| than W: from 2 times (V1) to 12 times (V6).",
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
    """The number of a term stays where there are several, that of an element always."""
    names = {
        "plant.profile[1].sine[1].omega": "sine[1].omega",
        "plant.profile[1].sine[2].omega": "sine[2].omega",
        "plant.profile[1].sine[1].amplitude": "sine.amplitude",
        "plant.profile[1].square[1].amplitude": "square.amplitude",
        "plant.profile[1].mean": "profile[1].mean",
        "plant.profile[2].mean": "profile[2].mean",
        "controller.c[1]": "c[1]",
    }
    assert short_names(names) == names


def test_a_run_that_comes_to_rest_and_bursts_is_told() -> None:
    """|x| is 1, rests at 0.001 from 2 s on, and rises for 1 s at 6 s; the bound is 0.01."""
    time = np.arange(0.0, 10.0, 0.5)

    def run(height: float) -> Trajectory:
        size = np.where(time < 2.0, 1.0, np.where((time >= 6.0) & (time < 7.0), height, 1e-3))
        x = np.column_stack([0.6 * size, 0.8 * size])
        return Trajectory(time, ("plant.x[1]", "plant.x[2]"), x, {})

    about = {"settling_x": {"metric": "settling_time", "of": "plant.x", "options": {"below": 0.01}}}
    found = study([record("r1", 1)], metrics=about)
    named = {"the run of A": run(0.5), "the run of B": run(0.09), "the run of C": run(1e-3)}
    assert list(bursts(found, named)) == [
        "In the run of A, |plant.x| falls below 0.01 at t = 2 s, and bursts to 0.5 at t = 6 s."
    ]
    never = Trajectory(time, ("plant.x[1]",), np.ones((len(time), 1)), {})
    unrecorded = Trajectory(time, ("controller.u",), np.ones((len(time), 1)), {})
    assert not list(bursts(found, {"the run of D": never, "the run of E": unrecorded}))
    unmeasured = study([record("r1", 1)], metrics={})
    assert not list(bursts(unmeasured, named))
