"""The metrics of a run: of all its communication points, whichever rows are kept of it.

Those of the closed loop are declared in `congelation.scenario.metrics`, which reads scenarios and
knows no loop; their functions are here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, final

import numpy as np
import numpy.typing as npt

from congelation.cosim.sinks import Memory, Sink
from congelation.errors import CongelationError
from congelation.results.record import Trajectory
from congelation.scenario.metrics import metric, norm
from congelation.scenario.parts import Case, MetricSpec

if TYPE_CHECKING:
    from congelation.verify.along_run import Along

__all__ = ["LOOP_METRICS", "Points", "judged", "measure", "unresolved"]

Floats = npt.NDArray[np.float64]


@final
class Points(Sink):
    """Keeps every communication point of a run, for its metrics.

    Parameters
    ----------
    wanted : sequence of str or None
        The columns that metrics are of; None: all that are recorded.
    """

    def __init__(self, wanted: Sequence[str] | None) -> None:
        self._wanted = wanted
        self._columns: tuple[str, ...] = ()
        self._picked: list[int] = []
        self._kept = Memory()

    def open(self, columns: Sequence[str]) -> None:
        """Find the columns."""
        self._columns = tuple(columns[1:] if self._wanted is None else self._wanted)
        self._picked = [columns.index(name) for name in ("time", *self._columns)]
        self._kept.open(["time", *self._columns])

    def write(self, block: Floats) -> None:
        """Keep these columns of a block."""
        self._kept.write(block[:, self._picked])

    def times(self) -> Floats:
        """When the points were, shape (N,)."""
        return self._kept.rows()[:, 0]

    def with_rows(self, kept: Trajectory) -> Trajectory:
        """The points, and between them the rows that are kept.

        Where an output interval is shorter than the steps, peaks lie between two points.
        """
        points = self._kept.rows()
        rows = np.column_stack([kept.time, kept.select(self._columns)])
        every = np.concatenate([points, rows])
        _, first = np.unique(every[:, 0], return_index=True)  # a point, where both are there
        chosen = every[first]
        return Trajectory(chosen[:, 0], self._columns, chosen[:, 1:], kept.units)


LoopMetric = Callable[[Case, Floats, Sequence[str], Floats], float]
"""A number of a run, from its case, times, columns and values, shapes (N,), (N, M)."""


def _along(part: Callable[[Along], float], *, integrated: bool = False) -> LoopMetric:
    """A metric that is a part of the certificate along the run."""

    def measured(case: Case, time: Floats, columns: Sequence[str], values: Floats) -> float:
        # Here, as it brings CasADi, whose import the workers of other studies do without.
        from congelation.verify.along_run import MOST_INTEGRATED, MOST_ROWS, along

        most = MOST_INTEGRATED if integrated else MOST_ROWS
        return part(along(case, time, columns, values, most))

    return measured


def _deviation(case: Case, time: Floats, columns: Sequence[str], values: Floats) -> float:
    """The largest distance from the monolithic solution, relative to a variable's peak."""
    from congelation.verify.reference import compare, reference  # here, as above

    found = compare(reference(case), Trajectory(time, tuple(columns), values, {}))
    return max(entry.relative for entry in found)


LOOP_METRICS: Mapping[str, LoopMetric] = {
    "lyapunov": _along(lambda found: found.worst),
    "lyapunov_share": _along(lambda found: found.share, integrated=True),
    "ultimate_bound": _along(lambda found: found.ultimate),
    "ultimate_share": _along(lambda found: found.ultimate_share),
    "deviation": _deviation,
}
"""The functions of the metrics that are declared to be of the loop, by name."""


def measure(
    specs: Sequence[MetricSpec], case: Case, trajectory: Trajectory
) -> tuple[Mapping[str, float | None], tuple[str, ...]]:
    """The metrics of a run that reached its stop time.

    Returns
    -------
    values : mapping
        By name; None where a metric has no answer, or its function fails.
    failed : tuple of str
        A line for each function that failed, as one that somebody else wrote may.

    Raises
    ------
    CongelationError
        If a metric cannot be of such a run.
    """
    groups = {
        of: trajectory.select(trajectory.group(of))
        for of in dict.fromkeys(spec.of for spec in specs if not metric(spec.metric).loop)
    }
    values: dict[str, float | None] = {}
    failed = []
    for spec in specs:
        values[spec.name] = None
        try:
            values[spec.name] = _value(spec, case, trajectory, groups)
        except CongelationError:
            raise
        except Exception as error:  # whatever it is, the other metrics are kept
            failed.append(f"metrics.{spec.name} ({spec.metric}): {type(error).__name__}: {error}")
    return values, tuple(failed)


LIMITS: Mapping[str, float] = {
    "lyapunov": 0.0,
    "lyapunov_share": 1.0,
    "ultimate_bound": math.inf,
    "ultimate_share": 1.0,
}
"""The metrics of the certificate, and up to what value they say that it holds."""

ROUNDING = 1e-9
"""What a metric of the certificate may be above its limit (`congelation.scenario.metrics`)."""


def judged(
    specs: Sequence[MetricSpec], case: Case, values: Mapping[str, float | None]
) -> tuple[Mapping[str, float | None], tuple[str, ...]]:
    """The metrics without those that say that the certificate holds where it promises nothing.

    Where a run breaks an assumption of the theorem, such values are left out; a value that says
    that the certificate is violated is kept.

    Returns
    -------
    values : mapping
        By name; None where a metric has no answer.
    lines : tuple of str
        Why metrics were left out.
    """
    claims = [
        spec.name
        for spec in specs
        if spec.metric in LIMITS
        and (value := values[spec.name]) is not None
        and value <= LIMITS[spec.metric] + ROUNDING
    ]
    if not claims:
        return values, ()
    from congelation.verify.scenario_assumptions import case_assumptions  # brings CasADi

    broken = [remark for remark in case_assumptions(case) if remark.broken]
    if not broken:
        return values, ()
    line = f"No {', '.join(claims)}, as an assumption of the theorem is broken: {broken[0]}."
    return {**values, **dict.fromkeys(claims)}, (line,)


UNRESOLVED = 0.2
"""How far, in the mean, every second point may lie off the line between its neighbours, as a share
of the signal: for a sine, ten points in a period."""


def unresolved(specs: Sequence[MetricSpec], trajectory: Trajectory) -> Iterator[str]:
    """A line for each integral whose points are too far apart for it."""
    time = trajectory.time
    if len(time) < 3:
        return
    odd = np.arange(1, len(time) - 1, 2)
    widths = (time[2:] - time[:-2])[odd - 1]
    shares = ((time[1:-1] - time[:-2])[odd - 1] / widths)[:, None]
    for spec in specs:
        if not metric(spec.metric).integral:
            continue
        values = trajectory.select(trajectory.group(spec.of))
        line = (1.0 - shares) * values[odd - 1] + shares * values[odd + 1]
        off = float(widths @ norm(values[odd] - line))
        if off > UNRESOLVED * float(widths @ norm(values[odd])):
            yield (
                f"The points are too far apart for metric {spec.name}, as the signal turns between "
                "them; give an output_interval or a shorter step."
            )


def _value(
    spec: MetricSpec, case: Case, trajectory: Trajectory, groups: Mapping[str, Floats]
) -> float | None:
    found = metric(spec.metric)
    time, columns = trajectory.time, trajectory.columns
    value: float | None
    if found.loop:
        function = LOOP_METRICS.get(found.name) or found.function
        value = function(case, time, columns, trajectory.values, **spec.options)
    else:
        value = found.function(time, groups[spec.of], **spec.options)
    return None if value is None or math.isnan(value) else value
