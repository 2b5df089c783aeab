"""Instances for model exchange, as the rules about it share them: modes, state vectors, events."""

from __future__ import annotations

from collections.abc import Sequence

from congelation.conformance.bench import Bench
from congelation.conformance.binding import EventInfo
from congelation.conformance.description import Description
from congelation.conformance.instance import Instance
from congelation.conformance.rule import NotApplicable, Violated
from congelation.conformance.trajectory import demand

__all__ = ["continuous", "moved", "numbers_of", "settled", "state_count"]

# An event iteration settles after a few rounds; more than this is taken for endless.
_MOST_ITERATIONS = 100


def state_count(bench: Bench) -> int:
    """How many continuous states there are.

    Raises
    ------
    NotApplicable
        None, or the FMU is for co-simulation alone.
    """
    bench.exchange_library  # noqa: B018  # the better reason comes first
    count = len(bench.description.state_vector)
    if count == 0:
        raise NotApplicable("there are no continuous states")
    return count


def numbers_of(instance: Instance, name: str, count: int) -> list[float]:
    """The numbers of fmi2GetContinuousStates, fmi2GetDerivatives or the like."""
    status, values = instance.vector(name, count)
    demand(status, f"fmi2{name}")
    return values


def settled(instance: Instance, time: float) -> EventInfo:
    """What fmi2NewDiscreteStates tells at the end of the event iteration.

    Raises
    ------
    Violated
        There is no end.
    NotApplicable
        The FMU ends the simulation.
    """
    for _ in range(_MOST_ITERATIONS):
        status, info = instance.new_discrete_states()
        demand(status, f"fmi2NewDiscreteStates at t = {time:.9g}")
        if info.terminateSimulation:
            raise NotApplicable(f"the FMU ends the simulation at t = {time:.9g}")
        if not info.newDiscreteStatesNeeded:
            return info
    raise Violated(
        f"fmi2NewDiscreteStates at t = {time:.9g} needs another call after {_MOST_ITERATIONS}"
    )


def continuous(bench: Bench, description: Description | None = None) -> tuple[Instance, EventInfo]:
    """A new instance in continuous-time mode, and what it told before."""
    instance = bench.exchange(description)
    info = settled(instance, bench.grid.start)
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
    return instance, info


def moved(x: Sequence[float]) -> list[float]:
    """Other states, near by."""
    return [value + 0.01 * (1.0 + abs(value)) * (1.0 + 0.1 * i) for i, value in enumerate(x)]
