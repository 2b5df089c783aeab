"""Recording: rows into preallocated blocks, one block at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

__all__ = ["BLOCK_ROWS", "Recorder"]

Floats = npt.NDArray[np.float64]

BLOCK_ROWS = 8192
"""Rows per block: large enough that starting one costs nothing, small in memory."""


class Recorder:
    """Takes rows (time, values..) and hands over full blocks.

    Parameters
    ----------
    width : int
        Number of values per row, M.
    flush : callable
        Takes each full block, shape (n, 1 + M), which it may keep; the last one is shorter.
    """

    def __init__(self, width: int, flush: Callable[[Floats], None]) -> None:
        self._width = width
        self._flush = flush
        self._rows = 0
        self._block = np.empty((BLOCK_ROWS, 1 + width))

    def row(self, time: float) -> Floats:
        """A new row for `time`; its values, shape (M,), are for the caller to fill."""
        if self._rows == BLOCK_ROWS:
            self._flush(self._block)
            self._block = np.empty((BLOCK_ROWS, 1 + self._width))
            self._rows = 0
        row: Floats = self._block[self._rows]
        self._rows += 1
        row[0] = time
        return row[1:]

    def finish(self) -> None:
        """Hand over what is left."""
        self._flush(self._block[: self._rows])
        self._rows = 0
