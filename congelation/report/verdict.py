"""What a run or a study comes to: a sentence or two, and the numbers that it rests on."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from congelation.report.summary import number
from congelation.results.labels import plain_unit
from congelation.results.record import RunRecord, Study

__all__ = [
    "FEW",
    "axes_of",
    "listed",
    "prices",
    "run_verdict",
    "settled",
    "settling_rule",
    "short_names",
    "study_verdict",
    "tiles",
    "unit_of",
]

FEW = 12
"""Values of an axis up to which runs are counted at each of them; a random axis has more."""

LISTED = 4
"""Variants up to which a sentence on a run names each of them; their tiles have the numbers."""

_TREND = 1.5
"""Of settling times the largest and the least, from which on their course is worth telling."""

_TERM = re.compile(r"(?<!profile)\[\d+\](?=\.\w+$)")
"""The number of a term of a profile: ``sine[1].omega``."""

_DEAR = 1.05
"""A peak of |u| that is larger than the least by less than 5 % is no price."""


def settled(study: Study, run: RunRecord) -> bool:
    """Whether a run reached its stop time and, where that was measured, x settled."""
    name = _named(study, "settling_time")
    if run.status != "COMPLETED":
        return False
    value = run.metrics.get(name) if name else 0.0
    return value is not None and math.isfinite(value)


def run_verdict(study: Study, peaks: Mapping[str, float]) -> Iterator[str]:
    """Sentences on the variants of a scenario, the first on whether they settle."""
    name = _named(study, "settling_time")
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
    margins = [run for run in study.records if (_margin(study, run) or -1.0) > 0.0]
    if margins:
        yield f"The Lyapunov certificate is violated for {listed([r.variant for r in margins])}."


def _price(priced: Mapping[str, float]) -> Iterator[str]:
    """What the variants pay whose peak of |u| is clearly above the least."""
    dear = sorted(((p, v) for v, p in priced.items() if p >= _DEAR), reverse=True)
    if not dear:
        if priced:
            yield "Their peaks of |u| differ by less than 5 %."
        return
    cheapest = min(priced, key=lambda v: priced[v])
    if len(dear) > LISTED:
        (most, first), (least, last) = dear[0], dear[-1]
        yield (
            f"{len(dear)} variants pay with a larger peak of |u| than {cheapest}: from "
            f"{number(_round(least))} times ({last}) to {number(_round(most))} times ({first})."
        )
        return
    (most, first), *rest = dear
    others = [
        f"{variant} with one that is {number(_round(ratio))} times" for ratio, variant in rest
    ]
    peak = f"{first} pays with a peak of |u| that is {number(_round(most))} times"
    yield f"{listed([peak, *others])} that of {cheapest}."


def tiles(study: Study, peaks: Mapping[str, float]) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The variant of each run, and names with values; `peaks` has the peak of \\|u\\| by run_id."""
    name = _named(study, "settling_time")
    priced = prices(study, study.records, peaks)
    for run in study.records:
        lines = [("status", run.status.lower().replace("_", " "))]
        if name:
            value = run.metrics.get(name)
            said = "no" if value == math.inf else f"after {number(value)} s"
            lines.append(("settled", said if value is not None else "–"))
        peak = _peak_u(study, run, peaks)
        if peak is not None:
            lines.append(("peak |u|", number(peak)))
        if run.variant in priced:
            lines.append(("price: peak |u| / least", f"{number(_round(priced[run.variant]))} ×"))
        margin = _margin(study, run)
        if margin is not None:
            lines.append(("worst margin", number(margin)))
        error = run.trust_error if run.trust_error is not None else run.estimated_error
        if error is not None:
            lines.append(("estimated error", f"{error:.1e}"))
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
        peak = _peak_u(study, run, peaks or {})
        if peak is not None and 0.0 < peak < math.inf:
            found[run.variant] = peak
    if len(found) < 2:
        return {}
    least = min(found.values())
    return {variant: peak / least for variant, peak in found.items()}


