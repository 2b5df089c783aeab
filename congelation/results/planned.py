"""The runs of a plan as two arrays, so that a million of them are kept and compared in seconds."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["PlannedRuns"]

Numbers = npt.NDArray[np.int64]
Keys = npt.NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class PlannedRuns:
    """The runs of a plan, in the order of their keys.

    Parameters
    ----------
    keys : array, shape (N,)
        The run_ids as numbers of 64 bits, rising.
    numbers : array, shape (N,)
        The place of each in the plan.
    """

    keys: Keys
    numbers: Numbers

    @classmethod
    def of(cls, runs: Iterable[tuple[int, str]]) -> PlannedRuns:
        """The runs with these numbers and run_ids; a run_id that comes again is left out."""
        numbers, keys = array("q"), array("Q")
        for number, run_id in runs:
            numbers.append(number)
            keys.append(int(run_id, 16))
        found, first = np.unique(np.array(keys, np.uint64), return_index=True)
        return cls(found, np.array(numbers, np.int64)[first])

    @classmethod
    def from_bytes(cls, keys: bytes, numbers: bytes) -> PlannedRuns:
        """What `to_bytes` was made of."""
        return cls(np.frombuffer(keys, "<u8"), np.frombuffer(numbers, "<i8"))

    def to_bytes(self) -> tuple[bytes, bytes]:
        """Keys and numbers as bytes, the same on every machine."""
        return self.keys.astype("<u8").tobytes(), self.numbers.astype("<i8").tobytes()

    def __len__(self) -> int:
        return len(self.keys)

    def places(self, run_ids: Collection[str]) -> npt.NDArray[np.intp]:
        """Where these runs stand in the arrays; -1 for one that is not in the plan."""
        wanted = np.array([int(run_id, 16) for run_id in run_ids], np.uint64)
        if not len(self):
            return np.full(len(wanted), -1, np.intp)
        found = np.minimum(np.searchsorted(self.keys, wanted), len(self) - 1)
        return np.where(self.keys[found] == wanted, found, -1)
