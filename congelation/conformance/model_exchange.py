"""An instance for model exchange, as the rules about it share it: modes, state vector, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from congelation.conformance.bench import Bench
from congelation.conformance.binding import EventInfo
from congelation.conformance.description import Description
from congelation.conformance.instance import MODEL_EXCHANGE
from congelation.conformance.rule import NotApplicable, Violated, require
from congelation.conformance.trajectory import demand, excite

__all__ = ["Model", "integrated", "moved", "require_states", "without_slopes"]

# An event iteration settles after a few rounds; more than this is taken for endless.
_MOST_ITERATIONS = 100


def require_states(bench: Bench) -> None:
    """Raise NotApplicable where there are no continuous states, or there is no model exchange."""
    bench.exchange_library  # noqa: B018  # the better reason comes first
    require(bench.description.state_vector, "there are no continuous states")


class Model:
    """A new instance for model exchange in event mode, its inputs excited.

    A call that the standard allows in the mode, but that fails, raises `Violated`.

    Parameters
    ----------
    bench : Bench
    description : Description, optional
        In place of the FMU's own, where some inputs are to rest.

    Attributes
    ----------
    instance : Instance
    description : Description
    info : EventInfo
        What the latest event iteration told at its end.

    Raises
    ------
    NotApplicable
        The FMU is for co-simulation alone.
    """

    def __init__(self, bench: Bench, description: Description | None = None) -> None:
        self.description = description or bench.description
        self.instance = bench.fresh(kind=MODEL_EXCHANGE, library=bench.exchange_library)
        bench.initialize(self.instance, description=self.description)
        self.info = EventInfo()

    @classmethod
    def continuous(cls, bench: Bench, description: Description | None = None) -> Model:
        """One with continuous states, in continuous-time mode."""
        require_states(bench)
        model = cls(bench, description)
        model.settle(bench.grid.start)
        model.enter_continuous_time_mode()
        return model

    def numbers(self, name: str) -> list[float]:
        """The numbers of fmi2GetContinuousStates, fmi2GetDerivatives or the like."""
        status, values = self.instance.vector(name, len(self.description.state_vector))
        demand(status, f"fmi2{name}")
        return values

    @property
    def x(self) -> list[float]:
        """The continuous states, to read and to set."""
        return self.numbers("GetContinuousStates")

    @x.setter
    def x(self, states: Sequence[float]) -> None:
        demand(self.instance.set_states(states), "fmi2SetContinuousStates")

    @property
    def rates(self) -> list[float]:
        """The derivatives of the continuous states."""
        return self.numbers("GetDerivatives")

    def set_time(self, time: float, what: str = "") -> None:
        """fmi2SetTime; `what` is said of it where it fails."""
        demand(self.instance.set_time(time), f"fmi2SetTime{what}")

    def end_step(self) -> None:
        """fmi2CompletedIntegratorStep."""
        demand(self.instance.completed_step()[0], "fmi2CompletedIntegratorStep")

    def enter_event_mode(self) -> None:
        """fmi2EnterEventMode."""
        demand(self.instance.enter_event_mode(), "fmi2EnterEventMode")

    def enter_continuous_time_mode(self, what: str = "") -> None:
        """fmi2EnterContinuousTimeMode; `what` is said of it where it fails."""
        demand(self.instance.enter_continuous_time_mode(), f"fmi2EnterContinuousTimeMode{what}")

    def excite(self, point: int) -> None:
        """Set the inputs to their excitation at a communication point."""
        excite(self.instance, self.description, point)

    def settle(self, time: float) -> EventInfo:
        """Iterate fmi2NewDiscreteStates to the end of an event; what it tells there.

        Raises
        ------
        Violated
            There is no end.
        NotApplicable
            The FMU ends the simulation.
        """
        for _ in range(_MOST_ITERATIONS):
            status, self.info = self.instance.new_discrete_states()
            demand(status, f"fmi2NewDiscreteStates at t = {time:.9g}")
            if self.info.terminateSimulation:
                raise NotApplicable(f"the FMU ends the simulation at t = {time:.9g}")
            if not self.info.newDiscreteStatesNeeded:
                return self.info
        raise Violated(
            f"fmi2NewDiscreteStates at t = {time:.9g} needs another call after {_MOST_ITERATIONS}"
        )


def moved(x: Sequence[float]) -> list[float]:
    """Other states, near by."""
    return [value + 0.01 * (1.0 + abs(value)) * (1.0 + 0.1 * i) for i, value in enumerate(x)]


def without_slopes(bench: Bench) -> Description:
    """The description with those inputs at rest on which no derivative depends.

    In co-simulation an FMU may have inputs for the slopes of others, which mean nothing in model
    exchange.
    """
    description = bench.description
    known: set[int] = set()
    for unknown in description.derivatives:
        if unknown.dependencies is None:
            return description
        known |= set(unknown.dependencies)
    return replace(
        description,
        variables=tuple(
            replace(v, still=v.still or (v.causality == "input" and v.index not in known))
            for v in description.variables
        ),
    )


def integrated(bench: Bench, description: Description, substeps: int) -> list[list[float]]:
    """The states at the communication points, by the method of Runge and Kutta (order 4)."""
    model = Model.continuous(bench, description)

    def rates(t: float, x: Sequence[float]) -> list[float]:
        model.set_time(t)
        model.x = x
        return model.rates

    x = model.x
    rows = [x]
    for point in range(bench.grid.steps):
        t, end = bench.grid.time(point), bench.grid.time(point + 1)
        while t < end:
            stop = min(end, model.info.nextEventTime) if model.info.nextEventTimeDefined else end
            stop = stop if stop > t else end
            h = (stop - t) / substeps
            for k in range(substeps):
                s = t + k * h
                k1 = rates(s, x)
                k2 = rates(s + h / 2, [a + h / 2 * b for a, b in zip(x, k1, strict=True)])
                k3 = rates(s + h / 2, [a + h / 2 * b for a, b in zip(x, k2, strict=True)])
                k4 = rates(s + h, [a + h * b for a, b in zip(x, k3, strict=True)])
                x = [
                    a + h / 6 * (b + 2 * c + 2 * d + e)
                    for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
                ]
            t = stop
            rates(t, x)
            model.end_step()
            model.enter_event_mode()
            model.excite(point + 1 if t >= end else point)
            model.settle(t)
            model.enter_continuous_time_mode()
            x = model.x
        rows.append(x)
    model.instance.free()
    return rows
