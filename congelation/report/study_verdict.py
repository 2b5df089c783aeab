"""What a sweep comes to: how many runs settle, after what time, up to where, and at what price."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from congelation.report.axes import FEW, axes_of, short_names, unit_of
from congelation.report.summary import number
from congelation.report.verdict import (
    DEAR,
    LISTED,
    WORST_THETA,
    listed,
    metric_of_kind,
    multiple,
    peak_of_u,
    settled,
    violates,
)
from congelation.results.record import RunRecord, Study

__all__ = ["study_verdict"]

_TREND = 1.5
"""Of settling times the largest and the least, from which on their course is worth telling."""

_FAR = 3.0
"""The same ratio, from which on the settings of the two are named."""


def study_verdict(study: Study) -> Iterator[str]:
    """Sentences on a sweep: how many runs settle, up to where on each axis, and at what price."""
    done, planned = len(study.records), study.about.get("planned", 0)
    if done < planned:
        yield (
            f"{done} of {planned} runs are done, and what follows is of these alone; "
            "sweep --resume does the others."
        )
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    timed = bool(metric_of_kind(study, "settling_time"))
    one, several = ("settles", "settle") if timed else ("reaches its", "reach their")
    end = "" if timed else " stop time"
    axes = {
        name: values
        for name, values in axes_of(study).items()
        if 1 < len(values) <= FEW and all(isinstance(v, int | float) for v in values)
    }
    short = short_names(axes_of(study))
    # Variants of which the same is to be said stand in one sentence.
    same: dict[str, list[str]] = {}
    for variant, runs in variants.items():
        good = [run for run in runs if settled(study, run)]
        if len(good) in (0, len(runs)):
            count = f"all {len(runs)} runs" if len(runs) > 1 else "its only run"
            said = count if good else f"none of {len(runs)} runs"
            if good and len(variants) <= LISTED:
                said += _times(study, runs, axes, short)
        else:
            limits = []
            for name, values in axes.items():
                own = {run.settings.get(name) for run in runs}  # an axis may be of other variants
                met = [value for value in values if value in own]
                limit = _limit(study, runs, name, met, short[name]) if len(met) > 1 else ""
                limits += [limit] if limit else []
            said = f"{len(good)} of {len(runs)} runs"
            said += f": {listed(limits)}" if limits else ""
        same.setdefault(said, []).append(variant)
    for said, names in same.items():
        each = said.replace("its only run", "their only runs") if len(names) > 1 else said
        yield f"{listed(names)} {one if len(names) == 1 else several}{end} in {each}."
    if len(variants) > LISTED:
        yield from _extremes(study, variants)
    yield from _price_of_study(study, variants)
    broken = {
        variant: f"{found} of {len(runs)} runs of {variant}"
        for variant, runs in variants.items()
        if (found := sum(violates(study, run) for run in runs))
    }
    if broken:
        counts = listed([*broken.values()])
        yield f"The Lyapunov certificate is violated in {counts}, {WORST_THETA}."


def _times(
    study: Study,
    runs: Sequence[RunRecord],
    axes: Mapping[str, Sequence[Any]],
    short: Mapping[str, str],
) -> str:
    """After what time runs settle that all do; empty where that was not measured.

    Where the time follows the only axis, growing or falling, both of its ends are given; else,
    where the extremes are far apart, at which settings they are.
    """
    name = metric_of_kind(study, "settling_time")
    if not name:
        return ""
    times = sorted(run.metrics[name] or 0.0 for run in runs)
    low, middle, high = (number(v) for v in (times[0], median(times), times[-1]))
    if len(axes) == 1 and times[-1] >= _TREND * times[0]:
        ((axis, values),) = axes.items()
        medians = [
            median(there)
            for value in values
            if (there := [r.metrics[name] or 0.0 for r in runs if r.settings.get(axis) == value])
        ]
        steps = [b - a for a, b in pairwise(medians)]
        # A step back by 1 % of the range is no change of direction.
        slack = 0.01 * (max(medians) - min(medians))
        if len(medians) == len(values) and (min(steps) > -slack or max(steps) < slack):
            unit = unit_of(study, axis)
            return (
                f", after {number(medians[0])} s at {short[axis]} = {number(values[0])}{unit} and "
                f"after {number(medians[-1])} s at {number(values[-1])}{unit}"
            )
    if low == high:
        return f", after {middle} s"
    ends = [f"{low}", f"{high} s"]
    if axes and times[-1] >= _FAR * times[0]:
        for k, extreme in enumerate((min, max)):
            run = extreme(runs, key=lambda r: r.metrics[name] or 0.0)
            where = [
                f"{short[axis]} = {number(run.settings[axis])}{unit_of(study, axis)}"
                for axis in axes
                if run.settings.get(axis) is not None
            ]
            ends[k] = f"{(low, high)[k]} s at {listed(where)}" if where else ends[k]
    return f", after {middle} s (median; {' to '.join(ends)})"


def _extremes(study: Study, variants: Mapping[str, Sequence[RunRecord]]) -> Iterator[str]:
    """Of many variants the ones that settle first and last, by their median times."""
    name = metric_of_kind(study, "settling_time")
    if not name:
        return
    medians = {}
    for variant, runs in variants.items():
        times = [run.metrics[name] if settled(study, run) else math.inf for run in runs]
        if math.isfinite(middle := median(t if t is not None else math.inf for t in times)):
            medians[variant] = middle
    if len(medians) > 1:
        first, last = (extreme(medians, key=lambda v: medians[v]) for extreme in (min, max))
        yield (
            f"The median settling time is least for {first} ({number(medians[first])} s) and "
            f"largest for {last} ({number(medians[last])} s)."
        )


def _limit(
    study: Study, runs: Sequence[RunRecord], name: str, values: Sequence[Any], short: str
) -> str:
    """From which end of an axis on all runs of a variant settle, or none."""
    share = []
    for value in values:
        there = [settled(study, run) for run in runs if run.settings.get(name) == value]
        share.append(sum(there) / len(there) if there else 0.0)
    unit = unit_of(study, name)
    whole, none = [part == 1.0 for part in share], [part == 0.0 for part in share]
    said = []
    for word, held in (("all", whole), ("none", none)):
        if held[0]:
            last = held.index(False) - 1
            where = f"up to {short}" if last else f"at {short}"
        elif held[-1]:
            last = len(held) - held[::-1].index(False)
            where = f"from {short}" if last < len(held) - 1 else f"at {short}"
        else:
            continue
        on = " on" if where.startswith("from") else ""
        said.append(f"in {word} {where} = {number(values[last])}{unit}{on}")
        other = -1 if held[0] else 0  # at the other end not all may settle either
        if word == "none" and 0.0 < share[other] < 1.0:
            there = [settled(study, r) for r in runs if r.settings.get(name) == values[other]]
            said.append(f"in {sum(there)} of {len(there)} at {number(values[other])}{unit}")
    return " and ".join(said)


def _price_of_study(study: Study, variants: Mapping[str, Sequence[RunRecord]]) -> Iterator[str]:
    """What the first variant pays at equal settings, relative to each other one."""
    first, *others = variants
    axes = axes_of(study)
    own = {
        variant: {n for n in axes if len({repr(run.settings.get(n)) for run in runs}) > 1}
        for variant, runs in variants.items()
    }
    found: dict[tuple[str, str, str], list[str]] = {}
    for other in others:
        # An axis that one of the two has not is no setting to be equal in: its one run is
        # compared with all of the other's.
        common = sorted(own[first] & own[other])
        if len(common) < min(len(own[first]), len(own[other])):
            continue

        def point(run: RunRecord, names: Sequence[str] = common) -> tuple[object, ...]:
            return (run.replicate, *(run.settings.get(name) for name in names))

        costs: dict[tuple[object, ...], list[float]] = {}
        for run in variants[first]:
            mine = peak_of_u(study, run, {})
            if mine and math.isfinite(mine):
                costs.setdefault(point(run), []).append(mine)
        ratios = []
        for run in variants[other]:
            its = peak_of_u(study, run, {})
            if its and math.isfinite(its):
                ratios += [mine / its for mine in costs.get(point(run), [])]
        if ratios:
            low, middle, high = (multiple(r) for r in (min(ratios), median(ratios), max(ratios)))
            found.setdefault((middle, low, high), []).append(other)
    if not found:
        return
    if sum(len(compared) for compared in found.values()) > LISTED:
        (least, last), (most, top) = (
            (middle, compared[0])
            for (middle, _, _), compared in (
                extreme(found.items(), key=lambda entry: float(entry[0][0]))
                for extreme in (min, max)
            )
        )
        pays = "pays with" if float(most) >= DEAR else "needs only"
        yield (
            f"{first} {pays} a peak of |u| from {least} times that of {last} to {most} times "
            f"that of {top} (medians at equal settings)."
        )
        return
    # What is dear, what is cheap, and what costs the same, in a sentence each.
    said: dict[str, list[str]] = {}
    for (middle, low, high), compared in found.items():
        ratio = float(middle)
        kind = "pays with" if ratio >= DEAR else "needs only" if ratio <= 1.0 / DEAR else ""
        between = "" if low == middle == high else f" (median at equal settings; {low} to {high})"
        times = f"{middle} times that of {listed(compared)}{between}"
        said.setdefault(kind, []).append(times if kind else f"{listed(compared)}{between}")
    for kind, parts in said.items():
        if kind:
            yield f"{first} {kind} a peak of |u| that is {listed(parts)}."
        else:
            yield f"The peak of |u| of {first} is within 5 % of that of {listed(parts)}."
