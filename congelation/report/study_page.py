"""The page of a study: metrics against settings, trade-offs, a table of all runs, trajectories."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from congelation.errors import counted
from congelation.report.axes import FEW, axes_of, short_names, unit_of
from congelation.report.curves import NOT_PRINTED, PICKED, Curve, Panel, curve_panels, draw_panels
from congelation.report.page_shell import Drawn, swatch, table
from congelation.report.summary import NOT_SETTLED, label_of, number, summarise
from congelation.report.verdict import settled
from congelation.results.record import RunRecord, Study, Trajectory
from congelation.results.results import Results

if TYPE_CHECKING:
    from bokeh.plotting import figure

__all__ = ["study_content"]

EMBEDDED, BUDGET = 200, 250_000
"""Runs whose trajectories are in the page at most, and points of all their curves: 2.7 MB. A click
on another run names its file."""

POINTS = 1000
"""Of each of these curves."""

LARGEST = 20_000
"""Runs of which the page has a row each; of a larger study it takes every k-th."""

_HEIGHT = 380  # pixels


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
    pieces += _variant_controls(variants)
    if axes and metrics:
        pieces += _metric_section(axes, metrics, variants, study)
    if len(axes) > 1 and metrics:
        pieces += _map_section(axes, metrics, variants, study)
    if len(metrics) > 1:
        pieces += _pareto_section(metrics, variants, study)
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
        "labels": {**_labels(study), **_axis_labels(study, axes)},
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


def _axis_labels(study: Study, axes: Iterable[str]) -> dict[str, str]:
    """Settings by their short names, with units."""
    units = {name: unit_of(study, name).strip() for name in axes}
    return {n: f"{s} [{units[n]}]" if units[n] else s for n, s in short_names(axes).items()}


def _labels(study: Study) -> dict[str, str]:
    """The metrics with their units."""
    return {name: label_of(name, about) for name, about in study.about["metrics"].items()}


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
    names = _axis_labels(study, axes)
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


def _variant_controls(variants: Sequence[str]) -> Iterator[str]:
    yield '<div class="controls"><fieldset><legend>Show</legend>'
    for k, variant in enumerate(variants):
        yield (
            f'<label><input type="checkbox" checked data-toggle="{k}">{swatch(k)} '
            f"{escape(variant)}</label>"
        )
    yield "</fieldset></div>"


def _select(name: str, label: str, options: Mapping[str, str], chosen: str = "") -> str:
    listed = "".join(
        f'<option value="{escape(value)}"{" selected" if value == chosen else ""}>'
        f"{escape(text)}</option>"
        for value, text in options.items()
    )
    return f'<label>{escape(label)} <select id="{name}">{listed}</select></label>'


def _section(title: str, plot: Drawn, selects: Sequence[str], note: str) -> Iterator[str | Drawn]:
    name = plot.name
    yield f'<h2>{escape(title)}</h2><div class="controls">{"".join(selects)}</div>'
    yield f'<p class="note">{escape(note)}</p><section class="panel">'
    yield plot
    yield (
        f'<div class="numbers" tabindex="0" role="region" aria-label="Numbers: {escape(title)}">'
        f'<table id="{name}-numbers"><thead></thead><tbody></tbody></table></div></section>'
    )


def _metric_section(
    axes: Mapping[str, Any], metrics: Sequence[str], variants: Sequence[str], study: Study
) -> Iterator[str | Drawn]:
    from bokeh.models import ColumnDataSource

    plot = _plot("metric")
    for k in range(len(variants)):
        empty: dict[str, list[float]] = {"x": [], "median": [], "low": [], "high": []}
        source = ColumnDataSource(empty, name=f"metric.line.{k}")
        band = plot.varea("x", "low", "high", source=source, fill_alpha=0.18)
        line = plot.line("x", "median", source=source, line_width=2.5)
        band.tags = line.tags = [f"variant {k}"]
    _points(plot, "metric", len(variants))
    named = _labels(study)
    timed = (n for n in metrics if study.about["metrics"][n]["metric"] == "settling_time")
    selects = [
        _select("metric-metric", "Metric", named, next(timed, metrics[0])),
        _select("metric-axis", "against", _axis_labels(study, axes), _fullest(axes)[0]),
        _select("metric-band", "Band", {"0.9": "5 % to 95 %", "0.5": "25 % to 75 %", "1": "all"}),
        _select(
            "metric-scale",
            "Scale",
            {"auto": "as suggested", "linear": "linear", "log": "logarithmic"},
        ),
    ]
    drawn = Drawn(plot, "A metric against a setting; the table beside it has its numbers")
    yield from _section(
        "Metric against a setting",
        drawn,
        selects,
        "Lines are medians of each variant, bands its quantiles over all other settings, points "
        "are runs.",
    )


def _fullest(axes: Mapping[str, Sequence[Any]]) -> list[str]:
    """Axes, those with most values first: of these the most is to be seen."""
    return sorted(axes, key=lambda name: -len(axes[name]))


def _map_section(
    axes: Mapping[str, Any], metrics: Sequence[str], variants: Sequence[str], study: Study
) -> Iterator[str | Drawn]:
    from bokeh.models import ColumnDataSource, HoverTool

    plot = _plot("map")
    empty: dict[str, list[Any]] = {
        n: [] for n in ("x", "y", "fill", "hatch", "ink", "label", "a", "b")
    }
    source = ColumnDataSource(empty, name="map.cells")
    plot.rect(
        "x", "y", 1, 1, source=source, fill_color="fill", line_color=None,
        hatch_pattern="hatch", hatch_color="#888888", hatch_alpha=0.6, hatch_weight=1,
    )  # fmt: skip
    plot.text(
        "x", "y", "label", source=source, text_color="ink", text_align="center",
        text_baseline="middle", text_font_size="12px",
    )  # fmt: skip
    plot.grid.visible = False
    plot.add_tools(HoverTool(tooltips=[("", "@a"), ("", "@b")], limit=1))
    first, second = _fullest(axes)[:2]
    named = _labels(study)
    timed = (n for n in metrics if study.about["metrics"][n]["metric"] == "settling_time")
    last = str(len(variants) - 1)
    selects = [
        _select("map-metric", "Metric", named, next(timed, metrics[0])),
        _select("map-variant", "of", {str(k): v for k, v in enumerate(variants)}, last),
        _select("map-x", "across", _axis_labels(study, axes), first),
        _select("map-y", "up", _axis_labels(study, axes), second),
    ]
    yield from _section(
        "Heat map of two settings",
        Drawn(plot, "A metric over two settings; the table beside it has its numbers"),
        selects,
        "Medians over all other settings, of one variant; bright is large, "
        "hatched infinite, and a cell without a run is empty.",
    )


def _pareto_section(
    metrics: Sequence[str], variants: Sequence[str], study: Study
) -> Iterator[str | Drawn]:
    from bokeh.models import ColumnDataSource

    plot = _plot("pareto")
    for k in range(len(variants)):
        source = ColumnDataSource(_no_points(), name=f"pareto.line.{k}")
        plot.line("x", "y", source=source, line_width=2.5).tags = [f"variant {k}"]
    _points(plot, "pareto", len(variants))
    named = _labels(study)
    kinds = {name: study.about["metrics"][name] for name in metrics}
    timed = (n for n in metrics if kinds[n]["metric"] == "settling_time")
    costs = (n for n in metrics if kinds[n]["of"].rpartition(".")[2] == "u")
    first = next(timed, metrics[0])
    second = next(costs, next(n for n in metrics if n != first))
    selects = [
        _select("pareto-x", "Metric", named, first),
        _select("pareto-y", "against", named, second),
        '<label><input type="checkbox" id="pareto-pool"> one front of all variants</label>',
    ]
    yield from _section(
        "Pareto front",
        Drawn(plot, "Two metrics of all runs; the table beside it has the runs not beaten"),
        selects,
        "The line joins the runs of a variant that no other run of it beats in both metrics; less "
        "is better. Only runs with finite metrics compete.",
    )


def _no_points() -> dict[str, list[Any]]:
    return {name: [] for name in ("x", "y", "row", "a", "b", "run")}


def _points(plot: figure, name: str, variants: int) -> None:
    """The runs of each variant as points that can be picked."""
    from bokeh.models import ColumnDataSource, CustomJS, HoverTool, TapTool

    drawn = []
    marks = ("circle", "triangle", "square", "diamond", "inverted_triangle", "hex", "plus", "x")
    for k in range(variants):
        source = ColumnDataSource(_no_points(), name=f"{name}.points.{k}")
        source.selected.js_on_change(
            "indices",
            CustomJS(args={"source": source}, code="congelation.study.pick(source)"),
        )
        points = plot.scatter(
            "x", "y", source=source, size=7, marker=marks[k % 8], alpha=0.7,
            nonselection_alpha=0.7, selection_alpha=1.0,
        )  # fmt: skip
        points.tags = [f"variant {k}"]
        drawn.append(points)
    tips = [("", "@a"), ("", "@b"), ("run", "@run")]
    plot.add_tools(HoverTool(tooltips=tips, renderers=drawn, limit=3), TapTool(renderers=drawn))


def _plot(name: str) -> figure:
    """An empty plot, both axes of which follow the scales ``name.x`` and ``name.y``."""
    from bokeh.models import CustomJSTicker, CustomJSTickFormatter, Range1d
    from bokeh.plotting import figure

    plot = figure(
        name=name,
        height=_HEIGHT,
        sizing_mode="stretch_width",
        tools="box_zoom,wheel_zoom,undo,reset,save",
        active_scroll=None,
        min_border_right=20,
        x_range=Range1d(0.0, 1.0),  # the script sets them, with what it draws
        y_range=Range1d(0.0, 1.0),
    )
    plot.toolbar.logo = None
    plot.toolbar.stylesheets = [NOT_PRINTED]
    for axis, of in ((plot.xaxis, f"{name}.x"), (plot.yaxis, f"{name}.y")):
        code = f"return congelation.ticks('{of}', cb_data.start, cb_data.end)"
        axis.ticker = CustomJSTicker(major_code=code)
        axis.formatter = CustomJSTickFormatter(code=f"return congelation.tick('{of}', tick)")
    return plot


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
    yield _select("filter-status", "Status", statuses)
    yield '<button id="runs-back" type="button">Previous</button>'
    yield '<button id="runs-on" type="button">Next</button>'
    yield '<output id="runs-shown" aria-live="polite"></output></div>'
    yield (
        '<p class="note">The filter applies to the plots, too. A click on a heading sorts; a click '
        "on a row, or Enter, opens the run.</p>"
    )
    yield '<div class="scroll" tabindex="0" role="region" aria-label="Runs"><table id="runs">'
    yield "<thead><tr>"
    names = _labels(study)
    names |= _axis_labels(study, [n for n in columns if n not in names])
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
    yield from table(["status", "cause", "runs", "for example", "message"], lines, "What failed")
