"""What a sweep will take, from one run measured beforehand."""

from __future__ import annotations

import math
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass

from congelation.errors import CongelationError
from congelation.study.batch import Plan
from congelation.study.executors import Workers
from congelation.study.workers import Pilot, pilot

__all__ = ["Estimate", "estimate"]

BLOCK = 4096
"""Bytes: file systems give space in such pieces."""


@dataclass(frozen=True)
class Estimate:
    """The measured run, and what follows from it for all that are missing.

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
            f"about {_duration(self.seconds)} and {_size(self.size)}, judging by one pilot run of "
            f"{self.pilot.seconds:.2g} s"
        )


def estimate(plan: Plan, workers: Workers) -> Estimate:
    """Measure the run in the middle of those missing, and multiply.

    Raises
    ------
    CongelationError
        If there is nothing to measure, or that run cannot begin or kills its worker.
    """
    if not plan.missing:
        raise CongelationError("nothing is missing")
    task = plan.missing[len(plan.missing) // 2]
    with workers.open() as crew:
        try:
            measured = crew.executor.submit(pilot, plan.shared, task).result()
        except BrokenExecutor as error:
            raise CongelationError("the pilot run killed its worker") from error
        except CongelationError as error:
            raise CongelationError(f"of the pilot run: {error}") from error
        size = crew.size
    runs = len(plan.missing)
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
