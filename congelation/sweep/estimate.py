"""What a sweep will take, from a few of its runs measured beforehand."""

from __future__ import annotations

import math
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass

from congelation.errors import CongelationError
from congelation.sweep.executors import Workers
from congelation.sweep.pilot import Pilot, pilot
from congelation.sweep.sweep_plan import Plan

__all__ = ["Estimate", "estimate"]

PILOTS = 5
"""Runs that are measured: one alone is wrong by a factor of three where runs differ."""

BLOCK = 4096
"""Bytes: file systems give space in such pieces."""


@dataclass(frozen=True)
class Estimate:
    """The measured runs, and what follows from it for all that are missing.

    Parameters
    ----------
    pilot : Pilot
    seconds : float
        Of all missing runs, on all workers.
    size : int
        Bytes of all missing runs.
    """

    pilot: Pilot
    seconds: float
    size: int

    def __str__(self) -> str:
        return (
            f"about {_duration(self.seconds)} and {_size(self.size)}, judging by "
            f"{self.pilot.runs} pilot runs of {self.pilot.seconds:.2g} s on average"
        )


def estimate(plan: Plan, workers: Workers) -> Estimate:
    """Measure a few of the missing runs, far apart in the sweep, and multiply.

    Raises
    ------
    CongelationError
        If there is nothing to measure, or a run cannot begin, takes longer than it may or kills
        its worker.
    """
    if not plan.missing:
        raise CongelationError("nothing is missing")
    runs = len(plan.missing)
    places = sorted({int((k + 0.5) * runs / PILOTS) for k in range(PILOTS)})
    tasks = [plan.missing[place] for place in places]
    with workers.open() as crew:
        try:
            measured = crew.executor.submit(pilot, plan.shared, tasks).result()
        except BrokenExecutor as error:
            raise CongelationError("a pilot run did not return, or killed its worker") from error
        except CongelationError as error:
            raise CongelationError(f"of a pilot run: {error}") from error
        size = crew.size
    rounds = math.ceil(runs / size)
    on_disk = BLOCK * math.ceil(measured.size / BLOCK)
    return Estimate(measured, rounds * measured.seconds, runs * on_disk)


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
