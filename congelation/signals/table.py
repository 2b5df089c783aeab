"""Values at given times, from a list or a CSV file."""

from __future__ import annotations

import math
import os
import reprlib
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import ClassVar

from .checks import ProfileError, boolean, checked, shown
from .segment import Segment
from .terms import Term

__all__ = ["Table"]


def _table_fault(times: Sequence[float], values: Sequence[float]) -> tuple[int, str] | None:
    """The first row (from 0) that cannot stand, and why."""
    for i, time in enumerate(times):
        if i and not times[i - 1] < time:
            return i, f"time {time!r} does not come after {times[i - 1]!r}"
        if i and math.isinf((values[i] - values[i - 1]) / (time - times[i - 1])):
            return i, f"the step from {values[i - 1]!r} to {values[i]!r} is beyond double precision"
    return None


@dataclass(frozen=True)
class Table(Term):
    """Values at given times, held from each time to the next, or joined by straight lines.

    Before the first time it has the first value, after the last time the last one. Each time is
    an event.

    Parameters
    ----------
    times, values : sequence of float
        Equally long, at least one; the times strictly increasing, s.
    linear : bool
        False: piecewise constant. True: piecewise linear.
    file : str
        The file they came from, if any; needed to write the table as flat parameters.
    """

    kind: ClassVar[str] = "table"
    times: tuple[float, ...]
    values: tuple[float, ...]
    linear: bool = False
    file: str = ""

    def __post_init__(self) -> None:
        for name in ("times", "values"):
            given = getattr(self, name)
            if isinstance(given, str) or not isinstance(given, Sequence) or not given:
                raise ProfileError(
                    f"table.{name} = {shown(given)}: must be a list of at least one number"
                )
            meta = {"type": "Real", "positive": False}
            row = tuple(checked(v, meta, f"table.{name}[{i}]") for i, v in enumerate(given, 1))
            object.__setattr__(self, name, row)
        boolean(self.linear, "table.linear")
        if len(self.times) != len(self.values):
            raise ProfileError(
                f"table: times has {len(self.times)} entries, values {len(self.values)}; "
                "give one value per time"
            )
        fault = _table_fault(self.times, self.values)
        if fault:
            raise ProfileError(f"table.times[{fault[0] + 1}]: {fault[1]}")

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], linear: bool = False) -> Table:
        """Read a table from two columns ``time,value``.

        The first line may be a header; what follows a # is a comment.

        Raises
        ------
        ProfileError
            Naming the file and the line.
        """
        name = os.fspath(path)
        try:
            with open(name, encoding="utf-8-sig") as stream:
                lines = stream.read().splitlines()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not a text file in UTF-8"
            raise ProfileError(f"table file {name!r}: {reason}") from None
        times, values, numbers_of_lines = [], [], []
        header_possible = True
        for number, line in enumerate(lines, 1):
            text = line.split("#", 1)[0].strip()
            if not text:
                continue
            row = [_parsed(cell) for cell in text.split(",")]
            if len(row) == 2 and all(math.isfinite(v) for v in row):
                times.append(row[0])
                values.append(row[1])
                numbers_of_lines.append(number)
            elif not (header_possible and len(row) == 2 and all(math.isnan(v) for v in row)):
                raise ProfileError(
                    f"table file {name!r}, line {number}: {reprlib.repr(text)} is not time,value "
                    "(two finite numbers)"
                )
            header_possible = False
        if not times:
            raise ProfileError(f"table file {name!r}: no rows; expected two columns time,value")
        fault = _table_fault(times, values)
        if fault:
            raise ProfileError(
                f"table file {name!r}, line {numbers_of_lines[fault[0]]}: {fault[1]}"
            )
        return cls(tuple(times), tuple(values), linear, name)

    def segment(self, t: float) -> Segment:
        """The piece between the times around `t`."""
        times, values = self.times, self.values
        n = bisect_right(times, t)
        end = times[n] if n < len(times) else inf
        if n == 0:
            return Segment(-inf, end, values[0])
        if self.linear and n < len(times):
            slope = (values[n] - values[n - 1]) / (end - times[n - 1])
            return Segment(times[n - 1], end, values[n - 1], slope=slope)
        return Segment(times[n - 1], end, values[n - 1])

    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value."""
        return min(self.values), max(self.values)


def _parsed(cell: str) -> float:
    """The number in a cell of a CSV file, NaN if it is none."""
    try:
        return float(cell)
    except ValueError:
        return math.nan
