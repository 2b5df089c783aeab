"""Linked plots of curves, made with Bokeh, and the tables of their numbers.

Colour tells the variants apart, the dash pattern the elements of a vector. Beside each plot stands
a table of its numbers, which follows the cursor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from congelation.report.curves import (
    ERROR,
    EVERY,
    PICKED,
    RATE_NAMES,
    RATES,
    STEPS,
    Curve,
    Panel,
    pretty,
)
from congelation.report.page_shell import Drawn, swatch
from congelation.report.summary import short
from congelation.results.labels import plain_unit
from congelation.results.print_figures import first_scale

if TYPE_CHECKING:
    from bokeh.plotting import figure

__all__ = ["NOT_PRINTED", "controls", "draw_panels"]

NOT_PRINTED = "@media print { :host { display: none !important; } }"
"""Style of what paper has no use for, inside of Bokeh's own elements."""

HEIGHT = 250  # pixels of a panel


def controls(variants: Sequence[str], start: float, stop: float) -> Iterator[str]:
    """Switches for variants and scale, and a slider that moves the cursor."""
    yield '<div class="controls" role="group" aria-label="Controls of the plots">'
    if len(variants) > 1:
        yield "<fieldset><legend>Show</legend>"
        for k, variant in enumerate(variants):
            yield (
                f'<label><input type="checkbox" checked data-toggle="{k}">{swatch(k)} '
                f"{escape(variant)}</label>"
            )
        yield "</fieldset>"
    yield (
        '<label>Scale <select class="scale"><option value="auto">as suggested</option>'
        '<option value="linear">linear</option>'
        '<option value="symlog">symmetric logarithmic</option></select></label>'
    )
    step = (stop - start) / 500 if stop > start else 1
    yield (
        f'<label>Cursor <input type="range" class="time" min="{start!r}" max="{stop!r}" '
        f'step="{step!r}" value="{start!r}"></label><output class="time"></output></div>'
    )


def draw_panels(
    panels: Sequence[Panel], variants: Sequence[str]
) -> tuple[list[str | Drawn], dict[str, dict[str, Any]]]:
    """Plots and their tables, and the scales that the page's script reads."""
    from bokeh.models import Range1d

    times = [curve.time for panel in panels for curve in panel.curves if len(curve.time)]
    start = min((float(t[0]) for t in times), default=0.0)
    stop = max((float(t[-1]) for t in times), default=1.0)
    span = Range1d(start, stop, bounds="auto") if stop > start else Range1d(start, start + 1.0)
    pieces: list[str | Drawn] = []
    scales = {}
    for panel in panels:
        plot = _plot(panel, variants, span)
        units = f" [{plain_unit(panel.unit)}]" if plain_unit(panel.unit) else ""
        pieces.append(
            f'<section class="panel"><h3>{escape(pretty(panel.title))}{escape(units)}</h3>'
        )
        if panel.note:
            pieces.append(f'<p class="note">{escape(panel.note)}</p>')
        pieces.append(
            Drawn(plot, f"{panel.title} against time; the table beside it has its numbers")
        )
        pieces += ["\n".join(_numbers(panel, variants)), "</section>"]
        mode, threshold = first_scale(
            [(curve.variant, curve.value) for curve in panel.curves],
            logarithmic=panel.title.startswith("|")
            or panel.title in ("estimated error", "Lyapunov function V", RATES, STEPS),
        )
        scales[panel.name] = {"mode": mode, "first": mode, "threshold": threshold}
    return pieces, scales


def _plot(panel: Panel, variants: Sequence[str], span: Any) -> figure:
    from bokeh.models import ColumnDataSource, CustomJSTransform
    from bokeh.transform import transform

    plot = empty_plot(panel.name, x_range=span)
    place = CustomJSTransform(v_func=f"return congelation.placed('{panel.name}', xs)")
    for curve in panel.curves:
        source = ColumnDataSource({"time": curve.time, "value": curve.value}, name=curve.name)
        drawn = plot.line(
            "time",
            transform("value", place),
            source=source,
            line_width=2,
            line_dash=list(curve.dash) or "solid",
            name=", ".join(filter(None, (curve.label, _who(curve, variants)))),
        )
        # Given above, they would be the glyph's.
        drawn.tags = [f"variant {k}" for k in (curve.variant, *curve.others)]
    return plot


