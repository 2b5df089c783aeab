"""Held inputs in the compiled loop."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.compiled.base import Compiled
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.recording import Rows

__all__ = ["CompiledHeld"]

Floats = npt.NDArray[np.float64]


class CompiledHeld(Compiled):
    """`jacobi`, and with `sequential` `gauss_seidel`, compiled."""

    def __init__(
        self,
        ensemble: Ensemble,
        rows: Sequence[Rows],
        exchange: Exchange,
        *,
        sequential: bool,
    ) -> None:
        super().__init__(ensemble, rows, exchange, False, np.inf)
        self._sequential = sequential

    def run(self, time: float, ends: Floats) -> int:
        """Step from `time` to each of the points `ends`.

        Returns
        -------
        int
            DONE, FULL, or NOT_FINITE or REFUSED in the step that was the last one.
        """
        ends = np.ascontiguousarray(ends)
        before = self.ensemble.Y[self.ensemble.source]
        return self.called(
            self.library.run_held,
            len(ends),
            ctypes.c_int(self._sequential),
            ctypes.c_double(time),
            ctypes.c_void_p(ends.ctypes.data),
            ctypes.c_long(len(ends)),
            ctypes.c_void_p(before.ctypes.data),
        )
