"""Inputs as value plus derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import Coupling, Stepper
from congelation.cosim.coupling.polynomial import hermite
from congelation.cosim.ensemble import NO_DERIVATIVE, Ensemble
from congelation.cosim.exchange import Exchange
from congelation.errors import InvalidInput

__all__ = ["Derivative"]

Floats = npt.NDArray[np.float64]

SEQUENCES = ("gauss_seidel", "jacobi")


@dataclass(frozen=True)
class Derivative(Coupling):
    """Inputs are extrapolated from their value and derivative at the step's start.

    Order 2. The derivative is the source's der(.) output, or that of fmi2GetRealOutputDerivatives,
    or else the slope of the last two values.

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

    def stepper(self, ensemble: Ensemble, exchange: Exchange) -> Stepper:
        """This coupling at work."""
        return _DerivativeStepper(ensemble, exchange, self.sequence == "gauss_seidel")


class _DerivativeStepper(Stepper):
    def __init__(self, ensemble: Ensemble, exchange: Exchange, sequential: bool) -> None:
        self._ensemble = ensemble
        self._exchange = exchange
        self._sequential = sequential
        # Loops are solved at every communication point; for plain feedthrough the sequence of
        # the slaves already carries the values over.
        self._exchanges = bool(exchange.loops) or (exchange.feedthrough and not sequential)
        self._exact = ensemble.source_derivative != NO_DERIVATIVE
        self._from_history = not bool(self._exact.all())
        self._ahead = [
            np.array(
                [
                    k
                    for k in range(part.start, part.stop)
                    if sequential and ensemble.links[k].source < m
                ],
                np.intp,
            )
            for m, part in enumerate(ensemble.columns)
        ]
        # Rows v0, d0, v1, d1.
        self._w: Floats = np.zeros((4, len(ensemble.links)))
        self._error: Floats = np.zeros(len(ensemble.links))
        self.sweeps = 0
        self._calls_per_sweep = (
            sum(ensemble.write_calls) + len(ensemble.slaves) + sum(ensemble.read_calls)
        )
        self.estimated_error = 0.0

    def start(self, time: float) -> None:
        self._w[1] = 0.0
        self._take(self._w[0], self._w[1])

    def _take(self, values: Floats, derivatives: Floats) -> None:
        """The links' values, and their derivatives where the sources have them."""
        ensemble = self._ensemble
        ensemble.Y.take(ensemble.source, out=values, mode="clip")
        if self._from_history:
            derivatives[self._exact] = ensemble.Y[ensemble.source_derivative[self._exact]]
        else:
            ensemble.Y.take(ensemble.source_derivative, out=derivatives, mode="clip")

    def advance(self, time: float, end: float) -> None:
        length = end - time
        ensemble, w = self._ensemble, self._w
        ensemble.C[:2] = w[:2]
        ensemble.C[2:] = 0.0
        for m, slave in enumerate(ensemble.slaves):
            if self._ahead[m].size:
                self._interpolate(self._ahead[m], length)
            ensemble.write[m]()
            slave.step(time, length)
            if self._sequential:
                ensemble.read[m]()
        if not self._sequential:
            ensemble.read_all()
        if self._exchanges:
            self._exchange.run(end)
        elif ensemble.system.discrete_links:
            ensemble.copy_discrete()
        self._close(length)

    def _interpolate(self, links: npt.NDArray[np.intp], length: float) -> None:
        """Between both ends of the step: their sources have stepped already."""
        ensemble, w = self._ensemble, self._w
        self._take(w[2], w[3])
        if self._from_history:
            self._slopes(length)
        cubic = ensemble.order[links] == 3
        ensemble.C[1, links] = np.where(cubic, w[1, links], (w[2] - w[0])[links] / length)
        ensemble.C[2:, links] = np.where(cubic, (hermite(length) @ w[:, links])[2:], 0.0)

    def _slopes(self, length: float) -> None:
        self._w[3] = np.where(self._exact, self._w[3], (self._w[2] - self._w[0]) / length)

    def _close(self, length: float) -> None:
        """The end of this step is the start of the next."""
        w = self._w
        self._take(w[2], w[3])
        if self._from_history:
            self._slopes(length)
        np.multiply(w[1], length, out=self._error)
        np.add(self._error, w[0], out=self._error)
        np.subtract(self._error, w[2], out=self._error)
        np.abs(self._error, out=self._error)
        self._error /= self._ensemble.nominal + np.abs(w[2])
        if self._error.size:
            self.estimated_error = max(self.estimated_error, float(self._error.max()))
        w[:2] = w[2:]
        self.sweeps += 1

    def finish(self) -> None:
        self.calls = self.sweeps * self._calls_per_sweep + self._exchange.calls