def _who(curve: Curve, variants: Sequence[str]) -> str:
    """The variants that a curve is of, for people."""
    if curve.variant < 0:
        return {EVERY: "every variant", PICKED: ""}[curve.variant]
    return "; ".join(variants[k] for k in (curve.variant, *curve.others))


def empty_plot(name: str, **options: Any) -> figure:
    """A plot whose vertical axis follows the scale of that name in the page's script."""
    from bokeh.models import CustomJS, CustomJSTicker, CustomJSTickFormatter, HoverTool, Span
    from bokeh.plotting import figure

    plot = figure(
        name=name,
        height=HEIGHT,
        sizing_mode="stretch_width",
        tools="xpan,box_zoom,wheel_zoom,undo,reset,save",
        active_drag="box_zoom",
        active_scroll=None,
        toolbar_location="above",
        x_axis_label="t [s]",
        min_border_right=12,
        **options,
    )
    plot.toolbar.logo = None
    plot.toolbar.stylesheets = [NOT_PRINTED]
    plot.y_range.only_visible = True
    plot.yaxis.ticker = CustomJSTicker(
        major_code=f"return congelation.ticks('{name}', cb_data.start, cb_data.end)"
    )
    plot.yaxis.formatter = CustomJSTickFormatter(code=f"return congelation.tick('{name}', tick)")
    plot.add_tools(
        HoverTool(
            tooltips=[("", "$name"), ("t", "@time{0.0000} s"), ("", "@value{0.0000e+0}")],
            limit=3,
            line_policy="nearest",
        )
    )
    plot.add_layout(Span(dimension="height", name="cursor", visible=False, line_width=1))
    follow = CustomJS(code="congelation.cursor(cb_obj.x)")
    for event in ("mousemove", "tap"):
        plot.js_on_event(event, follow)
    return plot


def _numbers(panel: Panel, variants: Sequence[str]) -> Iterator[str]:
    """The table beside a plot, which is its legend, too."""
    about = escape(f"Numbers of {panel.title}")
    yield f'<div class="numbers" tabindex="0" role="region" aria-label="{about}"><table><thead><tr>'
    for head in ("curve", "start", "least", "largest", "end"):
        yield f'<th scope="col">{head}</th>'
    yield '<th scope="col" class="at">cursor</th>'
    yield "</tr></thead><tbody>"
    several = len({curve.unit for curve in panel.curves}) > 1
    for curve in panel.curves:
        who = _who(curve, variants)
        error = ERROR.match(curve.label)
        plain = error["of"] if error else curve.label
        name = RATE_NAMES.get(plain) or pretty(plain.partition(".")[2] or plain)
        name = f"|{name}" if curve.label.startswith("|") else name
        if several and plain_unit(curve.unit):
            name += f" [{plain_unit(curve.unit)}]"
        cells = "".join(f"<td>{escape(_short(value))}</td>" for value in curve.numbers)
        label = f"{swatch(curve.variant, curve.dash)} {escape(name)}" + (
            f"<br><small>{escape(who)}</small>" if who else ""
        )
        yield (
            f'<tr data-variant="{" ".join(map(str, (curve.variant, *curve.others)))}">'
            f'<th scope="row">{label}</th>{cells}'
            f'<td class="at" data-curve="{curve.name}">–</td></tr>'
        )
    yield "</tbody></table></div>"


def _short(value: float) -> str:
    """Three digits, so that five numbers stand beside each other on a phone."""
    return "–" if math.isnan(value) else short(value, 3)
