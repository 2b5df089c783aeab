"""Trade-offs in a sweep: which runs no other beats, and a figure of all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from congelation.errors import InvalidInput, nearest
from congelation.results.labels import with_unit
from congelation.results.print_figures import SETTINGS
from congelation.results.record import RunRecord, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_front", "pareto_front"]

_SIZE = (3.5, 2.6)  # inches: a column of the IEEE format
_FRONT, _OTHERS = "#D55E00", "#0072B2"  # as in the other figures


def pareto_front(study: Study, metrics: Sequence[str]) -> tuple[RunRecord, ...]:
    """The runs that no other run beats: none is at most equal in all metrics and less in one.

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
        (cost, run)
        for cost, run in rivals
        if not np.any(np.all(costs <= cost, axis=1) & np.any(costs < cost, axis=1))
    ]
    return tuple(run for _, run in sorted(front, key=lambda entry: entry[0]))


def draw_front(study: Study, metrics: Sequence[str]) -> Figure:
    """All runs by two of their metrics, and the Pareto front as a line through its runs.

    Axes are logarithmic where all values are positive.

    Raises
    ------
    InvalidInput
        If there are not two metrics, or no such metric.
    """
    import matplotlib as mpl  # here, as in congelation.results.print_figures
    from matplotlib.figure import Figure

    if len(metrics) != 2:
        raise InvalidInput(f"a figure of a Pareto front has two metrics, not {len(metrics)}")
    front = np.array(
        [[run.metrics[name] for name in metrics] for run in pareto_front(study, metrics)]
    )
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


def _rivals(study: Study, metrics: Sequence[str]) -> list[tuple[tuple[float, ...], RunRecord]]:
    """The metrics and the record of every run that has them all, and finite."""
    found = []
    for run in study.records:
        costs = [run.metrics.get(name) for name in metrics]
        finite = [cost for cost in costs if cost is not None and math.isfinite(cost)]
        if len(finite) == len(costs):
            found.append((tuple(finite), run))
    return found
