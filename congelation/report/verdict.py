"""What a run or a study comes to: a sentence or two, and the numbers that it rests on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from congelation.report.summary import number
from congelation.results.record import RunRecord, Study

__all__ = ["FEW", "axes_of", "listed", "prices", "run_verdict", "settled", "study_verdict", "tiles"]


FEW = 12
"""Values of an axis up to which runs are counted at each of them; a random axis has more."""


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
    said = []
    for run in study.records:
        if run.failed:
            said.append(f"{run.variant} failed ({run.status})")
        elif run.status != "COMPLETED":
            said.append(f"{run.variant} was ended by an FMU before its stop time")
        elif not name:
            said.append(f"{run.variant} reached its stop time")
        elif settled(study, run):
            said.append(f"{run.variant} settles after {number(run.metrics[name])} s")
        else:
            said.append(f"{run.variant} does not settle")
    yield f"{listed(said)}." if said else "No run has finished yet."
    priced = prices(study, study.records, peaks)
    dear = {v: p for v, p in priced.items() if p > 1.0}
    if dear:
        cheapest = min(priced, key=lambda v: priced[v])
        costs = [f"{variant} pays {number(_round(ratio))} times" for variant, ratio in dear.items()]
        yield f"{listed(costs)} the peak of |u| of {cheapest}."
    margins = [run for run in study.records if (_margin(study, run) or -1.0) > 0.0]
    if margins:
        yield f"The Lyapunov certificate is violated for {listed([r.variant for r in margins])}."


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

    Settings that always change together, as those of one axis of a sweep do, count once.
    """
    kinds: dict[tuple[int, ...], str] = {}
    axes: dict[str, list[Any]] = {}
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    for name in study.about["varied"]:
        column = [run.settings.get(name) for run in study.records]
        if all(len({repr(r.settings.get(name)) for r in runs}) < 2 for runs in variants.values()):
            continue
        seen: dict[Any, int] = {}
        kind = tuple(seen.setdefault(repr(value), len(seen)) for value in column)
        if kinds.setdefault(kind, name) == name:
            values = {repr(value): value for value in column if value is not None}.values()
            axes[name] = sorted(values, key=lambda v: (isinstance(v, str), v))
    return axes


def study_verdict(study: Study) -> Iterator[str]:
    """Sentences on a sweep: how many runs settle, up to where on each axis, and at what price."""
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    done = "settles" if _named(study, "settling_time") else "reaches its stop time"
    axes = {
        name: values
        for name, values in axes_of(study).items()
        if 1 < len(values) <= FEW and all(isinstance(v, int | float) for v in values)
    }
    for variant, runs in variants.items():
        good = [run for run in runs if settled(study, run)]
        if len(good) == len(runs):
            yield f"{variant} {done} in all {len(runs)} runs."
            continue
        if not good:
            yield f"{variant} {done} in none of {len(runs)} runs."
            continue
        limits = []
        for name, values in axes.items():
            own = {run.settings.get(name) for run in runs}  # an axis may be of other variants
            met = [value for value in values if value in own]
            if len(met) > 1 and (limit := _limit(study, runs, name, met)):
                limits.append(limit)
        said = f": {listed(limits)}" if limits else ""
        yield f"{variant} {done} in {len(good)} of {len(runs)} runs{said}."
    yield from _price_of_study(study, variants)


def _limit(study: Study, runs: Sequence[RunRecord], name: str, values: Sequence[Any]) -> str:
    """From which end of an axis on all runs of a variant settle, or none."""
    share = []
    for value in values:
        there = [settled(study, run) for run in runs if run.settings.get(name) == value]
        share.append(sum(there) / len(there) if there else 0.0)
    short = name.rpartition(".")[2]
    whole, none = [part == 1.0 for part in share], [part == 0.0 for part in share]
    said = []
    for word, held in (("all", whole), ("none", none)):
        if held[0]:
            said.append(f"in {word} up to {short} = {number(values[held.index(False) - 1])}")
        elif held[-1]:
            last = len(held) - held[::-1].index(False)
            said.append(f"in {word} from {short} = {number(values[last])} on")
    return " and ".join(said)


def _price_of_study(study: Study, variants: Mapping[str, Sequence[RunRecord]]) -> Iterator[str]:
    """What the first variant pays at equal settings, relative to each other one."""
    first, *others = variants
    axes = axes_of(study)
    own = {
        variant: {n for n in axes if len({repr(run.settings.get(n)) for run in runs}) > 1}
        for variant, runs in variants.items()
    }
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
            yield (
                f"{first} pays with a peak of |u| that is {middle} times that of {other} "
                f"(median at equal settings; {low} to {high})."
            )


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
