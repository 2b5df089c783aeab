"""Held inputs, one slave after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from congelation.cosim.coupling.base import Coupling, Stepper, refuse_tolerance
from congelation.cosim.coupling.monitor import Watch
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange

__all__ = ["GaussSeidel"]


@dataclass(frozen=True)
class GaussSeidel(Coupling):
    """Slaves step in the declared order of the components, each with its inputs held at the newest
    values there are: those at the end of the step from components before it, those at the start
    from itself and the ones after it.

    Order 1, with a smaller error than `jacobi`.
    """

    name: ClassVar[str] = "gauss_seidel"
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
        return _GaussSeidelStepper(ensemble)


class _GaussSeidelStepper(Stepper):
    def __init__(self, ensemble: Ensemble) -> None:
        self._ensemble = ensemble
        self._slaves = [
            (ensemble.inputs.hold[m], slave.step, ensemble.outputs.read[m])
            for m, slave in enumerate(ensemble.slaves)
        ]
        self._discrete = bool(ensemble.system.discrete_links)
        held = sum(map(bool, ensemble.inputs.write_calls))
        self._calls_per_sweep = held + len(self._slaves) + sum(ensemble.outputs.read_calls)
        self._watch = Watch(ensemble, extrapolated=False)
        self.sweeps = 0

    def start(self, time: float) -> None:
        self._watch.held(time)

    def advance(self, time: float, end: float) -> None:
        length = end - time
        for hold, step, read in self._slaves:
            hold()
            if self._discrete:
                self._ensemble.copy_discrete()
            step(time, length)
            read()
        self._watch.held(end)
        self.sweeps += 1

    def finish(self) -> None:
        self._watch.flush()
        self.estimated_error = self._watch.largest
        self.calls = self.sweeps * self._calls_per_sweep
