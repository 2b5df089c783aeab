"""Rules about model exchange (section 3): continuous states, their derivatives, events."""

from __future__ import annotations

import math
from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.exchange import continuous, moved, numbers_of, settled, state_count
from congelation.conformance.probe import read
from congelation.conformance.rule import MODEL_EXCHANGE, Level, dynamic
from congelation.conformance.trajectory import demand, same

__all__: list[str] = []

# Time events that are visited one after another.
_EVENTS = 4


@dynamic("FMI2-ME-03", "3.2.1, 3.2.2", Level.VIOLATION, interface=MODEL_EXCHANGE)
def states_are_set(bench: Bench) -> Iterator[str]:
    """The states are those that were set, by fmi2GetContinuousStates and as variables.

    Standard: fmi2SetContinuousStates: "Set a new (continuous) state vector"

    Why: A solver repeats steps from former states.

    Remedy: Store what fmi2SetContinuousStates gets

    Example: A state that is computed inside the FMU.
    """
    count = state_count(bench)
    states = tuple(state for state, _ in bench.description.state_vector)
    instance, _ = continuous(bench)
    x = numbers_of(instance, "GetContinuousStates", count)
    for vector in (moved(x), x):
        demand(instance.set_states(vector), "fmi2SetContinuousStates")
        found = numbers_of(instance, "GetContinuousStates", count)
        variables = read(instance, states)
        for v, wanted, value in zip(states, vector, found, strict=True):
            if not same(value, wanted):
                yield f"{v.name} was set to {wanted!r} and is {value!r}"
            elif not same(variables[v.index], wanted):
                yield f"{v.name} was set to {wanted!r}; as a variable it is {variables[v.index]!r}"
    instance.free()


@dynamic("FMI2-ME-04", "3.2.2, 2.2.7", Level.VIOLATION, interface=MODEL_EXCHANGE)
def derivatives_are_variables(bench: Bench) -> Iterator[str]:
    """The derivatives are the variables that modelDescription.xml lists as Derivatives.

    Standard: fmi2GetDerivatives: "The derivatives are returned as a vector with nx elements"; its
    order is that of the list Derivatives of ModelStructure.

    Why: Tools read derivatives either way.

    Remedy: Return the values of the listed variables, in their order

    Example: Derivatives in another order than the list.
    """
    count = state_count(bench)
    derivatives = tuple(derivative for _, derivative in bench.description.state_vector)
    instance, _ = continuous(bench)
    demand(
        instance.set_states(moved(numbers_of(instance, "GetContinuousStates", count))),
        "fmi2SetContinuousStates",
    )
    found = numbers_of(instance, "GetDerivatives", count)
    variables = read(instance, derivatives)
    for v, value in zip(derivatives, found, strict=True):
        if not same(value, variables[v.index]):
            yield f"{v.name} is {variables[v.index]!r}, by fmi2GetDerivatives {value!r}"
    instance.free()


@dynamic("FMI2-ME-05", "3.2.1", Level.VIOLATION, interface=MODEL_EXCHANGE)
def derivatives_follow(bench: Bench) -> Iterator[str]:
    """In continuous-time mode derivatives follow from time, states and inputs alone.

    Standard: fmi2SetTime: "re-initialize caching of variables that depend on time, provided the
    newly provided time value is different to the previously set time value"; for the states
    fmi2SetContinuousStates does the same.

    Why: Solvers evaluate at trial points, and step back in time.

    Remedy: Remember nothing from one evaluation to the next

    Example: A difference quotient over the last two calls in place of a derivative.
    """
    count = state_count(bench)
    time, later = bench.grid.start, bench.grid.time(1)
    instance, _ = continuous(bench)
    x = numbers_of(instance, "GetContinuousStates", count)
    first = numbers_of(instance, "GetDerivatives", count)
    for t, states in ((later, moved(x)), (time, x)):
        demand(instance.set_time(t), "fmi2SetTime")
        demand(instance.set_states(states), "fmi2SetContinuousStates")
        again = numbers_of(instance, "GetDerivatives", count)
    for (_, v), one, other in zip(bench.description.state_vector, first, again, strict=True):
        if not same(one, other):
            yield f"{v.name} is {other!r} after an evaluation elsewhere, {one!r} before"
    instance.free()


