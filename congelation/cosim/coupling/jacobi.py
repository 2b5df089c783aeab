"""Held inputs, all slaves at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from congelation.cosim.coupling.base import Coupling, Stepper, refuse_tolerance
from congelation.cosim.coupling.monitor import Watch
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange

__all__ = ["Jacobi"]


@dataclass(frozen=True)
class Jacobi(Coupling):
    """Every slave steps with the values that its inputs had at the step's start; then all outputs
    are read, and copied to the inputs.

    Order 1. It is what most co-simulation engines do, and what a sampled controller with a delay
    of one sample sees.
    """

    name: ClassVar[str] = "jacobi"
    needs_derivatives: ClassVar[bool] = False
    lands_on_events: ClassVar[bool] = False
    takes_tolerance: ClassVar[bool] = False

    @property
    def rolls_back(self) -> bool:
        """No step is repeated."""
        return False

    def stepper(self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None) -> Stepper:
        """This coupling at work."""
        refuse_tolerance(self, tolerance)
        return _JacobiStepper(ensemble)


class _JacobiStepper(Stepper):
    def __init__(self, ensemble: Ensemble) -> None:
        slaves = range(len(ensemble.slaves))
        self._ensemble = ensemble
        self._hold = [ensemble.inputs.hold[m] for m in slaves if ensemble.inputs.write_calls[m]]
        self._step = [slave.step for slave in ensemble.slaves]
        self._read = [ensemble.outputs.read[m] for m in slaves if ensemble.outputs.read_calls[m]]
        self._discrete = bool(ensemble.system.discrete_links)
        self._calls_per_sweep = len(self._hold) + len(self._step) + sum(ensemble.outputs.read_calls)
        self._watch = Watch(ensemble, extrapolated=False)
        self.sweeps = 0

    def start(self, time: float) -> None:
        self._watch.held(time)

    def advance(self, time: float, end: float) -> None:
        length = end - time
        for hold in self._hold:
            hold()
        if self._discrete:
            self._ensemble.copy_discrete()
        for step in self._step:
            step(time, length)
        for read in self._read:
            read()
        self._watch.held(end)
        self.sweeps += 1

    def finish(self) -> None:
        self._watch.flush()
        self.estimated_error = self._watch.largest
        self.calls = self.sweeps * self._calls_per_sweep
