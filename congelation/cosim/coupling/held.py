"""Inputs held over the step: as most engines do (Jacobi, GaussSeidel), and as digital controllers
see them (Sampled).

Inputs are held at outputs, which Y holds, and no step is taken back, so that Jacobi and GaussSeidel
have no state of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from congelation.cosim.coupling.base import Coupling, Stepper, StepsOnce, Watch
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange, settle_discrete
from congelation.errors import InvalidInput

__all__ = ["GaussSeidel", "Jacobi", "Sampled"]


DELAYS = (0, 1)

TIME_ROUNDING = 1e-9
"""A point this near to a sampling instant, in sample times, is taken for it."""


class _HeldStepper(Stepper[None]):
    """Jacobi and GaussSeidel at work: the state is Y alone."""

    def __init__(self, ensemble: Ensemble) -> None:
        self._ensemble = ensemble
        self._Y, self._source = ensemble.Y, ensemble.source
        self._discrete = bool(ensemble.system.discrete_links)
        # Where outputs follow from inputs at once, rows hold those of the newest inputs.
        self._passes_on = self._discrete and ensemble.discrete_feedthrough
        self._watch = Watch(ensemble.nominal, extrapolated=False)
        self.iterations = 0
        held = sum(map(bool, ensemble.write_calls))
        self.calls_per_iteration = held + len(ensemble.slaves) + sum(ensemble.read_calls)

    def renew(self) -> None:
        super().renew()
        self._watch.clear()

    def start(self, time: float, before: None) -> None:
        self._Y.take(self._source, out=self._watch.row(time), mode="clip")

    def largest_error(self) -> float:
        return self._watch.largest()


@dataclass(frozen=True)
class Jacobi(StepsOnce):
    """Every slave steps with the values that its inputs had at the step's start; then all outputs
    are read, and copied to the inputs.

    Order 1. It is what most co-simulation engines do, and what a sampled controller with a delay
    of one sample sees.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, step=0.05, coupling=cg.Jacobi()).status.name
    'COMPLETED'
    """

    name: ClassVar[str] = "jacobi"

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> Stepper[None]:
        """This coupling at work."""
        return JacobiStepper(ensemble)


class JacobiStepper(_HeldStepper):
    """`jacobi` at work."""

    sequential = False

    def __init__(self, ensemble: Ensemble) -> None:
        super().__init__(ensemble)
        slaves = range(len(ensemble.slaves))
        self._inputs = ensemble.C[0]
        self._hold = [ensemble.hold[m] for m in slaves if ensemble.write_calls[m]]
        self._step = [slave.step for slave in ensemble.slaves]
        self._read = [ensemble.read[m] for m in slaves if ensemble.read_calls[m]]

    def advance(self, state: None, time: float, end: float) -> None:
        length = end - time
        self._Y.take(self._source, out=self._inputs, mode="clip")
        for hold in self._hold:
            hold()
        if self._discrete:
            settle_discrete(self._ensemble, time)
        for step in self._step:
            step(time, length)
        for read in self._read:
            read()
        if self._passes_on:
            settle_discrete(self._ensemble, end)
        self.iterations += 1
        self._Y.take(self._source, out=self._watch.row(end), mode="clip")


@dataclass(frozen=True)
class GaussSeidel(StepsOnce):
    """Slaves step in the declared order of the components, each with its inputs held at the newest
    values there are: those at the end of the step from components before it, those at the start
    from itself and the ones after it.

    Order 1, with a smaller error than `jacobi`.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, step=0.05, coupling=cg.GaussSeidel()).status.name
    'COMPLETED'
    """

    name: ClassVar[str] = "gauss_seidel"

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> Stepper[None]:
        """This coupling at work."""
        return GaussSeidelStepper(ensemble)


class GaussSeidelStepper(_HeldStepper):
    """`gauss_seidel` at work."""

    sequential = True

    def __init__(self, ensemble: Ensemble) -> None:
        super().__init__(ensemble)
        self._slaves = [
            # Where a slave's inputs stand in C, and their sources in Y.
            (ensemble.C[0, k], ensemble.source[k], ensemble.hold[m], slave.step, ensemble.read[m])
            for m, (slave, k) in enumerate(zip(ensemble.slaves, ensemble.columns, strict=True))
        ]

    def advance(self, state: None, time: float, end: float) -> None:
        length = end - time
        for inputs, source, hold, step, read in self._slaves:
            self._Y.take(source, out=inputs, mode="clip")
            hold()
            if self._discrete:
                settle_discrete(self._ensemble, end)
            step(time, length)
            read()
        if self._passes_on:
            settle_discrete(self._ensemble, end)
        self.iterations += 1
        self._Y.take(self._source, out=self._watch.row(end), mode="clip")


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

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> sampled = cg.Sampled(sample_time=0.1)
    >>> cg.simulate(system, stop_time=0.5, step=0.05, coupling=sampled).status.name
    'COMPLETED'
    """

    sample_time: float
    delay: int = 0
    name: ClassVar[str] = "sampled"
    latches: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
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

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> Stepper[Samples]:
        """This coupling at work."""
        return _SampledStepper(ensemble, exchange, self)


class Samples(NamedTuple):
    """The state of `sampled`; the values that are held stand in the FMUs.

    Parameters
    ----------
    first : float
        Time of the first sample.
    taken : int
        Samples taken so far.
    """

    first: float
    taken: int


class _SampledStepper(Stepper[Samples]):
    def __init__(self, ensemble: Ensemble, exchange: Exchange, coupling: Sampled) -> None:
        self._ensemble = ensemble
        self._exchange = exchange
        self._coupling = coupling
        self._watch = Watch(ensemble.nominal, extrapolated=False)
        self.iterations = 0
        self.calls_per_iteration = len(ensemble.slaves) + sum(ensemble.read_calls)

    def renew(self) -> None:
        super().renew()
        self._watch.clear()

    def start(self, time: float, before: Samples | None) -> Samples:
        ensemble = self._ensemble
        ensemble.Y.take(ensemble.source, out=self._watch.row(time), mode="clip")
        return Samples(time, 1)

    def advance(self, state: Samples, time: float, end: float) -> Samples:
        first, taken = state
        period = self._coupling.sample_time
        near = TIME_ROUNDING * period
        while time < end:
            sample = first + taken * period
            until = end if sample > end - near else sample
            for slave in self._ensemble.slaves:
                slave.step(time, until - time)
            self._ensemble.read_all()
            self.iterations += 1
            if sample <= until + near:
                self._sample(until)
                taken += 1
            time = until
        return Samples(first, taken)

    def _sample(self, time: float) -> None:
        """Give all inputs the values that their sources have now."""
        ensemble = self._ensemble
        if self._coupling.delay == 0:
            self._exchange.run(time)
        else:
            ensemble.Y.take(ensemble.source, out=ensemble.C[0], mode="clip")
            for write in ensemble.write:
                write()
            ensemble.copy_discrete(time)
            ensemble.calls += sum(ensemble.write_calls)
        ensemble.Y.take(ensemble.source, out=self._watch.row(time), mode="clip")

    def largest_error(self) -> float:
        return self._watch.largest()