@dynamic("FMI2-ME-06", "3.2.2", Level.VIOLATION, interface=MODEL_EXCHANGE)
def completed_step_keeps(bench: Bench) -> Iterator[str]:
    """fmi2CompletedIntegratorStep leaves the continuous states as they are.

    Standard: "This function must be called by the environment after every completed step of the
    integrator": states change in Event Mode alone.

    Why: A multistep method goes on with the states that it knows.

    Remedy: Ask for Event Mode by enterEventMode, and change states there

    Example: A state that is projected in fmi2CompletedIntegratorStep.
    """
    count = state_count(bench)
    instance, _ = continuous(bench)
    before = numbers_of(instance, "GetContinuousStates", count)
    demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
    after = numbers_of(instance, "GetContinuousStates", count)
    for (v, _), one, other in zip(bench.description.state_vector, before, after, strict=True):
        if not same(one, other):
            yield f"{v.name} went from {one!r} to {other!r}"
    instance.free()


@dynamic("FMI2-ME-07", "3.2.2", Level.VIOLATION, interface=MODEL_EXCHANGE)
def nominals(bench: Bench) -> Iterator[str]:
    """The nominal values of the states are positive, and those of modelDescription.xml.

    Standard: "it is required that x_nominal[i] > 0.0"

    Why: Solvers scale their tolerances by them.

    Remedy: Return the attribute nominal of each state, 1 where there is none

    Example: 0 for a state that starts at 0.
    """
    count = state_count(bench)
    instance, _ = continuous(bench)
    found = numbers_of(instance, "GetNominalsOfContinuousStates", count)
    for (v, _), value in zip(bench.description.state_vector, found, strict=True):
        given = v.bound("nominal")
        if not 0.0 < value < math.inf:
            yield f"the nominal value of {v.name} is {value!r}"
        elif given is not None and value != given:
            bench.notes.append(f"the nominal value of {v.name} is {value!r}, in the XML {given!r}")
    instance.free()


@dynamic("FMI2-ME-08", "3.2.2", Level.VIOLATION, interface=MODEL_EXCHANGE)
def time_events(bench: Bench) -> Iterator[str]:
    """Event iterations end, and the next time event is later than the present time.

    Standard: "the simulation shall integrate at most until time = nextEventTime, and shall call
    fmi2EnterEventMode at this time instant"

    Why: A solver that is sent to the same time again does not end.

    Remedy: At the time of an event, announce the one after it

    Example: The event at which the FMU stands is announced again.
    """
    count = len(bench.description.state_vector)
    instance = bench.exchange()
    time = bench.grid.start
    seen = 0
    for _ in range(_EVENTS):
        before = numbers_of(instance, "GetContinuousStates", count) if count else []
        info = settled(instance, time)
        after = numbers_of(instance, "GetContinuousStates", count) if count else []
        if info.valuesOfContinuousStatesChanged and all(map(same, before, after)):
            yield f"at t = {time:.9g} valuesOfContinuousStatesChanged is true, and none changed"
        if not info.nextEventTimeDefined:
            break
        if not info.nextEventTime > time:
            yield f"at t = {time!r} the next event is announced for {info.nextEventTime!r}"
            break
        seen += 1
        time = info.nextEventTime
        demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
        demand(instance.set_time(time), f"fmi2SetTime to the event at {time:.9g}")
        demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
        demand(instance.enter_event_mode(), "fmi2EnterEventMode")
    instance.free()
    if not seen:
        bench.notes.append("no time event is announced")
