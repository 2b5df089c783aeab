"""Some runs of a sweep measured in a worker process, before the sweep begins."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from congelation.results.records import Row, Trajectory
from congelation.results.store import Store
from congelation.scenario.scenario import Experiment
from congelation.sweep.plan import Run
from congelation.sweep.workers import Task, Work, Worker, at_work

__all__ = ["Pilot", "pilot"]

FRACTIONS = (0.02, 0.2, 1.0)
"""Parts of a run that a pilot does, until one took `ENOUGH`."""
ENOUGH = 0.3
"""Seconds."""
LIMIT = 3.0
"""Seconds after which no further run is measured."""


@dataclass(frozen=True)
class Pilot:
    """What a run takes, by the mean over some: seconds, and bytes of the result directory."""

    runs: int
    seconds: float
    size: int


def pilot(shared: Work, tasks: Sequence[Task]) -> Pilot:
    """Measure runs, or as much of each as takes long enough to be measured; stores nothing.

    Ends early, with fewer of the tasks, when it has taken `LIMIT`.

    Raises
    ------
    CongelationError
        If a run cannot begin, or takes longer than it may.
    """
    end = time.monotonic() + LIMIT
    measured: list[Pilot] = []
    with at_work(shared) as worker, tempfile.TemporaryDirectory() as folder:
        first = _part(worker.run(tasks[0]), FRACTIONS[0])
        worker.timed(first, kept=False)  # loads the FMUs, which counts for no run
        for task in tasks:
            measured.append(_measure(worker, worker.run(task), Store(Path(folder))))
            if time.monotonic() > end:
                break
    runs = len(measured)
    seconds = sum(one.seconds for one in measured) / runs
    return Pilot(runs, seconds, round(sum(one.size for one in measured) / runs))


def _measure(worker: Worker, run: Run, store: Store) -> Pilot:
    shared = worker.shared
    for fraction in FRACTIONS:
        begin = time.perf_counter()
        row, trajectory = worker.timed(_part(run, fraction), kept=False)
        store.write(row, trajectory if shared.trajectories else None)
        seconds = time.perf_counter() - begin
        if seconds > ENOUGH:
            break
    size = store.part_file(run.run_id).stat().st_size
    if shared.trajectories:
        size += _extrapolated(store, row, trajectory, run.case.experiment, fraction)
    return Pilot(1, seconds / fraction, size)


def _extrapolated(
    store: Store, row: Row, part: Trajectory, experiment: Experiment, fraction: float
) -> int:
    """Bytes of the whole trajectory whose first part is stored."""
    file = store.trajectory_file(str(row["run_id"]))
    size = file.stat().st_size
    store.write(row, replace(part, time=part.time[:1], values=part.values[:1]))
    first = file.stat().st_size  # mostly what a file takes that has no rows
    known = len(part.time)
    rows = known / fraction
    if experiment.output_interval is not None:
        duration = experiment.stop_time - experiment.start_time
        rows = 1.0 + math.ceil(duration / experiment.output_interval)
    return round(first + (rows - 1.0) * (size - first) / max(known - 1, 1))


def _part(run: Run, fraction: float) -> Run:
    """The first part of a run."""
    experiment = run.case.experiment
    stop = experiment.start_time + fraction * (experiment.stop_time - experiment.start_time)
    return replace(run, case=replace(run.case, experiment=replace(experiment, stop_time=stop)))
