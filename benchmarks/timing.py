"""Interleaved repetitions and their medians.

Times are those of the processor: on a machine that is shared, elapsed time also counts what others
do. Where a program keeps several threads busy at once, the elapsed time is shorter, and counts.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import TypeVar

__all__ = ["Stopwatch", "Timing", "interleaved", "median_ratio", "per_call"]

Key = TypeVar("Key", bound=Hashable)


class Stopwatch:
    """Started when it is made."""

    def __init__(self) -> None:
        self._elapsed, self._used = perf_counter(), process_time()

    def seconds(self) -> float:
        """Processor time since the start, in all threads, or elapsed time where that is less."""
        return min(perf_counter() - self._elapsed, process_time() - self._used)


@dataclass(frozen=True)
class Timing:
    """Repetitions of one measurement, in the order in which they were made.

    Parameters
    ----------
    values : tuple of float
        Seconds.
    """

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """The median, in seconds."""
        return statistics.median(self.values)

    @property
    def least(self) -> float:
        """The smallest."""
        return min(self.values)

    @property
    def most(self) -> float:
        """The largest."""
        return max(self.values)

    def per(self, count: int) -> Timing:
        """The same for one of `count` equal parts."""
        return Timing(tuple(value / count for value in self.values))


def interleaved(measurements: Mapping[Key, Callable[[], float]], rounds: int) -> dict[Key, Timing]:
    """Repeat all measurements in turn, A B C A B C .., so that all see the same machine.

    Parameters
    ----------
    measurements : mapping to callable
        Each makes one measurement, in seconds.
    rounds : int
        How often; one more round goes before, which is not counted.
    """
    values: dict[Key, list[float]] = {name: [] for name in measurements}
    for _ in range(rounds + 1):
        for name, measure in measurements.items():
            values[name].append(measure())
    return {name: Timing(tuple(found[1:])) for name, found in values.items()}


def median_ratio(slow: Timing, fast: Timing) -> float:
    """The median of the ratios within each round."""
    return statistics.median(a / b for a, b in zip(slow.values, fast.values, strict=True))


def per_call(function: Callable[[], object], calls: int) -> float:
    """Seconds per call, over so many calls one after the other."""
    watch = Stopwatch()
    for _ in range(calls):
        function()
    return watch.seconds() / calls
