"""What is known of a run: its row, its trajectory, and the study they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Row", "Study", "Trajectory", "metrics_of", "settings_of"]

Row = Mapping[str, object]
"""The columns of a run."""


def settings_of(row: Row) -> dict[str, object]:
    """The varied settings of a row: its columns between `variant` and `status`."""
    return _between(row, "variant", "status")


def metrics_of(row: Row) -> dict[str, object]:
    """The metrics of a row: its columns between `message` and `macro_steps`."""
    return _between(row, "message", "macro_steps")


def _between(row: Row, first: str, last: str) -> dict[str, object]:
    names = list(row)
    return {name: row[name] for name in names[names.index(first) + 1 : names.index(last)]}


@dataclass(frozen=True)
class Trajectory:
    """A recorded run: row k of `values` belongs to ``time[k]``.

    Parameters
    ----------
    time : numpy.ndarray
        Shape (N,), in seconds.
    columns : tuple of str
        M names ``component.variable``.
    values : numpy.ndarray
        Shape (N, M).
    units : mapping
        Unit of each column; a missing or empty one is dimensionless.
    """

    time: npt.NDArray[np.float64]
    columns: tuple[str, ...]
    values: npt.NDArray[np.float64]
    units: Mapping[str, str]

    def group(self, name: str) -> tuple[str, ...]:
        """Columns called `name` or ``name[..]``, in order; ``plant.x`` is all of the vector x."""
        return tuple(c for c in self.columns if c == name or c.startswith(f"{name}["))

    def select(self, columns: Sequence[str]) -> npt.NDArray[np.float64]:
        """The values of some columns, shape (N, len(columns))."""
        return self.values[:, [self.columns.index(c) for c in columns]]


@dataclass(frozen=True)
class Study:
    """What a result directory holds: its rows, and the study they belong to.

    Parameters
    ----------
    rows : tuple of mapping
        One per run; every row has every column, None where it does not apply.
    about : mapping
        Title, scenario text, figures, metric definitions and versions, as they were stored.
    """

    rows: tuple[dict[str, Any], ...]
    about: Mapping[str, Any]
