"""The page of a study: metrics against settings, trade-offs, a table of all runs, trajectories."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.errors import counted
from congelation.report.axes import FEW, axes_of, short_names
from congelation.report.curves import PICKED, Curve, Panel, curve_panels
from congelation.report.page_shell import Drawn, table
from congelation.report.panels import draw_panels
from congelation.report.study_plots import (
    axis_labels,
    map_section,
    metric_labels,
    metric_section,
    pareto_section,
    select,
    variant_controls,
)
from congelation.report.summary import NOT_SETTLED, number, summarise
from congelation.report.verdict import settled
from congelation.results.record import RunRecord, Study, Trajectory
from congelation.results.results import Results

__all__ = ["study_content"]

EMBEDDED, BUDGET = 200, 250_000
"""Runs whose trajectories are in the page at most, and points of all their curves: 2.7 MB. A click
on another run names its file."""

POINTS = 1000
"""Of each of these curves."""

LARGEST = 20_000
"""Runs of which the page has a row each; of a larger study it takes every k-th."""


def study_content(
    results: Results, study: Study
) -> tuple[list[str | Drawn], dict[str, Any], dict[str, Any]]:
    """The pieces between verdict and provenance, the scales, and what study.js reads."""
    variants = list(dict.fromkeys(run.variant for run in study.records))
    step = math.ceil(len(study.records) / LARGEST)
    runs = study.records[::step]
    axes, metrics = axes_of(study), list(study.about["metrics"])
    pieces: list[str | Drawn] = [*_counts(study, axes, variants)]
    if step > 1:
        pieces.append(
            f'<p class="note">The plots and the table of runs show {len(runs)} of '
            f"{len(study.records)} runs, every {step}th; the summary is of all.</p>"
        )
    pieces += variant_controls(variants)
    if axes and metrics:
        pieces += metric_section(axes, metrics, variants, study)
    if len(axes) > 1 and metrics:
        pieces += map_section(axes, metrics, variants, study)
    if len(metrics) > 1:
        pieces += pareto_section(metrics, variants, study)
    kept = [run for run in runs if results.store.trajectory_file(run.run_id).is_file()]
    columns = ["variant", *axes, *metrics, "status", "run"]
    pieces += _table_section(columns, study, runs, axes)
    embedded = _embedded(results, kept)
    panels, held = _picked_panels(embedded)
    curves, scales = draw_panels(panels, variants)
    note = "A click on a point or on a row of the table shows what was run and how it ended"
    note += ", and its trajectories. " if kept else ". "
    if not kept:
        note += "No trajectories were kept; trajectories = true under [sweep] keeps them."
    elif len(embedded) == len(kept):
        note += f"The trajectories of {counted(len(kept), 'run')} are in this page."
    else:
        note += (
            f"The trajectories of {len(embedded)} of {counted(len(kept), 'run')} are in this "
            "page; of the others it names the file."
        )
    if any(len(recorded.time) > POINTS for recorded in embedded.values()):
        note += (
            f" {POINTS} points of each curve are drawn: the least and the largest of each of "
            f"{POINTS // 2} stretches."
        )
    pieces += [
        f'<h2>A run</h2><p class="note">{escape(note)}</p><p id="picked" role="status"></p>',
        '<div id="trajectories" hidden>',
        *curves,
        "</div>",
        *_failures(runs),
        "<h2>Summary</h2>",
    ]
    summary = summarise(study)
    pieces += table(summary.columns, summary.lines, "Quantiles over the runs of each variant")
    data = {**_data(study, runs, axes, columns), "trajectories": held, "stored": bool(kept)}
    return pieces, {**scales, **_no_scales()}, data


def _embedded(results: Results, kept: Sequence[RunRecord]) -> dict[str, Trajectory]:
    """Trajectories for the page by run_id: of so many runs as the budget allows, evenly spaced."""
    if not kept:
        return {}
    first = results.store.trajectory(kept[0].run_id)
    size = min(len(first.time), POINTS) * (len(first.columns) + 1)
    count = min(EMBEDDED, max(1, BUDGET // max(1, size)))
    chosen = kept[:: math.ceil(len(kept) / count)]
    return {run.run_id: results.store.trajectory(run.run_id) for run in chosen}


def _picked_panels(
    embedded: Mapping[str, Trajectory],
) -> tuple[list[Panel], dict[str, dict[str, dict[str, Any]]]]:
    """Panels for one run at a time, and by run_id and curve what study.js draws in them.

    A curve is its times and values, single precision numbers in base64, and the numbers of the
    table beside the plot.
    """
    found: dict[str, dict[str, Curve]] = {}
    held: dict[str, dict[str, dict[str, Any]]] = {}
    for run_id, trajectory in embedded.items():
        held[run_id] = {}
        for panel in curve_panels([(PICKED, trajectory)], points=POINTS):
            known = found.setdefault(panel.title, {})
            for curve in panel.curves:
                name = f"{panel.title}: {curve.label}"
                held[run_id][name] = {
                    "time": _base64(curve.time),
                    "value": _base64(curve.value),
                    "numbers": curve.numbers,
                }
                # Time axis and scale are of all runs; the script draws the one that is picked.
                before = known.get(name, curve)
                time = np.concatenate([before.time, curve.time])
                value = np.concatenate([before.value, curve.value])
                known[name] = replace(
                    curve,
                    name=name,
                    time=np.array([time.min(), time.max()]) if len(time) else time,
                    value=np.array([value.min(), value.max()]) if len(time) else value,
                    numbers=(math.nan,) * 4,
                )
    panels = [
        Panel(f"p{k}", title, tuple(curves.values()))
        for k, (title, curves) in enumerate(found.items())
    ]
    return panels, held


def _base64(values: npt.NDArray[np.float64]) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _data(
    study: Study,
    runs: Sequence[RunRecord],
    axes: Mapping[str, Any],
    columns: Sequence[str],
) -> dict[str, Any]:
    from bokeh.palettes import Cividis256  # even in lightness, also for colour-blind readers

    about = study.about["metrics"]
    variants = list(dict.fromkeys(run.variant for run in study.records))
    messages = [run.message if run.status != "COMPLETED" else None for run in runs]
    return {
        "run_id": [run.run_id for run in runs],
        "variant": [variants.index(run.variant) for run in runs],
        "status": [run.status for run in runs],
        "message": messages,
        "columns": {
            **{name: [run.settings.get(name) for run in runs] for name in axes},
            **{name: [_digits(run.metrics.get(name)) for run in runs] for name in about},
        },
        "labels": {**metric_labels(study), **axis_labels(study, axes)},
        "settling": [name for name, of in about.items() if of["metric"] == "settling_time"],
        "not_settled": NOT_SETTLED,
        "axes": list(axes),
        "metrics": list(about),
        "table": list(columns),
        "palette": list(Cividis256),
    }


def _digits(value: float | None) -> float | None:
    """Six digits of a metric: more are in the store, and cost a page of 10,000 runs megabytes."""
    return float(f"{value:.6g}") if value is not None and math.isfinite(value) else value


def _no_scales() -> dict[str, Any]:
    """The scales of the plots before the script has looked at the data."""
    names = (f"{plot}.{axis}" for plot in ("metric", "map", "pareto") for axis in "xy")
    return {name: {"own": True, "mode": "linear"} for name in names}


def _counts(
    study: Study, axes: Mapping[str, Sequence[Any]], variants: Sequence[str]
) -> Iterator[str]:
    """A table for each axis with few values: how many runs settle at each of them, by variant."""
    timed = any(m["metric"] == "settling_time" for m in study.about["metrics"].values())
    done = "settle" if timed else "reach their stop time"
    if all(settled(study, run) for run in study.records):
        return  # the verdict says so
    names = axis_labels(study, axes)
    rows = variants
    if len(variants) > FEW // 2:  # only those that differ are named one by one
        rows = [
            variant
            for variant in variants
            if not all(settled(study, run) for run in study.records if run.variant == variant)
        ]
    yield '<div class="counts">'
    for name, values in axes.items():
        if not 1 < len(values) <= FEW:
            continue
        lines = []
        for variant in rows:
            cells = []
            for value in values:
                there = [
                    settled(study, run)
                    for run in study.records
                    if run.variant == variant and run.settings.get(name) == value
                ]
                cells.append(f"{sum(there)} of {len(there)}" if there else "–")
            lines.append((variant, cells))
        heads = [number(value) for value in values]
        yield from table(heads, lines, f"How many runs {done}, by {names[name]}")
    yield "</div>"
    if len(rows) < len(variants):
        yield f'<p class="note">The other variants {done} in all their runs.</p>'


def _table_section(
    columns: Sequence[str],
    study: Study,
    runs: Sequence[RunRecord],
    axes: Mapping[str, Sequence[Any]],
) -> Iterator[str]:
    # An example of a filter: the upper half of an axis of numbers, or the first variant.
    short = short_names(axes)
    example = next(
        (
            f"{short[name]} > {number(values[(len(values) - 1) // 2])}"
            for name, values in axes.items()
            if len(values) > 1 and all(isinstance(v, int | float) for v in values)
        ),
        runs[0].variant if runs else "",
    )
    statuses = {"": "all", **{s: s for s in dict.fromkeys(run.status for run in runs)}}
    yield '<h2>Runs</h2><div class="controls">'
    yield (
        '<label>Filter <input id="filter-text" type="search" size="28" '
        f'placeholder="{escape(example)}"></label>'
    )
    yield select("filter-status", "Status", statuses)
    yield '<button id="runs-back" type="button">Previous</button>'
    yield '<button id="runs-on" type="button">Next</button>'
    yield '<output id="runs-shown" aria-live="polite"></output></div>'
    yield (
        '<p class="note">The filter applies to the plots, too. A click on a heading sorts; a click '
        "on a row, or Enter, opens the run.</p>"
    )
    yield '<div class="scroll" tabindex="0" role="region" aria-label="Runs"><table id="runs">'
    yield "<thead><tr>"
    names = metric_labels(study)
    names |= axis_labels(study, [n for n in columns if n not in names])
    for column in columns:
        kind = ' class="text"' if column in ("run", "variant", "status") else ""
        yield (
            f'<th scope="col"{kind} data-column="{escape(column)}" title="{escape(column)}">'
            # A name may be broken after its dots: sine.amplitude.
            f'<button type="button">{escape(names[column]).replace(".", ".<wbr>")}<span></span>'
            "</button></th>"
        )
    yield "</tr></thead><tbody></tbody></table></div>"


def _failures(runs: Sequence[RunRecord]) -> Iterator[str]:
    """Runs that failed, by status and cause, with an example's message."""
    kinds: dict[tuple[str, str, str], list[RunRecord]] = {}
    for run in runs:
        if run.failed:
            kinds.setdefault((run.variant, run.status, run.cause or ""), []).append(run)
    if not kinds:
        return
    yield "<h2>Failures</h2>"
    lines = [
        (variant, [status, cause or "–", str(len(found)), found[0].run_id, found[0].message])
        for (variant, status, cause), found in kinds.items()
    ]
    heads = ["status", "cause", "runs", "for example", "message"]
    yield from table(heads, lines, "What failed", text=True)
