"""What a run comes to: a sentence or two, and the numbers that it rests on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from congelation.report.summary import NOT_SETTLED, metric_value, number
from congelation.results.labels import plain_unit
from congelation.results.record import RunRecord, Study, Trajectory

__all__ = [
    "DEAR",
    "LISTED",
    "WORST_THETA",
    "bursts",
    "listed",
    "metric_of_kind",
    "multiple",
    "peak_of_u",
    "prices",
    "reading_aids",
    "run_verdict",
    "settled",
    "settling_rule",
    "tiles",
    "violates",
]

LISTED = 4
"""Variants up to which a sentence names each of them with its numbers."""

DEAR = 1.05
"""A peak of |u| that is larger than the least by less than 5 % is no price."""

WORST_THETA = "for the worst theta(t) within delta, whatever theta(t) is in the run"
"""What the metric of the certificate is about."""

ROUNDING = 1e-9
"""A margin of the certificate up to this is rounding (`congelation.scenario.metrics`)."""

BURST = 10.0
"""Of the bound below which a run settles: what rises above so many of it, once within, bursts."""

_STOP_TIME = "experiment.stop_time"
"""The stop time as a setting that varies in a study."""


def settled(study: Study, run: RunRecord) -> bool:
    """Whether a run reached its stop time and, where that was measured, x settled."""
    name = metric_of_kind(study, "settling_time")
    if run.status != "COMPLETED":
        return False
    value = run.metrics.get(name) if name else 0.0
    return value is not None and math.isfinite(value)


def run_verdict(study: Study, peaks: Mapping[str, float]) -> Iterator[str]:
    """Sentences on the variants of a scenario, the first on whether they settle."""
    name = metric_of_kind(study, "settling_time")
    settling: list[tuple[float, str]] = []
    ended: dict[str, list[str]] = {}  # variants by how their runs ended otherwise
    for run in study.records:
        if run.failed:
            end = f"failed ({run.status})"
        elif run.status != "COMPLETED":
            end = "ended by an FMU before the stop time"
        elif not name:
            end = "reached the stop time"
        elif settled(study, run):
            settling.append((run.metrics[name] or 0.0, run.variant))
            continue
        else:
            end = "not settled"
        ended.setdefault(end, []).append(run.variant)
    said = []
    if len(settling) > LISTED:
        (early, first), (late, last) = min(settling), max(settling)
        said.append(
            f"{len(settling)} variants settle, from {first} after {number(early)} s to {last} "
            f"after {number(late)} s"
        )
    elif settling:
        (time, first), *rest = settling
        others = [f"{variant} after {number(late)} s" for late, variant in rest]
        said.append(listed([f"{first} settles after {number(time)} s", *others]))
    for end, variants in ended.items():
        one, several = {
            "not settled": ("does not settle", "do not settle"),
            "ended by an FMU before the stop time": (f"was {end}", f"were {end}"),
        }.get(end, (end, end))
        said.append(f"{listed(variants)} {one if len(variants) == 1 else several}")
    yield f"{'; '.join(said)}." if said else "No run has finished yet."
    yield from _price(prices(study, study.records, peaks))
    broken = [run.variant for run in study.records if violates(study, run)]
    if broken:
        yield f"The Lyapunov certificate is violated for {listed(broken)}, {WORST_THETA}."


def _price(priced: Mapping[str, float]) -> Iterator[str]:
    """What the variants pay whose peak of |u| is clearly above the least."""
    dear = sorted(((p, v) for v, p in priced.items() if p >= DEAR), reverse=True)
    if not dear:
        if priced:
            yield "Their peaks of |u| differ by less than 5 %."
        return
    cheapest = min(priced, key=lambda v: priced[v])
    if len(dear) > LISTED:
        (most, first), (least, last) = dear[0], dear[-1]
        yield (
            f"{len(dear)} variants pay with a larger peak of |u| than {cheapest}: from "
            f"{multiple(least)} times ({last}) to {multiple(most)} times ({first})."
        )
        return
    (most, first), *rest = dear
    others = [f"{variant} with one that is {multiple(ratio)} times" for ratio, variant in rest]
    peak = f"{first} pays with a peak of |u| that is {multiple(most)} times"
    yield f"{listed([peak, *others])} that of {cheapest}."


def bursts(study: Study, runs: Mapping[str, Trajectory]) -> Iterator[str]:
    """Sentences on runs that come to rest, and burst later.

    Parameters
    ----------
    study : Study
    runs : mapping of str to Trajectory
        What a sentence calls each run, as in "the run of Controller 2", and what it recorded.
    """
    name = metric_of_kind(study, "settling_time")
    about = study.about["metrics"][name] if name else {}
    below = about.get("options", {}).get("below")
    if below is None:
        return
    for called, recorded in runs.items():
        columns = recorded.group(about["of"])
        size = np.linalg.norm(recorded.select(columns), axis=1)
        within = np.flatnonzero(size <= below)
        if not columns or not within.size:
            continue
        first = int(within[0])
        top = first + int(np.argmax(size[first:]))
        if size[top] > BURST * below:
            yield (
                f"In {called}, |{about['of']}| falls below {below:g} at t = "
                f"{number(recorded.time[first])} s, and bursts to {number(size[top])} at t = "
                f"{number(recorded.time[top])} s."
            )


def tiles(study: Study, peaks: Mapping[str, float]) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The variant of each run, and names with values; `peaks` has the peak of \\|u\\| by run_id."""
    name = metric_of_kind(study, "settling_time")
    priced = prices(study, study.records, peaks)
    for run in study.records:
        lines = [("status", run.status.lower().replace("_", " "))]
        if name:
            value = run.metrics.get(name)
            said = metric_value(value, study.about["metrics"][name])
            known = value is not None and math.isfinite(value)
            lines.append(("settled", f"after {said} s" if known else said))
        peak = peak_of_u(study, run, peaks)
        if peak is not None:
            lines.append(("peak |u|", f"{number(peak)} {_unit_of_u(study)}".rstrip()))
        if run.variant in priced:
            lines.append(("price: peak |u| / least", f"{multiple(priced[run.variant])} ×"))
        margin = _margin(study, run)
        if margin is not None:
            lines.append(("worst margin, above 0 fails", number(margin)))
        error = run.trust_error if run.trust_error is not None else run.estimated_error
        if error is not None:
            lines.append(("estimated error, relative", f"{error:.1e}"))
        if run.coupling_why:
            lines.append(("coupling", f"{run.coupling} (auto)"))
        if run.trust_verdict:
            lines.append(("trust", run.trust_verdict))
        if run.deviations:
            worst = max(run.deviations.values())
            lines.append(("error against reference", f"{worst:.1e} of peak"))
        yield run.variant, lines


