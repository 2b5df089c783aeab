"""What a study will take, from a few of its runs measured beforehand."""

from __future__ import annotations

import io
import math
import time
from dataclasses import dataclass, replace

import pyarrow.parquet as pq

from congelation.errors import CongelationError
from congelation.scenario.scenario import Experiment
from congelation.sweep.execute import Task
from congelation.sweep.plan import Plan
from congelation.sweep.workers import Finished, Lost, Progress, Workers

__all__ = ["Estimate", "estimate"]

PILOTS = 5
"""Runs that are measured: one alone is wrong by a factor of three where runs differ."""
FRACTIONS = (0.02, 0.2, 1.0)
"""Parts of a run that are done, until one took `ENOUGH`."""
ENOUGH = 0.3
"""Seconds."""
LIMIT = 3.0
"""Seconds after which no further run is measured."""

VALUE_BYTES = 16
"""What a value of a record takes in runs.sqlite and runs.parquet together."""
BLOCK = 4096
"""Bytes: file systems give space in such pieces."""


@dataclass(frozen=True)
class Estimate:
    """What all missing runs take, judging by some of them.

    Parameters
    ----------
    pilots : int
        Runs that were measured.
    each : float
        Seconds of one of them on average.
    seconds : float
        Of all missing runs, on all workers.
    size : int
        Bytes of all missing runs.
    """

    pilots: int
    each: float
    seconds: float
    size: int

    def __str__(self) -> str:
        return (
            f"about {_duration(self.seconds)} and {_size(self.size)}, judging by "
            f"{self.pilots} pilot runs of {self.each:.2g} s on average"
        )


def estimate(plan: Plan, workers: Workers) -> Estimate:
    """Measure a few of the missing runs, far apart in the study, and multiply.

    Nothing is stored. The first part of a run that takes long enough stands for all of it.

    Raises
    ------
    CongelationError
        If there is nothing to measure, or a run takes longer than it may or ends its worker.
    """
    if not plan.missing:
        raise CongelationError("nothing is missing")
    count = len(plan.missing)
    places = sorted({plan.missing[int((k + 0.5) * count / PILOTS)] for k in range(PILOTS)})
    end = time.monotonic() + LIMIT
    seconds: list[float] = []
    sizes: list[float] = []
    job = replace(plan.job, folder=None)
    with workers.running(job):
        for task in plan.tasks(places):
            if not seconds:
                _measure(workers, replace(task, fraction=FRACTIONS[0]))  # it loads the FMUs
            for fraction in FRACTIONS:
                begin = time.perf_counter()
                found = _measure(workers, replace(task, fraction=fraction))
                took = time.perf_counter() - begin
                if took > ENOUGH:
                    break
            seconds.append(took / fraction)
            row = VALUE_BYTES * len(plan.record(task, found.outcome).row())
            experiment = plan.scenario.case(task.settings).experiment
            sizes.append(row + _whole(experiment, found.trajectory, fraction))
            if time.monotonic() > end:
                break
    each = sum(seconds) / len(seconds)
    total = math.ceil(count / workers.size) * each
    return Estimate(len(seconds), each, total, round(count * sum(sizes) / len(sizes)))


def _measure(workers: Workers, task: Task) -> Finished:
    workers.submit([task])
    while True:
        for event in workers.events():
            if isinstance(event, Lost):
                raise CongelationError(f"a pilot run failed: {event.outcome.message}")
            if isinstance(event, Finished):
                return event
            if not isinstance(event, Progress):
                workers.submit([task])


def _whole(experiment: Experiment, part: bytes | None, fraction: float) -> int:
    """Bytes on disk of the whole trajectory whose first part is known."""
    if part is None:
        return 0

    metadata = pq.ParquetFile(io.BytesIO(part)).metadata
    known = max(metadata.num_rows, 1)
    rows = known / fraction
    if experiment.output_interval is not None:
        duration = experiment.stop_time - experiment.start_time
        rows = 1.0 + math.ceil(duration / experiment.output_interval)
    # What a file takes without rows stays the same.
    content: int = sum(
        metadata.row_group(k).column(c).total_compressed_size
        for k in range(metadata.num_row_groups)
        for c in range(metadata.num_columns)
    )
    size: float = len(part) + content * (rows / known - 1.0)
    return BLOCK * math.ceil(size / BLOCK)


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{max(seconds, 1.0):.2g} s"


def _size(size: float) -> str:
    for unit in ("kB", "MB", "GB"):
        size /= 1000.0
        if size < 1000.0:
            return f"{size:.3g} {unit}"
    return f"{size / 1000.0:.3g} TB"
