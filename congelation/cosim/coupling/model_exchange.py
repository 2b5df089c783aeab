"""All states of a system integrated as one differential equation, by FMI 2.0 model exchange."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import Stepper, StepsOnce
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import MAX_ITERATIONS, Exchange
from congelation.cosim.result import RunEnded, Status
from congelation.errors import InvalidInput, SlaveError
from congelation.fmi.description import Equations
from congelation.fmi.model import Model
from congelation.fmi.slave import Slave, SlaveTerminated, StepDiscarded

__all__ = ["ModelExchange", "ModelExchangeStepper", "Smooth", "ended_by", "late", "unsettled"]

Floats = npt.NDArray[np.float64]

METHODS = ("DOP853", "Radau", "BDF", "LSODA")

LEAVES = 1e-10
"""By how much values may differ, relative to 1 plus their size, where an algebraic loop is solved
twice: ten times the tolerance of its solution."""


@dataclass(frozen=True)
class ModelExchange(StepsOnce):
    """All FMUs give their derivatives, and one integrator makes the steps of the whole system.

    This is no co-simulation: no input is held or extrapolated, and the only error is that of the
    integrator. All FMUs need to offer FMI 2.0 model exchange, as native ones do. Steps end on time
    events, and where an event indicator changes its sign. At every evaluation, outputs that follow
    from inputs at once are read in the order of the declared dependencies, and algebraic loops are
    solved.

    Parameters
    ----------
    method : str
        Of `scipy.integrate`: "DOP853", explicit, of order 8; "Radau" and "BDF", implicit, for stiff
        systems; "LSODA", which changes between the two kinds.

    Examples
    --------
    >>> links = cg.Connection("plant.x", "law.x"), cg.Connection("law.u", "plant.u")
    >>> plant = cg.Component("plant", fmus / "native" / "ScalarPlant.fmu", {"x0": [2.0]})
    >>> law = cg.Component("law", fmus / "native" / "ScalarController.fmu")
    >>> system = cg.System((plant, law), links)
    >>> cg.simulate(system, stop_time=0.5, tolerance=1e-8, coupling=cg.ModelExchange()).status.name
    'COMPLETED'
    """

    method: str = "DOP853"
    name: ClassVar[str] = "model_exchange"
    takes_tolerance: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method not in METHODS:
            raise InvalidInput(f"method '{self.method}'; valid: {', '.join(METHODS)}")

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> ModelExchangeStepper:
        """The system as one differential equation."""
        return ModelExchangeStepper(ensemble, exchange, self.method)


class Smooth(NamedTuple):
    """A point from which all is smooth up to the next event.

    Parameters
    ----------
    x : array, shape (n,)
        The states of all FMUs.
    event : float
        Time of the next announced event in seconds; infinite where there is none.
    positive : tuple of array
        Of each FMU, which event indicators are positive.
    """

    x: Floats
    event: float
    positive: tuple[npt.NDArray[np.bool_], ...]


class ModelExchangeStepper(Stepper[Smooth]):
    """The system as one differential equation dx/dt = f(t, x) between two events.

    Parameters
    ----------
    ensemble : Ensemble
        With all that is recorded.
    exchange : Exchange
        Of the ensemble, for events.
    method : str

    Attributes
    ----------
    drive : Ensemble
        The same slaves with the values that drive inputs alone, for evaluations of f.
    carried : Exchange
        Of `drive`.
    equations : list of Equations, one per slave
    parts : list of slice, one per slave
        Its states in x.
    nominal : array, shape (n,)
        Of the states.
    leaves : float
        Change of what is read, relative to 1 plus its size, that counts as none at an event.
    """

    order = 8

    def __init__(self, ensemble: Ensemble, exchange: Exchange, method: str) -> None:
        self.method = method
        self._ensemble, self._exchange = ensemble, exchange
        self.leaves = LEAVES if exchange.loops else 0.0
        members = ensemble.system.members
        self.equations: list[Equations] = [
            m.description.equations for m in members if m.description.equations is not None
        ]
        ends = np.cumsum([0, *(e.states for e in self.equations)]).tolist()
        self.parts = [slice(a, b) for a, b in pairwise(ends)]
        self.nominal = np.ones(ends[-1])
        self.drive = Ensemble(
            ensemble.system,
            ensemble.slaves,
            (),
            derivatives=False,
            slopes=False,
            events=False,
            exchange=True,
        )
        self.carried = Exchange(self.drive)
        self.models = [Model(slave) for slave in ensemble.slaves]
        self.iterations = 0
        self.calls_per_iteration = sum(1 + 2 * bool(e.states) for e in self.equations)

    def renew(self) -> None:
        super().renew()
        self.drive.begin(self._ensemble.system)

    def start(self, time: float, before: Smooth | None) -> Smooth:
        """Through event mode, until no FMU has anything more to change.

        Raises
        ------
        RunEnded
            LOOP_UNSOLVED.
        SlaveTerminated
            An FMU ended the run.
        SlaveError
        """
        ensemble = self._ensemble
        slaves = ensemble.slaves
        if before is not None:
            for model in self.models:
                model.enter_event_mode()
        for _ in range(MAX_ITERATIONS):
            Y, discrete = ensemble.Y.copy(), ensemble.discrete_values()
            found = [model.new_discrete_states() for model in self.models]
            for slave, said in zip(slaves, found, strict=True):
                if said.ends:
                    raise ended_by(slave, time)
                if said.event <= time:
                    raise late(slave, time, said.event)
            self._exchange.run(time)
            change = np.abs(np.where(ensemble.Y == Y, 0.0, ensemble.Y - Y))
            settled = bool((change <= self.leaves * (1.0 + np.abs(ensemble.Y))).all())
            settled = settled and discrete == ensemble.discrete_values()
            if settled and not any(said.again for said in found):
                break
        else:
            raise unsettled(time)
        ensemble.calls += (2 + (before is not None)) * len(slaves)
        x = np.zeros(len(self.nominal))
        for model, part in zip(self.models, self.parts, strict=True):
            model.enter_continuous_time_mode()
            if part.start < part.stop:
                model.get_states(x[part])
                model.get_nominals(self.nominal[part])
        # A state whose nominal value is said to be 0 would leave it without an absolute tolerance.
        np.abs(self.nominal, out=self.nominal)
        self.nominal[self.nominal == 0.0] = 1.0
        event = min((said.event for said in found), default=math.inf)
        return Smooth(x, event, tuple(z > 0.0 for z in self.indicators()))

    def go_to(self, time: float, x: Floats) -> None:
        """Give the FMUs time and states, and carry outputs over to inputs.

        Raises
        ------
        StepDiscarded, SlaveError
        RunEnded
            LOOP_UNSOLVED.
        """
        x = np.ascontiguousarray(x)  # SciPy gives columns of matrices, too
        for model, part in zip(self.models, self.parts, strict=True):
            model.set_time(time)
            if part.start < part.stop:
                model.set_states(x[part])
        self.carried.carry(time)

    def rates(self, time: float, x: Floats) -> Floats:
        """f(t, x), shape (n,); not a number where x is not finite or an FMU discards it, as the
        step is too long there."""
        f = np.full(len(x), np.nan)
        if np.isfinite(x).all():
            self.iterations += 1
            try:
                self.go_to(time, x)
                for model, part in zip(self.models, self.parts, strict=True):
                    if part.start < part.stop:
                        model.get_rates(f[part])
            except StepDiscarded:
                f[:] = np.nan
        return f

    def indicators(self) -> list[Floats]:
        """The event indicators of each FMU, where they are now."""
        found = []
        for model, equations in zip(self.models, self.equations, strict=True):
            z = np.zeros(equations.indicators)
            if len(z):
                model.get_indicators(z)
            found.append(z)
        return found

    def crossed(self, state: Smooth) -> bool:
        """Whether an indicator has another sign than after the last event."""
        return any(
            ((z > 0.0) != positive).any()
            for z, positive in zip(self.indicators(), state.positive, strict=True)
        )

    def completed(self, time: float) -> bool:
        """Tell the FMUs that a step is completed; whether one asks for an event.

        Raises
        ------
        SlaveTerminated
            An FMU ended the run.
        """
        asks = False
        for model, equations in zip(self.models, self.equations, strict=True):
            if equations.completes:
                self._ensemble.calls += 1
                enter, ends = model.completed_step()
                if ends:
                    raise ended_by(model.slave, time)
                asks = asks or enter
        return asks

    def advance(self, state: Smooth, time: float, end: float) -> Smooth:
        """Not here: steps are the integrator's, see `congelation.cosim.integration`."""
        raise InvalidInput(f"coupling '{ModelExchange.name}' has no steps of a given length")

    def largest_error(self) -> float:
        return 0.0


def ended_by(slave: Slave, time: float) -> SlaveTerminated:
    """What ends a run that an FMU wants ended."""
    return SlaveTerminated(f"{slave.name} at t = {time:.9g} ended the run")


def late(slave: Slave, time: float, event: float) -> SlaveError:
    """What ends a run in which an FMU announces an event that has passed."""
    return SlaveError(slave.name, time, f"it announces its next event for t = {event:.9g}")


def unsettled(time: float) -> RunEnded:
    """What ends a run in which an event does not come to its end."""
    return RunEnded(
        Status.LOOP_UNSOLVED,
        f"at t = {time:.9g}: the FMUs keep changing each other's discrete states",
    )
