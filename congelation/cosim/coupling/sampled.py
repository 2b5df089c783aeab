"""Connections sampled and held, as digital controllers see them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from congelation.cosim.coupling.base import Coupling, Stepper, refuse_tolerance
from congelation.cosim.coupling.monitor import Watch
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.errors import InvalidInput

__all__ = ["Sampled"]

DELAYS = (0, 1)

TIME_ROUNDING = 1e-9
"""A point this near to a sampling instant, in sample times, is taken for it."""


@dataclass(frozen=True)
class Sampled(Coupling):
    """All connections are sampled at t_0 + k T, together, and held in between.

    The sample time T is a property of the system under study, not of the computation: the
    communication step only says where rows are recorded, and may be finer or coarser.

    Parameters
    ----------
    sample_time : float
        T in seconds.
    delay : int
        0: at a sampling instant outputs that follow directly from inputs are computed with the new
        samples, so that a controller acts on them at once. 1: they act one sample later.
    """

    sample_time: float
    delay: int = 0
    name: ClassVar[str] = "sampled"
    needs_derivatives: ClassVar[bool] = False
    lands_on_events: ClassVar[bool] = False
    takes_tolerance: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise InvalidInput(f"sample_time {self.sample_time:g} must be positive, in seconds")
        if self.delay not in DELAYS:
            raise InvalidInput(f"delay {self.delay}: 0 or 1 samples are valid")

    @property
    def rolls_back(self) -> bool:
        """No step is repeated."""
        return False

    @property
    def periods(self) -> Mapping[str, float]:
        """The sample time."""
        return {"sample_time": self.sample_time}

    def stepper(self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None) -> Stepper:
        """This coupling at work."""
        refuse_tolerance(self, tolerance)
        return _SampledStepper(ensemble, exchange, self)


class _SampledStepper(Stepper):
    def __init__(self, ensemble: Ensemble, exchange: Exchange, coupling: Sampled) -> None:
        self._ensemble = ensemble
        self._exchange = exchange
        self._period = coupling.sample_time
        self._at_once = coupling.delay == 0
        self._first = 0.0
        self._samples = 0
        self._watch = Watch(ensemble, extrapolated=False)
        self.sweeps = self.calls = 0
        ensemble.latched = True

    def start(self, time: float) -> None:
        self._first = time
        self._samples = 1
        self._watch.held(time)

    def advance(self, time: float, end: float) -> None:
        while time < end:
            sample = self._first + self._samples * self._period
            near = TIME_ROUNDING * self._period
            until = end if sample > end - near else sample
            for slave in self._ensemble.slaves:
                slave.step(time, until - time)
            self._ensemble.outputs.read_all()
            self.sweeps += 1
            if sample <= until + near:
                self._sample(until)
            time = until

    def _sample(self, time: float) -> None:
        ensemble = self._ensemble
        self._samples += 1
        if self._at_once:
            self._exchange.run(time)
        else:
            ensemble.inputs.C[0] = ensemble.outputs.Y[ensemble.inputs.source]
            for write in ensemble.inputs.write:
                write()
            ensemble.copy_discrete()
            self.calls += sum(ensemble.inputs.write_calls)
        self._watch.held(time)

    def finish(self) -> None:
        self._watch.flush()
        self.estimated_error = self._watch.largest
        per_sweep = len(self._ensemble.slaves) + sum(self._ensemble.outputs.read_calls)
        self.calls += self.sweeps * per_sweep + self._exchange.calls
