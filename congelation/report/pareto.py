"""Trade-offs in a sweep: which runs no other beats, and a figure of all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from congelation.errors import InvalidInput, nearest
from congelation.report.figures import SETTINGS
from congelation.report.labels import with_unit
from congelation.results.records import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_front", "pareto_front"]

_SIZE = (3.5, 2.6)  # inches: a column of the IEEE format
_FRONT, _OTHERS = "#D55E00", "#0072B2"  # as in the other figures


def pareto_front(study: Study, metrics: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """The rows that no other row beats: none is at most equal in all metrics and less in one.

    Only finite metrics of completed runs compete; sorted by the first metric.

    Raises
    ------
    InvalidInput
        If there is no such metric.
    """
    for name in metrics:
        if name not in study.about["metrics"]:
            raise InvalidInput(f"'{name}' is no metric; {nearest(name, study.about['metrics'])}")
    rivals = _rivals(study, metrics)
    costs = np.array([cost for cost, _ in rivals], dtype=float).reshape(-1, len(metrics))
    front = [
        (cost, row)
        for cost, row in rivals
        if not np.any(np.all(costs <= cost, axis=1) & np.any(costs < cost, axis=1))
    ]
    return tuple(row for _, row in sorted(front, key=lambda entry: entry[0]))


def draw_front(study: Study, metrics: Sequence[str]) -> Figure:
    """All runs by two of their metrics, and the Pareto front as a line through its runs.

    Axes are logarithmic where all values are positive.

    Raises
    ------
    InvalidInput
        If there are not two metrics, or no such metric.
    """
    import matplotlib as mpl  # here, as in congelation.report.figures
    from matplotlib.figure import Figure

    if len(metrics) != 2:
        raise InvalidInput(f"a figure of a Pareto front has two metrics, not {len(metrics)}")
    front = np.array([[row[name] for name in metrics] for row in pareto_front(study, metrics)])
    costs = np.array([cost for cost, _ in _rivals(study, metrics)], dtype=float).reshape(-1, 2)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=_SIZE, layout="constrained")
        axes = figure.subplots()
        axes.plot(*costs.T, ".", color=_OTHERS, markersize=3, label="runs")
        axes.plot(*front.reshape(-1, 2).T, ".-", color=_FRONT, label="not beaten")
        for name, set_label, set_scale, values in (
            (metrics[0], axes.set_xlabel, axes.set_xscale, costs[:, 0]),
            (metrics[1], axes.set_ylabel, axes.set_yscale, costs[:, 1]),
        ):
            set_label(with_unit(name, study.about["metrics"][name]["unit"]))
            if len(values) and np.all(values > 0.0):
                set_scale("log")
        axes.legend()
    return figure


def _rivals(study: Study, metrics: Sequence[str]) -> list[tuple[tuple[float, ...], dict[str, Any]]]:
    """The metrics and the row of every run that has them all, and finite."""
    entries = [(tuple(row[name] for name in metrics), row) for row in study.rows]
    return [
        (cost, row)
        for cost, row in entries
        if all(value is not None and math.isfinite(value) for value in cost)
    ]