def prices(
    study: Study, runs: Sequence[RunRecord], peaks: Mapping[str, float] | None = None
) -> dict[str, float]:
    """By variant the peak of \\|u\\| as a multiple of the least; empty unless two have one."""
    found = {}
    for run in runs:
        peak = peak_of_u(study, run, peaks or {})
        if peak is not None and 0.0 < peak < math.inf:
            found[run.variant] = peak
    if len(found) < 2:
        return {}
    least = min(found.values())
    return {variant: peak / least for variant, peak in found.items()}


def settling_rule(study: Study) -> str:
    """What it means here that a run settles, until what time; empty where that was not measured."""
    name = metric_of_kind(study, "settling_time")
    if not name:
        return ""
    about = study.about["metrics"][name]
    below = about.get("options", {}).get("below")
    limit = f"below {below:g}" if below is not None else "small"
    stops = sorted(
        stop
        for run in study.records
        # A directory of an earlier version does not say it.
        if (stop := run.settings.get(_STOP_TIME, study.about.get("stop_time"))) is not None
    )
    until = "the stop time"
    if stops:
        low, high = number(stops[0]), number(stops[-1])
        until = f"the stop time, {low} s" if low == high else f"its stop time, {low} to {high} s"
    open_end = any(
        r.status == "COMPLETED" and r.metrics.get(name) == math.inf for r in study.records
    )
    later = f"; one that is {NOT_SETTLED} then may settle later" if open_end else ""
    return f"A run settles when |{about['of']}| stays {limit} until {until}{later}."


def reading_aids(study: Study) -> Iterator[str]:
    """What a table of metrics does not say: until when runs settle, which margins are good."""
    if rule := settling_rule(study):
        yield rule
    if name := metric_of_kind(study, "lyapunov"):
        yield (
            f"{name}: by how much V' is above what the certificate promises, relative to the terms "
            f"of V', {WORST_THETA}. The certificate holds where it is at most 0 (1e-9 for "
            "rounding). Where theta(t) breaks an assumption of the theorem there is no such value."
        )


def metric_of_kind(study: Study, kind: str) -> str | None:
    """The name of the first metric of a kind, ``settling_time``; None where there is none."""
    return next((n for n, m in study.about["metrics"].items() if m["metric"] == kind), None)


def peak_of_u(study: Study, run: RunRecord, peaks: Mapping[str, float]) -> float | None:
    """The peak of \\|u\\|: the metric, or of the recorded trajectory."""
    for name, about in study.about["metrics"].items():
        if _is_peak_of_u(about):
            return run.metrics.get(name)
    return peaks.get(run.run_id)


def _unit_of_u(study: Study) -> str:
    """The unit of the metric that is the peak of \\|u\\|; empty where there is none."""
    found = (m for m in study.about["metrics"].values() if _is_peak_of_u(m))
    return plain_unit(next(found, {"unit": ""})["unit"])


def _is_peak_of_u(about: Mapping[str, Any]) -> bool:
    return bool(about["metric"] == "peak" and about["of"].rpartition(".")[2] == "u")


def violates(study: Study, run: RunRecord) -> bool:
    """Whether V' of a run exceeded what its certificate allows by more than rounding."""
    margin = _margin(study, run)
    return margin is not None and margin > ROUNDING


def _margin(study: Study, run: RunRecord) -> float | None:
    name = metric_of_kind(study, "lyapunov")
    return run.worst_margin if run.worst_margin is not None or not name else run.metrics.get(name)


def multiple(ratio: float) -> str:
    """A ratio for people: three digits; a price needs no more."""
    return number(float(f"{ratio:.3g}"))


def listed(texts: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} and {texts[-1]}"
