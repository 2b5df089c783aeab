"""Print figures from stored results: the variables of all runs against time, as in the paper.

One figure is a stack of panels over a common time axis, one panel per group of variables.
Colour tells the elements of a vector apart, the line style tells the variants apart: solid for
the first ("Controller 1"), dashed for the second. A panel ``|plant.x|`` shows the Euclidean norm of
a group on a logarithmic axis, where a curve's slope is its rate of decay.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from congelation.cosim.bands import error_name
from congelation.cosim.result import Status
from congelation.errors import InvalidInput, nearest
from congelation.places import replace_whole
from congelation.results.labels import math_label, with_unit
from congelation.results.record import RunRecord, Study, Trajectory, thin
from congelation.scenario.metrics import norm

if TYPE_CHECKING:  # Matplotlib takes half a second, which only commands that draw should wait for
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "SETTINGS", "WIDTH", "draw", "draw_panels", "first_scale", "save"]

Array = npt.NDArray[np.float64]
_Style = Literal["-"] | tuple[float, Sequence[float]]

FORMATS = ("pdf", "png", "svg")
_DATED = {"pdf": "CreationDate", "png": "Software", "svg": "Date"}  # what differs between runs

# M. Okabe and K. Ito, Color Universal Design, 2008: told apart under every common colour vision.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
# Solid, dashed, dotted, dash-dotted: offset and lengths of dashes and gaps, in line widths.
_STYLES: tuple[_Style, ...] = (
    "-",
    (0.0, (3.7, 1.6)),
    (0.0, (1.0, 1.6)),
    (0.0, (6.4, 1.6, 1.0, 1.6)),
)
WIDTH = 3.5
"""Inches: a column of the IEEE format."""

_PANEL_HEIGHT = 1.25  # inches
_MARGIN_HEIGHT = 0.75  # inches: the legend above, the time axis below
_RESOLUTION = 300  # dots per inch of the PNG files
_BINS = 1500  # a column of print at 300 dpi has about 1000 dots; each bin keeps its extremes
_SYMLOG_RATIO = 30.0  # curves this far apart in peak cannot share a linear axis
_SYMLOG_FLOOR = 0.1  # the linear part reaches to this fraction of the smallest curve's peak
_COMMAND = re.compile(r"\\[A-Za-z]+|[_^{}]")  # of mathtext: a letter at most
_NORM_RANGE = 1e-5  # of the peak: what is below is at rest for every purpose
SETTINGS: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "mathtext.fontset": "cm",
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "pdf.fonttype": 42,  # TrueType: journals refuse Type 3
    "svg.hashsalt": "congelation",
}


@dataclass(frozen=True)
class _Run:
    """The part of a run that a figure shows."""

    variant: str
    completed: bool
    trajectory: Trajectory


@dataclass(frozen=True)
class _Curve:
    """One variable of one run, or the norm of a group; `label` is mathtext."""

    label: str
    variant: str
    completed: bool
    time: Array
    values: Array
    unit: str
    band: Array | None = None  # half the width of an error bar


def draw(
    study: Study,
    runs: Sequence[tuple[RunRecord, Trajectory]],
    name: str | None = None,
    width: float = WIDTH,
) -> Figure:
    """The figure called `name`, by default the first that the study defines.

    Raises
    ------
    InvalidInput
        If the study defines no such figure.
    """
    figures = {str(f["name"]): f for f in study.about["figures"]}
    chosen = next(iter(figures), "") if name is None else name
    if not figures:
        raise InvalidInput(
            f"there is no figure '{chosen}': this study defines none; plot() draws what was "
            "recorded"
        )
    if chosen not in figures:
        raise InvalidInput(f"there is no figure '{chosen}'; {nearest(chosen, figures)}")
    about = figures[chosen]
    return draw_panels(
        runs,
        about["panels"],
        about["span"] or (-math.inf, math.inf),
        width,
        scale=about.get("scale", "auto"),  # not there in directories of earlier versions
        legend=about.get("legend", True),
    )


def draw_panels(
    runs: Sequence[tuple[RunRecord, Trajectory]],
    panels: Sequence[str],
    span: tuple[float, float] = (-math.inf, math.inf),
    width: float = WIDTH,
    *,
    scale: str = "auto",
    legend: bool = True,
) -> Figure:
    """Panels above each other, one per group of variables, over a part of the time axis.

    `width` is that of the figure in inches. `scale` is that of the vertical axes, ``linear``,
    ``log`` or ``symlog``; ``auto`` follows the ranges of the variants.
    """
    import matplotlib as mpl

    shown = [
        _Run(r.variant, r.status == Status.COMPLETED.name, _cut(trajectory, *span))
        for r, trajectory in runs
    ]
    with mpl.rc_context(SETTINGS):
        with_rows = [run for run in shown if len(run.trajectory.time)]
        return _draw(with_rows, panels, width, scale, legend=legend)


def save(
    figure: Figure, folder: Path, name: str, formats: Sequence[str] = ("pdf", "png")
) -> tuple[Path, ...]:
    """Write a figure in some of `FORMATS`; returns the files.

    PDF embeds its fonts as TrueType; SVG draws letters as paths, which need no font.
    """
    import matplotlib as mpl

    # It warns of the dates in Matplotlib's own fonts, which nobody here can mend.
    logging.getLogger("fontTools").setLevel(logging.ERROR)
    files = tuple(folder / f"{name}.{suffix}" for suffix in formats)
    with mpl.rc_context(SETTINGS):
        for file, suffix in zip(files, formats, strict=True):
            metadata = {_DATED[suffix]: None}  # the same figure is the same file

            def write(temporary: Path, suffix: str = suffix, about: object = metadata) -> None:
                figure.savefig(temporary, format=suffix, dpi=_RESOLUTION, metadata=about)

            replace_whole(file, write)
    return files


def _draw(
    runs: Sequence[_Run], panels: Sequence[str], width: float, scale: str, *, legend: bool
) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    variants = [run.variant for run in runs]
    figure = Figure(
        figsize=(width, _MARGIN_HEIGHT + _PANEL_HEIGHT * len(panels)), layout="constrained"
    )
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    drawn: set[str] = set()
    for axis, panel in zip(axes, panels, strict=True):
        found = _norms(runs, panel) if _is_norm(panel) else _curves(runs, panel)
        curves = _without_repeats(list(found))
        drawn |= {curve.variant for curve in curves}
        _panel(axis, panel, curves, variants, scale, legend=legend)
    axes[-1].set_xlabel(with_unit("$t$", "s"))
    start = min((float(run.trajectory.time[0]) for run in runs), default=0.0)
    stop = max((float(run.trajectory.time[-1]) for run in runs), default=0.0)
    if stop > start:
        axes[-1].set_xlim(start, stop)
    if legend and len(drawn) > 1:
        handles = [
            Line2D(
                [], [], color="black", linestyle=_style(variants, v), label=v.replace("$", r"\$")
            )
            for v in variants
        ]
        columns = min(2, _columns(variants, width))
        figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False)
    figure.align_ylabels()
    return figure


def _is_norm(panel: str) -> bool:
    return panel.startswith("|")


def _cut(trajectory: Trajectory, start: float, stop: float) -> Trajectory:
    inside = (trajectory.time >= start) & (trajectory.time <= stop)
    return replace(trajectory, time=trajectory.time[inside], values=trajectory.values[inside])


def _curves(runs: Sequence[_Run], panel: str) -> Iterator[_Curve]:
    # A signal that several runs share, theta(t), is drawn once: of the run that went furthest, with
    # the most rows, in the style of the first.
    shared: dict[tuple[str, object], list[_Run]] = {}
    for run in runs:
        for column in run.trajectory.group(panel):
            if column in run.trajectory.signals:
                shared.setdefault((column, run.trajectory.signals[column]), []).append(run)
    finest = {
        key: max(found, key=lambda run: (run.trajectory.time[-1], len(run.trajectory.time)))
        for key, found in shared.items()
    }
    for shown in runs:
        for column in shown.trajectory.group(panel):
            run = shown
            if column in run.trajectory.signals:
                key = (column, run.trajectory.signals[column])
                if shared[key][0] is not shown:
                    continue
                run = finest[key]
            values = run.trajectory.select((column,))[:, 0]
            rows = thin(values, _BINS)
            unit = run.trajectory.units.get(column, "")
            label = math_label(column.partition(".")[2])
            band = None
            if error_name(column) in run.trajectory.columns:
                band = run.trajectory.select((error_name(column),))[rows, 0]
            time = run.trajectory.time[rows]
            yield _Curve(label, shown.variant, run.completed, time, values[rows], unit, band)


def _norms(runs: Sequence[_Run], panel: str) -> Iterator[_Curve]:
    group = panel.strip("|")
    for run in runs:
        columns = run.trajectory.group(group)
        if columns:
            size = norm(run.trajectory.select(columns))
            rows = thin(size, _BINS)
            units = {run.trajectory.units.get(column, "") for column in columns}
            unit = units.pop() if len(units) == 1 else ""
            label = f"|{math_label(group.partition('.')[2])}|"
            time = run.trajectory.time[rows]
            yield _Curve(label, run.variant, run.completed, time, size[rows], unit)


def _without_repeats(curves: Sequence[_Curve]) -> list[_Curve]:
    """`curves` without those that equal an earlier one, e.g. the same theta in every variant."""
    kept: list[_Curve] = []
    for curve in curves:
        if not any(_same(curve, other) for other in kept):
            kept.append(curve)
    return kept


def _same(a: _Curve, b: _Curve) -> bool:
    return a.label == b.label and bool(
        np.array_equal(a.time, b.time) and np.array_equal(a.values, b.values)
    )


def _panel(
    axis: Axes,
    panel: str,
    curves: Sequence[_Curve],
    variants: Sequence[str],
    scale: str,
    *,
    legend: bool,
) -> None:
    from matplotlib.lines import Line2D

    units = {curve.label: curve.unit for curve in curves}
    labels = list(units)
    for curve in curves:
        colour = _COLOURS[labels.index(curve.label) % len(_COLOURS)]
        axis.plot(curve.time, curve.values, color=colour, linestyle=_style(variants, curve.variant))
        if curve.band is not None:
            low, high = curve.values - curve.band, curve.values + curve.band
            axis.fill_between(curve.time, low, high, color=colour, alpha=0.2, linewidth=0.0)
        if not curve.completed:  # a cross where the run ended
            axis.plot(curve.time[-1:], curve.values[-1:], color=colour, marker="x", clip_on=False)
    if _is_norm(panel) and scale in ("auto", "log"):
        _logarithmic(axis, curves)
    elif scale == "log":
        axis.set_yscale("log", nonpositive="mask")
    else:
        _scale(axis, curves, scale)
    common_unit = next(iter(units.values())) if len(set(units.values())) == 1 else ""
    if len(labels) < 2:  # none where no run got as far as a first row
        axis.set_ylabel(with_unit(labels[0], common_unit) if labels else panel)
        return
    axis.set_ylabel(with_unit(math_label(panel.partition(".")[2]), common_unit))
    if not legend:
        return
    handles = [
        Line2D(
            [],
            [],
            color=_COLOURS[i % len(_COLOURS)],
            label=label if common_unit else with_unit(label, units[label]),
        )
        for i, label in enumerate(labels)
    ]
    axis.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),  # above the panel, where it hides no curve
        ncols=_columns(
            [str(handle.get_label()) for handle in handles],
            axis.figure.bbox.width / axis.figure.dpi,
        ),
        frameon=False,
        handlelength=1.0,
        borderpad=0.0,
    )


def _columns(labels: Sequence[str], width: float) -> int:
    """How many entries of a legend stand beside each other in a figure `width` inches wide.

    A letter of the legend's 7 points is 0.6 of that wide at most on average; each entry has a line
    and gaps that take as much as six letters. The axes are about 0.8 of the figure.
    """
    longest = max(len(_COMMAND.sub("x", label).replace("$", "")) for label in labels)
    entry = (longest + 6) * 0.6 * 7.0 / 72.0
    return max(1, min(len(labels), int(0.8 * width / entry)))


def _logarithmic(axis: Axes, curves: Sequence[_Curve]) -> None:
    highest = max((float(np.max(curve.values, initial=0.0)) for curve in curves), default=0.0)
    if highest > 0.0:
        axis.set_yscale("log")
        axis.set_ylim(_NORM_RANGE * highest, 2.0 * highest)


def first_scale(
    curves: Sequence[tuple[object, Array]], *, logarithmic: bool = False
) -> tuple[Literal["linear", "symlog"], float]:
    """The scale that an axis has at first, and where its linear part ends if it is symlog.

    It is symlog where the variants differ by orders of magnitude, or where it is asked to be
    `logarithmic`, as for a norm. Each curve is given as its variant and its values.
    """
    peaks: dict[object, float] = {}
    for variant, values in curves:
        largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
        peaks[variant] = max(largest, peaks.get(variant, 0.0))
    nonzero = [p for p in peaks.values() if p > 0.0]
    if not nonzero:
        return "linear", 1.0
    if logarithmic:
        return "symlog", 10.0 ** math.floor(math.log10(_NORM_RANGE * max(nonzero)))
    threshold = 10.0 ** math.floor(math.log10(_SYMLOG_FLOOR * min(nonzero)))
    apart = max(nonzero) > _SYMLOG_RATIO * min(nonzero)
    return ("symlog" if apart else "linear"), threshold


def _scale(axis: Axes, curves: Sequence[_Curve], scale: str) -> None:
    """A linear axis, or a symmetric logarithmic one: if asked for, or for far apart variants."""
    suggested, threshold = first_scale([(curve.variant, curve.values) for curve in curves])
    peak = max((float(np.max(np.abs(c.values), initial=0.0)) for c in curves), default=0.0)
    if (suggested if scale == "auto" else scale) == "linear" or peak == 0.0:
        return
    lowest = round(math.log10(threshold))
    highest = math.floor(math.log10(peak))
    axis.set_yscale("symlog", linthresh=threshold, linscale=1.0)
    # The decades to label: at most three each side, the highest always.
    step = math.ceil((highest - lowest) / 3)
    decades = [10.0**k for k in range(highest, lowest, -step)]
    axis.set_yticks([*(-d for d in decades), 0.0, *reversed(decades)])


def _style(variants: Sequence[str], variant: str) -> _Style:
    return _STYLES[variants.index(variant) % len(_STYLES)]
