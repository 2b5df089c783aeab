"""Result directories beside each other: what a change of a scenario, an FMU or the code did."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from statistics import median
from typing import Any

from congelation.errors import InvalidInput, counted
from congelation.places import replace_whole
from congelation.report.axes import axes_of
from congelation.report.page_shell import Drawn, lines_of, opening, page, table
from congelation.report.run_page import draw_overlaid, trajectory_of
from congelation.report.summary import label_of, metric_value, number, short
from congelation.report.verdict import listed, settled, settling_rule
from congelation.results.record import RunRecord, Study, Trajectory
from congelation.results.results import Results

__all__ = [
    "BY_VARIANT",
    "FEW",
    "Comparison",
    "Pair",
    "changes_by_run",
    "changes_by_variant",
    "compare",
    "folder_names",
    "relative_change",
    "verdict",
    "write_comparison",
]

LISTED = 100
"""Pairs of a study in the page's table: those that changed most. The counts are of all."""

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


def write_comparison(directories: Sequence[Results], file: Path) -> tuple[Comparison, ...]:
    """Write the page that sets the newest studies of directories beside each other.

    Parameters
    ----------
    directories : sequence of Results
        Two or more; each is compared with the first.
    file : Path

    Returns
    -------
    tuple of Comparison
        One for each directory but the first.

    Raises
    ------
    InvalidInput
        If a directory holds no results, is given twice, or shares no run with the first.
    CongelationError
        If the file cannot be written.
    """
    names = folder_names([results.folder for results in directories])
    studies = [results.study() for results in directories]
    found = tuple(
        compare((names[0], name), (studies[0], study))
        for name, study in zip(names[1:], studies[1:], strict=True)
    )
    for comparison in found:
        if not comparison.pairs:
            first, name = comparison.names
            sizes = [counted(len(study.records), "run") for study in comparison.studies]
            raise InvalidInput(
                f"{first} ({sizes[0]}) and {name} ({sizes[1]}) have no run in common, of the same "
                "variant and settings; give directories of the same study"
            )
    title = f"Comparison of {listed(names)}"
    sentences = [sentence for comparison in found for sentence in verdict(comparison)]
    pieces: list[str | Drawn] = [*opening(title, sentences)]
    for comparison in found:
        pieces += _section(comparison)
    variants: list[str] = []
    scales: dict[str, dict[str, Any]] = {}
    if any(axes_of(study) for study in studies):
        pieces.append(
            '<p class="note">Trajectories are drawn where every variant has one run in each '
            "directory.</p>"
        )
    else:
        plots, variants, scales = _overlaid(directories, names, studies)
        pieces += plots
    for comparison in found:
        pieces += _inputs(comparison)
    pieces.append("</main>")
    text = page(title, pieces, {"variants": variants, "scales": scales})
    replace_whole(file, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return found


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
        told = [f"{was} before, {now} now"] if was != now else []
        told += [f"({percent(relative_change(a, b))})"] if math.isfinite(size) else []
        yield (
            f"{len(changes)} of {count * len(comparison.metrics)} metrics differ, most of all "
            f"{name} of {pair.label}: {' '.join(told)}."
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


def _section(comparison: Comparison) -> Iterator[str]:
    """Tables of a pair of directories, and what went into them."""
    before, after = comparison.names
    yield f"<h2>{escape(after)} against {escape(before)}</h2>"
    if len(comparison.pairs) <= FEW:
        columns = [before, after, "difference", "change"]
        yield from table(columns, changes_by_run(comparison), "Metrics side by side")
    else:
        yield from table(BY_VARIANT, changes_by_variant(comparison), "Changes by variant")
        yield from _most_changed(comparison)
    if comparison.alone:
        yield "<details open><summary>Runs that could not be compared</summary>"
        yield (
            '<p class="note">Runs are matched by variant, replicate, and the settings that vary '
            f"in both directories. {len(comparison.alone)} have no counterpart, or several"
            f"{f'; the first {LISTED} are listed' if len(comparison.alone) > LISTED else ''}.</p>"
        )
        lines = [(label, [name]) for label, name in comparison.alone[:LISTED]]
        yield from table(["only in"], lines, "Runs without a counterpart")
        yield "</details>"
    if rule := settling_rule(comparison.studies[1]):
        yield f'<p class="note">{escape(rule)}</p>'
    if comparison.own:
        said = [f"{metric} ({name})" for metric, name in comparison.own]
        yield (
            '<p class="note">Metrics that only one directory has, or that the two define '
            f"otherwise, are left out: {escape(listed(said))}.</p>"
        )


def _most_changed(comparison: Comparison) -> Iterator[str]:
    """The pairs of a study whose metrics changed most."""

    def sizes(pair: Pair) -> list[float]:
        return [
            abs(relative_change(pair.before.metrics.get(n), pair.after.metrics.get(n)))
            for n in comparison.metrics
        ]

    def order(pair: Pair) -> tuple[bool, float]:
        return pair.before.status != pair.after.status, max(sizes(pair), default=0.0)

    changed = [pair for pair in comparison.pairs if order(pair) != (False, 0.0)]
    if not changed:
        return
    changed.sort(key=order, reverse=True)
    lines = []
    for pair in changed[:LISTED]:
        ends = dict.fromkeys((pair.before.status, pair.after.status))
        cells = [" → ".join(ends)]
        for name, about in comparison.metrics.items():
            a, b = pair.before.metrics.get(name), pair.after.metrics.get(name)
            change = relative_change(a, b)
            was, now = metric_value(a, about), metric_value(b, about)
            said = f" ({percent(change)})" if math.isfinite(change) else ""
            cells.append(f"{was} → {now}{said}" if change else was)
        lines.append((pair.label, cells))
    heads = ["status", *(label_of(n, about) for n, about in comparison.metrics.items())]
    yield (
        f'<p class="note">{len(changed)} of {len(comparison.pairs)} pairs changed'
        f"{f'; the {LISTED} that changed most are listed' if len(changed) > LISTED else ''}.</p>"
    )
    yield from table(heads, lines, "Pairs that changed, before → now")


def _inputs(comparison: Comparison) -> Iterator[str]:
    """What differs in versions, FMUs and the text of the scenario."""
    first, second = (study.about for study in comparison.studies)
    named = [
        {**about["versions"], **{k: f"{v['file']}, {v['sha256'][:16]}" for k, v in fmus.items()}}
        for about, fmus in ((first, first["fmus"]), (second, second["fmus"]))
    ]
    lines = [
        (name, [one, two])
        for name in dict.fromkeys([*named[0], *named[1]])
        if (one := named[0].get(name, "–")) != (two := named[1].get(name, "–"))
    ]
    yield f"<h2>What went into {escape(comparison.names[1])} and {escape(comparison.names[0])}</h2>"
    if lines:
        yield from table(comparison.names, lines, "Versions and FMUs that differ")
    else:
        yield "<p>The versions of the software and the FMUs are the same.</p>"
    change = [
        *difflib.unified_diff(
            first["scenario"].splitlines(),
            second["scenario"].splitlines(),
            f"{comparison.names[0]}: {first['scenario_file']}",
            f"{comparison.names[1]}: {second['scenario_file']}",
            lineterm="",
        )
    ]
    if change:
        yield "<h3>Changes of the scenario</h3>"
        yield lines_of("\n".join(change))
    else:
        yield "<p>The text of the scenario is the same.</p>"


def _overlaid(
    directories: Sequence[Results], names: Sequence[str], studies: Sequence[Study]
) -> tuple[list[str | Drawn], list[str], dict[str, dict[str, Any]]]:
    """The trajectories of all directories in the same plots, and the names of their curves."""
    found: list[tuple[str, Trajectory]] = []
    variants = dict.fromkeys(run.variant for study in studies for run in study.records)
    for variant in variants:  # so that the curves to compare stand beside each other
        for results, name, study in zip(directories, names, studies, strict=True):
            found += [
                (f"{run.variant}, {name}", trajectory_of(results, study, run))
                for run in study.records
                if run.variant == variant and results.store.trajectory_file(run.run_id).is_file()
            ]
    labels = [label for label, _ in found]
    pieces, scales = draw_overlaid([(k, run) for k, (_, run) in enumerate(found)], labels, studies)
    return pieces, labels, scales
