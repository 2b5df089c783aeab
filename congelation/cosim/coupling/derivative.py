"""Inputs as value plus derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import AdaptiveStepper, Coupling
from congelation.cosim.coupling.ends import Ends
from congelation.cosim.coupling.polynomial import hermite
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.states import Checkpoint
from congelation.errors import InvalidInput

__all__ = ["Derivative"]

Floats = npt.NDArray[np.float64]

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
        self._cubic = ensemble.inputs.order == 3
        self._ahead = [
            np.array([sequential and k.source < k.target == m for k in ensemble.inputs.links], bool)
            for m in range(len(ensemble.slaves))
        ]
        self._interpolates = [bool(mask.any()) for mask in self._ahead]
        self._calls_per_sweep = ensemble.calls_per_sweep
        self._error = 0.0
        self._worst = 0
        self.sweeps = 0
        self.estimated_error = 0.0

    def start(self, time: float) -> None:
        self._ends.start(time)
        self._is_saved = False

    def advance(self, time: float, end: float) -> None:
        self._step(time, end)
        self.accept()

    def attempt(self, time: float, end: float) -> float:
        if self._checkpoint is not None and not self._is_saved:
            self._checkpoint.save()
            self._is_saved = True
        self._step(time, end)
        return self._error

    def _step(self, time: float, end: float) -> None:
        ensemble, ends = self._ensemble, self._ends
        length = end - time
        ends.open(end)
        ensemble.inputs.C[:2] = ends.w[:2]
        ensemble.inputs.C[2:] = 0.0
        for m, slave in enumerate(ensemble.slaves):
            if self._interpolates[m]:
                self._interpolate(self._ahead[m], length)
            ensemble.inputs.write[m]()
            slave.step(time, length, self._checkpoint is None)
            if self._sequential:
                ensemble.outputs.read[m]()
        if not self._sequential:
            ensemble.outputs.read_all()
        if self._exchanges:
            self._exchange.run(end)
        self.sweeps += 1
        self._estimate(length)

    def _interpolate(self, links: npt.NDArray[np.bool_], length: float) -> None:
        """Between both ends of the step: the sources of these links have stepped already."""
        ends, C = self._ends, self._ensemble.inputs.C
        ends.read()
        ends.w[2:] = ends.new
        np.copyto(C[1], (ends.new[0] - ends.w[0]) / length, where=links & ~self._cubic)
        np.copyto(C, hermite(length) @ ends.w, where=links & self._cubic)

    def _estimate(self, length: float) -> None:
        ends = self._ends
        ends.read()
        if ends.new.size:
            distance = np.abs(ends.w[0] + length * ends.w[1] - ends.new[0])
            size = self._ensemble.inputs.nominal + np.abs(ends.new[0])
            distance /= size
            self._worst = int(distance.argmax())
            self._error = float(distance[self._worst])

    def accept(self) -> None:
        self._ends.close()
        self._is_saved = False
        self.estimated_error = max(self.estimated_error, self._error)
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
        saved = self._checkpoint.calls if self._checkpoint is not None else 0
        self.calls = self.sweeps * self._calls_per_sweep + self._exchange.calls + saved
