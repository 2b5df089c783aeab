"""Result directories run by run: what a change of a scenario, an FMU or the code did."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from congelation.errors import InvalidInput
from congelation.report.axes import axes_of
from congelation.report.summary import label_of, metric_value, number, short
from congelation.report.verdict import listed, settled
from congelation.results.record import RunRecord, Study

__all__ = [
    "BY_VARIANT",
    "FEW",
    "Comparison",
    "Pair",
    "changes_by_run",
    "changes_by_variant",
    "compare",
    "folder_names",
    "percent",
    "relative_change",
    "verdict",
]

FEW = 12
"""Pairs up to which every metric of every pair has a line of its own."""


@dataclass(frozen=True)
class Pair:
    """A run in two directories; `label` names it by its variant and settings."""

    label: str
    before: RunRecord
    after: RunRecord


@dataclass(frozen=True)
class Comparison:
    """Two studies, run by run.

    Parameters
    ----------
    names : tuple of str
        Of the directories.
    studies : tuple of Study
    pairs : tuple of Pair
        Runs of the same variant, replicate and settings, in the order of the first study.
    alone : tuple of (str, str)
        Label of each run without a counterpart, and the directory that it is in.
    metrics : mapping
        Definitions of the metrics that both studies have.
    own : tuple of (str, str)
        Each metric that only one of them has, or defines otherwise, and the directory.
    """

    names: tuple[str, str]
    studies: tuple[Study, Study]
    pairs: tuple[Pair, ...]
    alone: tuple[tuple[str, str], ...]
    metrics: Mapping[str, Mapping[str, Any]]
    own: tuple[tuple[str, str], ...]


def folder_names(folders: Sequence[Path]) -> tuple[str, ...]:
    """What to call directories: their own names, or, where two are equal, their whole paths.

    Raises
    ------
    InvalidInput
        If one is given twice.
    """
    places = [folder.resolve() for folder in folders]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise InvalidInput(f"{folders[k]} is given twice; give the folders to compare")
    short = tuple(place.name for place in places)
    return short if len(set(short)) == len(short) else tuple(str(folder) for folder in folders)


def compare(names: tuple[str, str], studies: tuple[Study, Study]) -> Comparison:
    """Match the runs of two studies.

    Runs belong together whose variant and replicate are equal, and the settings that vary within a
    variant in both studies. A setting that only the variants differ in may have been changed by
    what is to be judged. Where several runs of one study are equal in all that, none is matched.
    """
    first, second = studies
    shared = [n for n in axes_of(first) if n in second.about["varied"]]
    shared += [n for n in axes_of(second) if n in first.about["varied"] and n not in shared]

    def groups(study: Study) -> dict[tuple[object, ...], list[RunRecord]]:
        found: dict[tuple[object, ...], list[RunRecord]] = {}
        for run in study.records:
            key = (run.variant, run.replicate, *(run.settings.get(name) for name in shared))
            found.setdefault(key, []).append(run)
        return found

    def label(run: RunRecord) -> str:
        parts = [run.variant] + ([f"replicate {run.replicate}"] if run.replicate else [])
        return ", ".join(parts + [f"{n} = {number(run.settings.get(n))}" for n in shared])

    before, after = groups(first), groups(second)
    pairs = tuple(
        Pair(label(runs[0]), runs[0], after[key][0])
        for key, runs in before.items()
        if len(runs) == 1 and len(after.get(key, ())) == 1
    )
    matched = {id(run) for pair in pairs for run in (pair.before, pair.after)}
    alone = tuple(
        (label(run), name)
        for name, study in zip(names, studies, strict=True)
        for run in study.records
        if id(run) not in matched
    )
    own_metrics = [study.about["metrics"] for study in studies]
    metrics = {n: m for n, m in own_metrics[0].items() if own_metrics[1].get(n) == m}
    own = tuple(
        (metric, name)
        for name, found in zip(names, own_metrics, strict=True)
        for metric in found
        if metric not in metrics
    )
    return Comparison(names, studies, pairs, alone, metrics, own)


def relative_change(before: float | None, after: float | None) -> float:
    """The change of a number relative to its value before.

    0 where the two are equal, both missing or both infinite included; inf where one of them is
    missing or infinite, or 0 became something else.
    """
    known = [v if v is not None and not math.isnan(v) else None for v in (before, after)]
    a, b = known
    if a == b:
        return 0.0
    if a is None or b is None or not math.isfinite(a) or not math.isfinite(b) or a == 0.0:
        return math.inf
    return (b - a) / abs(a)


def verdict(comparison: Comparison) -> Iterator[str]:
    """Sentences on what changed: runs without a counterpart, ends, settling, the largest change."""
    before, after = comparison.names
    pairs, count = comparison.pairs, len(comparison.pairs)
    runs = f"{count} run{'s' if count != 1 else ''}"
    if not comparison.alone:
        each = f"each of the {runs} has" if count != 1 else "the run has"
        yield f"{after} against {before}: {each} a counterpart."
    else:
        yield (
            f"{after} against {before}: {runs} can be compared; {len(comparison.alone)} have no "
            "counterpart, or more than one."
        )
    options = [study.about.get("given", {}) for study in comparison.studies]
    for name in dict.fromkeys([*options[0], *options[1]]):
        if options[0].get(name) != options[1].get(name):
            was, now = (
                number(own[name]) if name in own else "that of the scenario" for own in options
            )
            yield f"An option of the command changed {name}: {was} before, {now} now."
    other = [pair for pair in pairs if pair.before.status != pair.after.status]
    if 0 < len(other) <= 3:
        ends = [f"{p.label} was {p.before.status} and is {p.after.status}" for p in other]
        yield f"The status changed: {listed(ends)}."
    elif other:
        yield f"The status of {len(other)} of them changed."
    if any(metric["metric"] == "settling_time" for metric in comparison.metrics.values()):
        for variant in dict.fromkeys(pair.before.variant for pair in pairs):
            own = [pair for pair in pairs if pair.before.variant == variant]
            counts = [
                sum(settled(study, getattr(pair, side)) for pair in own)
                for study, side in zip(comparison.studies, ("before", "after"), strict=True)
            ]
            if counts[0] != counts[1]:
                yield (
                    f"{variant} settled in {counts[0]} of {len(own)} runs before, and settles in "
                    f"{counts[1]} now."
                )
    changes = [
        (abs(change), name, pair)
        for pair in pairs
        for name in comparison.metrics
        if (change := relative_change(pair.before.metrics.get(name), pair.after.metrics.get(name)))
    ]
    if not comparison.metrics:
        yield "The directories have no metric in common."
    elif not changes:
        yield "All metrics are equal to the last digit."
    else:
        # What became infinite, or finite, or unknown comes before any number.
        size, name, pair = max(changes, key=lambda entry: entry[0])
        a, b = pair.before.metrics.get(name), pair.after.metrics.get(name)
        was, now = (metric_value(v, comparison.metrics[name]) for v in (a, b))
        words = [f"{was} before, {now} now"] if was != now else []
        words += [f"({percent(relative_change(a, b))})"] if math.isfinite(size) else []
        yield (
            f"{len(changes)} of {count * len(comparison.metrics)} metrics differ, most of all "
            f"{name} of {pair.label}: {' '.join(words)}."
        )


def percent(change: float) -> str:
    """A relative change for people."""
    if change == 0.0:
        return "equal"
    if not math.isfinite(change):
        return "–"
    if abs(change) >= 10.0:
        return f"{change:+.2g} times"
    return f"{'+' if change > 0 else ''}{short(100.0 * change, 2)} %"


def changes_by_variant(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    """Of each variant and metric: pairs, how many are equal, medians, the largest change."""
    for variant in dict.fromkeys(pair.before.variant for pair in comparison.pairs):
        own = [pair for pair in comparison.pairs if pair.before.variant == variant]
        for name, about in comparison.metrics.items():
            both = [(pair.before.metrics.get(name), pair.after.metrics.get(name)) for pair in own]
            changes = [relative_change(a, b) for a, b in both]
            finite = [c for c in changes if math.isfinite(c)]
            largest = max(finite, key=abs, default=0.0)
            middles = []
            for values in zip(*both, strict=True):
                known = [v for v in values if v is not None and not math.isnan(v)]
                middles.append(metric_value(median(known) if known else None, about))
            yield (
                f"{variant}: {label_of(name, about)}",
                [
                    str(len(own)),
                    str(changes.count(0.0)),
                    *middles,
                    percent(median(finite)) if finite else "–",
                    percent(largest),
                    str(len(changes) - len(finite)),
                ],
            )


BY_VARIANT = (
    "pairs", "equal", "median before", "median now", "median change", "largest change",
    "without a number",
)  # fmt: skip
"""Headings of `changes_by_variant`; the last counts what is infinite or missing on one side."""


def changes_by_run(comparison: Comparison) -> Iterator[tuple[str, list[str]]]:
    """Of each pair and metric: both values, the difference and the relative change."""
    for pair in comparison.pairs:
        if pair.before.status != pair.after.status:
            yield f"{pair.label}: status", [pair.before.status, pair.after.status, "–", "–"]
        steps = {"metric": "", "unit": ""}
        for name, about in (*comparison.metrics.items(), ("macro steps", steps)):
            a, b = (
                run.steps if about is steps else run.metrics.get(name)
                for run in (pair.before, pair.after)
            )
            known = a is not None and b is not None and math.isfinite(a) and math.isfinite(b)
            difference = "–"
            if known:
                change = b - a  # type: ignore[operator]
                difference = f"{'+' if change > 0 else ''}{short(change, 3)}"
            cells = [*(metric_value(v, about) for v in (a, b)), difference]
            cells.append(percent(relative_change(a, b)))
            yield f"{pair.label}: {label_of(name, about)}", cells