def axes_of(study: Study) -> dict[str, list[Any]]:
    """The settings that vary within a variant, with their values in order.

    Of the settings that an axis of a sweep changes together, one that follows from another is
    left out.
    """
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    columns = {
        name: [repr(run.settings.get(name)) for run in study.records]
        for name in study.about["varied"]
        if any(len({repr(r.settings.get(name)) for r in runs}) > 1 for runs in variants.values())
    }
    # A directory of an earlier version does not say which settings make an axis.
    groups = study.about.get("axes") or [list(columns)]
    axes: dict[str, list[Any]] = {}
    for group in groups:
        kept: list[str] = []
        for name in group:
            if name in columns and name not in axes:
                own = columns[name]
                known = (columns[other] for other in kept)
                if not any(len({*zip(c, own, strict=True)}) == len({*c}) for c in known):
                    kept.append(name)
        for name in kept:
            found = {
                repr(v): v for run in study.records if (v := run.settings.get(name)) is not None
            }
            axes[name] = sorted(found.values(), key=lambda v: (isinstance(v, str), v))
    return axes


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Settings by the shortest end that tells them apart.

    ``plant.profile[1].sine[1].omega`` is omega; beside ``..square[1].omega`` it is sine.omega, the
    number of the term left out as in a scenario where that is enough.
    """

    def ends(name: str) -> list[str]:
        parts = name.split(".")
        return [".".join(parts[k:]) for k in range(len(parts) - 1, -1, -1)]

    counts = Counter(end for name in {*names} for end in ends(name))
    found = {name: next((e for e in ends(name) if counts[e] == 1), name) for name in names}
    plain = {name: _TERM.sub("", end) for name, end in found.items()}
    times = Counter(plain.values())
    return {name: plain[name] if times[plain[name]] == 1 else end for name, end in found.items()}


def unit_of(study: Study, setting: str) -> str:
    """The unit of a setting, with a space before it; empty where there is none."""
    unit = plain_unit(study.about.get("units", {}).get(setting, ""))
    return f" {unit}" if unit else ""


def study_verdict(study: Study) -> Iterator[str]:
    """Sentences on a sweep: how many runs settle, up to where on each axis, and at what price."""
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    timed = bool(_named(study, "settling_time"))
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


def _times(
    study: Study,
    runs: Sequence[RunRecord],
    axes: Mapping[str, Sequence[Any]],
    short: Mapping[str, str],
) -> str:
    """After what time runs settle that all do; empty where that was not measured.

    Where the time follows the only axis, growing or falling, both of its ends are told.
    """
    name = _named(study, "settling_time")
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
    return f", after {middle} s" + (f" (median; {low} to {high} s)" if low != high else "")


def _extremes(study: Study, variants: Mapping[str, Sequence[RunRecord]]) -> Iterator[str]:
    """Of many variants the ones that settle first and last, by their median times."""
    name = _named(study, "settling_time")
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


def settling_rule(study: Study) -> str:
    """What it means here that a run settles; empty where that was not measured."""
    name = _named(study, "settling_time")
    if not name:
        return ""
    about = study.about["metrics"][name]
    below = about.get("options", {}).get("below")
    limit = f"below {below:g}" if below is not None else "small"
    return f"A run settles when |{about['of']}| stays {limit} until the stop time."


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
            mine = _peak_u(study, run, {})
            if mine and math.isfinite(mine):
                costs.setdefault(point(run), []).append(mine)
        ratios = []
        for run in variants[other]:
            its = _peak_u(study, run, {})
            if its and math.isfinite(its):
                ratios += [mine / its for mine in costs.get(point(run), [])]
        if ratios:
            low, middle, high = (
                number(_round(r)) for r in (min(ratios), median(ratios), max(ratios))
            )
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
        pays = "pays with" if float(most) >= _DEAR else "needs only"
        yield (
            f"{first} {pays} a peak of |u| from {least} times that of {last} to {most} times "
            f"that of {top} (medians at equal settings)."
        )
        return
    # What is dear, what is cheap, and what costs the same, in a sentence each.
    said: dict[str, list[str]] = {}
    for (middle, low, high), compared in found.items():
        ratio = float(middle)
        kind = "pays with" if ratio >= _DEAR else "needs only" if ratio <= 1.0 / _DEAR else ""
        between = "" if low == middle == high else f" (median at equal settings; {low} to {high})"
        times = f"{middle} times that of {listed(compared)}{between}"
        said.setdefault(kind, []).append(times if kind else f"{listed(compared)}{between}")
    for kind, parts in said.items():
        if kind:
            yield f"{first} {kind} a peak of |u| that is {listed(parts)}."
        else:
            yield f"The peak of |u| of {first} is within 5 % of that of {listed(parts)}."


def _named(study: Study, kind: str) -> str | None:
    return next((n for n, m in study.about["metrics"].items() if m["metric"] == kind), None)


def _peak_u(study: Study, run: RunRecord, peaks: Mapping[str, float]) -> float | None:
    """The peak of \\|u\\|: the metric, or of the recorded trajectory."""
    for name, about in study.about["metrics"].items():
        if about["metric"] == "peak" and about["of"].rpartition(".")[2] == "u":
            return run.metrics.get(name)
    return peaks.get(run.run_id)


def _margin(study: Study, run: RunRecord) -> float | None:
    name = _named(study, "lyapunov")
    return run.worst_margin if run.worst_margin is not None or not name else run.metrics.get(name)


def _round(ratio: float) -> float:
    """Three digits: a price needs no more."""
    return float(f"{ratio:.3g}")


def listed(texts: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} and {texts[-1]}"
