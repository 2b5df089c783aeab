"""Inputs as value plus derivative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import AdaptiveStepper, Coupling
from congelation.cosim.coupling.ends import Ends
from congelation.cosim.coupling.monitor import Watch
from congelation.cosim.coupling.polynomial import hermite
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.states import Checkpoint
from congelation.cosim.system import MAX_DERIVATIVE
from congelation.errors import InvalidInput

__all__ = ["Derivative"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SEQUENCES = ("gauss_seidel", "jacobi")

FIRST_CHANGE = 1e-2
"""Share of its size by which an input may change over the first step that is tried."""


@dataclass(frozen=True)
class Derivative(Coupling):
    """Inputs are extrapolated from their value and derivative at the step's start.

    Order 2. The derivative is the source's der(.) output, or that of fmi2GetRealOutputDerivatives,
    or else that of the polynomial through the last values.

    Parameters
    ----------
    sequence : str
        "gauss_seidel": slaves step in the declared order, and the inputs that come from a slave
        which has already stepped are interpolated between both ends of the step instead.
        "jacobi": all inputs are extrapolated, and after the step outputs and inputs are made to
        agree in the order of the declared dependencies.
    """

    sequence: str = "gauss_seidel"
    name: ClassVar[str] = "derivative"
    needs_derivatives: ClassVar[bool] = True
    lands_on_events: ClassVar[bool] = True
    takes_tolerance: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.sequence not in SEQUENCES:
            raise InvalidInput(f"sequence '{self.sequence}'; valid: {', '.join(SEQUENCES)}")

    @property
    def rolls_back(self) -> bool:
        """No step is repeated."""
        return False

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> AdaptiveStepper:
        """This coupling at work."""
        checkpoint = Checkpoint(ensemble.slaves) if tolerance is not None else None
        return _DerivativeStepper(ensemble, exchange, self.sequence == "gauss_seidel", checkpoint)


class _Interpolation:
    """Polynomials between both ends of a step.

    Parameters
    ----------
    cubic, linear : boolean arrays, shape (L,)
        Links that take three derivatives, and those that take fewer.
    """

    def __init__(self, cubic: Mask, linear: Mask) -> None:
        self._cubic, self._linear = cubic, linear
        self._has_cubic, self._has_linear = bool(cubic.any()), bool(linear.any())

    def fill(self, C: Floats, w: Floats, length: float) -> None:
        """Set the columns of these links in C, from w = (v0, d0, v1, d1)."""
        if self._has_cubic:
            np.copyto(C, hermite(length).dot(w), where=self._cubic)
        if self._has_linear:
            np.copyto(C[1], (w[2] - w[0]) / length, where=self._linear)


class _DerivativeStepper(AdaptiveStepper):
    order = 2

    def __init__(
        self,
        ensemble: Ensemble,
        exchange: Exchange,
        sequential: bool,
        checkpoint: Checkpoint | None,
    ) -> None:
        self._ensemble = ensemble
        self._exchange = exchange
        self._sequential = sequential
        self._checkpoint = checkpoint
        self._is_saved = False
        self._ends = Ends(ensemble)
        # Loops are solved at every communication point; for plain feedthrough the sequence of
        # the slaves already carries the values over.
        self._exchanges = bool(exchange.loops) or (exchange.feedthrough and not sequential)
        self._ahead = [
            self._interpolation([k.source < k.target == m for k in ensemble.inputs.links])
            for m in range(len(ensemble.slaves))
        ]
        self._watch = Watch(ensemble, extrapolated=True)
        self._calls_per_sweep = ensemble.calls_per_sweep
        self._error = 0.0
        self._worst = 0
        self.sweeps = 0
        self.estimated_error = 0.0

    def _interpolation(self, stepped: Sequence[bool]) -> _Interpolation | None:
        """How to interpolate links whose sources have stepped already."""
        if not self._sequential or not any(stepped):
            return None
        cubic = self._ensemble.inputs.order == MAX_DERIVATIVE
        return _Interpolation(np.array(stepped) & cubic, np.array(stepped) & ~cubic)

    def start(self, time: float) -> None:
        self._ends.start(time)
        self._is_saved = False
        self._watch.extrapolated(time, self._ends.w[:2])

    def advance(self, time: float, end: float) -> None:
        self._step(time, end)
        self.accept()

    def attempt(self, time: float, end: float) -> float:
        if self._checkpoint is not None and not self._is_saved:
            self._checkpoint.save()
            self._is_saved = True
        self._step(time, end)
        ends = self._ends
        if ends.new.size:
            distance = np.abs(ends.w[0] + (end - time) * ends.w[1] - ends.new[0])
            relative = ends.relative(distance)
            self._worst = int(relative.argmax())
            self._error = float(relative[self._worst])
        return self._error

    def _step(self, time: float, end: float) -> None:
        ensemble, ends, C = self._ensemble, self._ends, self._ensemble.inputs.C
        length = end - time
        ends.open(time, end)
        C[:2] = ends.w[:2]
        C[2:] = 0.0
        for m, slave in enumerate(ensemble.slaves):
            ahead = self._ahead[m]
            if ahead is not None:
                ends.read()
                ends.set_ends(ends.new)
                ahead.fill(C, ends.w, length)
            ensemble.inputs.write[m]()
            slave.step(time, length, self._checkpoint is None)
            if self._sequential:
                ensemble.outputs.read[m]()
        if not self._sequential:
            ensemble.outputs.read_all()
        if self._exchanges:
            self._exchange.run(end)
        ends.read()
        self.sweeps += 1

    def accept(self) -> None:
        self._ends.close()
        self._is_saved = False
        self._watch.extrapolated(self._ends.end_time, self._ends.w[:2])
        if self._ensemble.system.discrete_links:
            self._ensemble.copy_discrete()

    def reject(self) -> None:
        if self._checkpoint is not None:
            self._checkpoint.restore()

    def worst(self) -> str:
        return self._ensemble.inputs.links[self._worst].name

    def first_step(self) -> float:
        return self._ends.time_scale() * FIRST_CHANGE

    def finish(self) -> None:
        self._watch.flush()
        self.estimated_error = self._watch.largest
        saved = self._checkpoint.calls if self._checkpoint is not None else 0
        self.calls = self.sweeps * self._calls_per_sweep + self._exchange.calls + saved
