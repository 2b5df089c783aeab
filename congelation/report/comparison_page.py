"""The page that sets result directories beside each other."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

from congelation.errors import InvalidInput, counted
from congelation.places import write_whole
from congelation.report.axes import axes_of
from congelation.report.comparison import (
    BY_VARIANT,
    FEW,
    Comparison,
    Pair,
    changes_by_run,
    changes_by_variant,
    compare,
    folder_names,
    percent,
    relative_change,
    verdict,
)
from congelation.report.page_shell import Drawn, lines_of, opening, page, table
from congelation.report.run_page import draw_overlaid, trajectory_of
from congelation.report.summary import label_of, metric_value, number
from congelation.report.verdict import listed, settling_rule
from congelation.results.record import Study, Trajectory
from congelation.results.results import Results

__all__ = ["write_comparison"]

LISTED = 100
"""Pairs of a study in the page's table: those that changed most. The counts are of all."""


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
    write_whole(file, text)
    return found


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
    """What differs in versions, FMUs, options of the command and the text of the scenario."""
    first, second = (study.about for study in comparison.studies)
    named = [
        {
            **about["versions"],
            **{k: f"{v['file']}, {v['sha256'][:16]}" for k, v in about["fmus"].items()},
            **{k: f"{number(v)} by an option" for k, v in about.get("given", {}).items()},
        }
        for about in (first, second)
    ]
    lines = [
        (name, [one, two])
        for name in dict.fromkeys([*named[0], *named[1]])
        if (one := named[0].get(name, "–")) != (two := named[1].get(name, "–"))
    ]
    yield f"<h2>What went into {escape(comparison.names[1])} and {escape(comparison.names[0])}</h2>"
    if lines:
        yield from table(comparison.names, lines, "Versions, FMUs and options that differ")
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
