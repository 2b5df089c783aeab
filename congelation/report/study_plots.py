"""The plots of a study with their controls, which study.js fills: a metric against a setting, the
map of two settings, the Pareto front."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from congelation.report.axes import short_names, unit_of
from congelation.report.page_shell import Drawn, swatch
from congelation.report.panels import NOT_PRINTED
from congelation.report.summary import label_of
from congelation.report.verdict import metric_of_kind
from congelation.results.record import Study

if TYPE_CHECKING:
    from bokeh.plotting import figure

__all__ = [
    "axis_labels",
    "map_section",
    "metric_labels",
    "metric_section",
    "pareto_section",
    "select",
    "variant_controls",
]

_HEIGHT = 380  # pixels
_BAND = 0.18  # opacity of the band of a variant


def axis_labels(study: Study, axes: Iterable[str]) -> dict[str, str]:
    """Settings by their short names, with units."""
    units = {name: unit_of(study, name).strip() for name in axes}
    return {n: f"{s} [{units[n]}]" if units[n] else s for n, s in short_names(axes).items()}


def metric_labels(study: Study) -> dict[str, str]:
    """The metrics with their units."""
    return {name: label_of(name, about) for name, about in study.about["metrics"].items()}


def variant_controls(variants: Sequence[str]) -> Iterator[str]:
    yield '<div class="controls"><fieldset><legend>Show</legend>'
    for k, variant in enumerate(variants):
        yield (
            f'<label><input type="checkbox" checked data-toggle="{k}">{swatch(k)} '
            f"{escape(variant)}</label>"
        )
    yield "</fieldset></div>"


def select(name: str, label: str, options: Mapping[str, str], chosen: str = "") -> str:
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


def metric_section(
    axes: Mapping[str, Any], metrics: Sequence[str], variants: Sequence[str], study: Study
) -> Iterator[str | Drawn]:
    from bokeh.models import ColumnDataSource

    plot = _plot("metric")
    # Many bands over each other stay as light as two.
    alpha = min(_BAND, 2 * _BAND / max(1, len(variants)))
    for k in range(len(variants)):
        empty: dict[str, list[float]] = {"x": [], "median": [], "low": [], "high": []}
        source = ColumnDataSource(empty, name=f"metric.line.{k}")
        band = plot.varea("x", "low", "high", source=source, fill_alpha=alpha)
        line = plot.line("x", "median", source=source, line_width=2.5)
        band.tags = line.tags = [f"variant {k}"]
    _points(plot, "metric", len(variants))
    named = metric_labels(study)
    selects = [
        select(
            "metric-metric", "Metric", named, metric_of_kind(study, "settling_time") or metrics[0]
        ),
        select("metric-axis", "against", axis_labels(study, axes), _fullest(axes)[0]),
        select("metric-band", "Band", {"0.9": "5 % to 95 %", "0.5": "25 % to 75 %", "1": "all"}),
        select(
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


def map_section(
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
    named = metric_labels(study)
    last = str(len(variants) - 1)
    selects = [
        select("map-metric", "Metric", named, metric_of_kind(study, "settling_time") or metrics[0]),
        select("map-variant", "of", {str(k): v for k, v in enumerate(variants)}, last),
        select("map-x", "across", axis_labels(study, axes), first),
        select("map-y", "up", axis_labels(study, axes), second),
    ]
    yield from _section(
        "Heat map of two settings",
        Drawn(plot, "A metric over two settings; the table beside it has its numbers"),
        selects,
        "Medians over all other settings, of one variant; bright is large, "
        "hatched infinite, and a cell without a run is empty.",
    )


def pareto_section(
    metrics: Sequence[str], variants: Sequence[str], study: Study
) -> Iterator[str | Drawn]:
    from bokeh.models import ColumnDataSource

    plot = _plot("pareto")
    for k in range(len(variants)):
        source = ColumnDataSource(_no_points(), name=f"pareto.line.{k}")
        plot.line("x", "y", source=source, line_width=2.5).tags = [f"variant {k}"]
    _points(plot, "pareto", len(variants))
    named = metric_labels(study)
    kinds = {name: study.about["metrics"][name] for name in metrics}
    costs = (n for n in metrics if kinds[n]["of"].rpartition(".")[2] == "u")
    first = metric_of_kind(study, "settling_time") or metrics[0]
    second = next(costs, next(n for n in metrics if n != first))
    selects = [
        select("pareto-x", "Metric", named, first),
        select("pareto-y", "against", named, second),
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
