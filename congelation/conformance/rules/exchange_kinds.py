"""Rules about FMUs of both kinds: model exchange and co-simulation are of one model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from congelation.conformance.bench import Bench
from congelation.conformance.binding import EventInfo
from congelation.conformance.description import Description
from congelation.conformance.exchange import continuous, numbers_of, settled, state_count
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read
from congelation.conformance.rule import MODEL_EXCHANGE, Level, NotApplicable, NotEvaluated, dynamic
from congelation.conformance.trajectory import demand, excite

__all__: list[str] = []

# Difference quotients over such a step are good to a few digits, and co-simulation has an error of
# its own: the bound only has to tell a derivative from something else.
_QUOTIENT_STEP = 1e-5
_QUOTIENT_ERROR = 1e-2
# Steps of the Runge-Kutta method in a communication step; half as many tell its error.
_SUBSTEPS = 16
# The largest share of the way of a state by which both kinds may differ.
_DISAGREEMENT = 1e-2


def _moving(bench: Bench) -> Description:
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


def _slave(bench: Bench, description: Description) -> Instance:
    """A new instance for co-simulation at the first communication point."""
    instance = bench.fresh("slave")
    demand(instance.setup(bench.grid.start), "fmi2SetupExperiment")
    demand(instance.enter(), "fmi2EnterInitializationMode")
    excite(instance, description, 0)
    demand(instance.leave(), "fmi2ExitInitializationMode")
    return instance


@dynamic("FMI2-ME-09", "3.1, 4.1", Level.ROBUSTNESS, interface=MODEL_EXCHANGE)
def derivatives_are_slopes(bench: Bench) -> Iterator[str]:
    """Where the FMU is for co-simulation, too, its states move there at the rate of their
    derivatives.

    Standard: nothing; both kinds are of one model.

    Why: A user expects the same results of both kinds.

    Remedy: Compute both from the same equations

    Example: A derivative without its input.
    """
    count = state_count(bench)
    description = _moving(bench)
    if not description.flag("canHandleVariableCommunicationStepSize"):
        raise NotApplicable("canHandleVariableCommunicationStepSize is false")
    states = tuple(state for state, _ in description.state_vector)
    instance, _ = continuous(bench, description)
    slave = _slave(bench, description)
    time = bench.grid.start
    for _ in range(2):
        begin = [float(value) for value in read(slave, states).values()]
        demand(instance.set_time(time), "fmi2SetTime")
        demand(instance.set_states(begin), "fmi2SetContinuousStates")
        slopes = numbers_of(instance, "GetDerivatives", count)
        excite(slave, description, 0)
        demand(slave.step(time, _QUOTIENT_STEP), "fmi2DoStep")
        end = [float(value) for value in read(slave, states).values()]
        for (_, v), x, y, slope in zip(description.state_vector, begin, end, slopes, strict=True):
            quotient = (y - x) / _QUOTIENT_STEP
            if not abs(slope - quotient) <= _QUOTIENT_ERROR * (1.0 + abs(quotient)):
                yield f"{v.name} is {slope!r} at t = {time:.9g}; measured: {quotient!r}"
        # Once more after a step, where the states have left their start values.
        time += _QUOTIENT_STEP
        demand(slave.step(time, bench.grid.step), "fmi2DoStep")
        time += bench.grid.step
    for each in (instance, slave):
        each.free()


@dynamic("FMI2-ME-10", "3.1, 4.1", Level.ROBUSTNESS, time_factor=2.0, interface=MODEL_EXCHANGE)
def kinds_agree(bench: Bench) -> Iterator[str]:
    """Integrated by the importer, the states are those of co-simulation, across events, too.

    Standard: nothing; both kinds are of one model.

    Why: A user expects the same results of both kinds.

    Remedy: Compute both from the same equations, with the same events

    Example: A jump of a parameter that model exchange does not announce.
    """
    state_count(bench)
    description = _moving(bench)
    states = tuple(state for state, _ in description.state_vector)
    slave = _slave(bench, description)
    expected = [[float(value) for value in read(slave, states).values()]]
    for point in range(bench.grid.steps):
        excite(slave, description, point)
        time = bench.grid.time(point)
        demand(slave.step(time, bench.grid.time(point + 1) - time), f"fmi2DoStep at t = {time:.9g}")
        expected.append([float(value) for value in read(slave, states).values()])
    slave.free()
    coarse = _integrated(bench, description, _SUBSTEPS // 2)
    fine = _integrated(bench, description, _SUBSTEPS)
    for i, v in enumerate(states):
        own = [row[i] for row in expected]
        way = max(abs(value - own[0]) for value in own)
        unsure = max(abs(a[i] - b[i]) for a, b in zip(coarse, fine, strict=True))
        apart = max(abs(row[i] - value) for row, value in zip(fine, own, strict=True))
        if not unsure <= _DISAGREEMENT * (way + 1e-6):
            raise NotEvaluated(f"{_SUBSTEPS} steps of Runge and Kutta are too few for {v.name}")
        if not apart <= _DISAGREEMENT * way + 1e-6 * (1.0 + abs(own[0])):
            yield f"{v.name} differs by {apart:.3g} between both kinds; it moves by {way:.3g}"


def _integrated(bench: Bench, description: Description, substeps: int) -> list[list[float]]:
    """The states at the communication points, by the method of Runge and Kutta (order 4)."""
    count = len(description.state_vector)
    instance, info = continuous(bench, description)

    def rates(t: float, x: Sequence[float]) -> list[float]:
        demand(instance.set_time(t), "fmi2SetTime")
        demand(instance.set_states(x), "fmi2SetContinuousStates")
        return numbers_of(instance, "GetDerivatives", count)

    def event(t: float, point: int) -> EventInfo:
        demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
        demand(instance.enter_event_mode(), "fmi2EnterEventMode")
        excite(instance, description, point)
        told = settled(instance, t)
        demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
        return told

    x = numbers_of(instance, "GetContinuousStates", count)
    rows = [x]
    for point in range(bench.grid.steps):
        t, end = bench.grid.time(point), bench.grid.time(point + 1)
        while t < end:
            stop = min(end, info.nextEventTime) if info.nextEventTimeDefined else end
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
            info = event(t, point + 1 if t >= end else point)
            x = numbers_of(instance, "GetContinuousStates", count)
        rows.append(x)
    instance.free()
    return rows
