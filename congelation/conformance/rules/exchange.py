"""Rules about model exchange (section 3): modes, states and their derivatives, events."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from congelation.conformance.bench import Bench
from congelation.conformance.binding import EventInfo, Status
from congelation.conformance.description import Description
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read
from congelation.conformance.rule import (
    MODEL_EXCHANGE,
    Level,
    NotApplicable,
    NotEvaluated,
    Violated,
    dynamic,
)
from congelation.conformance.trajectory import demand, excite, same

__all__: list[str] = []

# An event iteration settles after a few rounds; more than this is taken for endless.
_MOST_ITERATIONS = 100
# Time events that are visited one after another.
_EVENTS = 4
# Difference quotients over such a step are good to a few digits, and co-simulation has an error of
# its own: the bound only has to tell a derivative from something else.
_QUOTIENT_STEP = 1e-5
_QUOTIENT_ERROR = 1e-2
# Steps of the Runge-Kutta method in a communication step; half as many tell its error.
_SUBSTEPS = 16
# The largest share of the way of a state by which both kinds may differ.
_DISAGREEMENT = 1e-2


def _states(bench: Bench) -> int:
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


def _got(instance: Instance, name: str, count: int) -> list[float]:
    """The numbers of fmi2GetContinuousStates, fmi2GetDerivatives or the like."""
    status, values = instance.vector(name, count)
    demand(status, f"fmi2{name}")
    return values


def _settled(instance: Instance, time: float) -> EventInfo:
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


def _continuous(bench: Bench, description: Description | None = None) -> tuple[Instance, EventInfo]:
    """A new instance in continuous-time mode, and what it told before."""
    instance = bench.exchange(description)
    info = _settled(instance, bench.grid.start)
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
    return instance, info


def _moved(x: Sequence[float]) -> list[float]:
    """Other states, near by."""
    return [value + 0.01 * (1.0 + abs(value)) * (1.0 + 0.1 * i) for i, value in enumerate(x)]


@dynamic("FMI2-ME-01", "3.2.3", Level.VIOLATION, interface=MODEL_EXCHANGE)
def allowed_calls(bench: Bench) -> Iterator[str]:
    """Every call that the table allows in a mode of model exchange succeeds there.

    Standard: "x means: call is allowed in the corresponding state"

    Why: Solvers rely on the table.

    Remedy: Let the call succeed in this mode

    Example: fmi2EnterEventMode refused in continuous-time mode.
    """
    count = len(bench.description.state_vector)
    numbers = {
        "GetContinuousStates": count,
        "GetDerivatives": count,
        "GetNominalsOfContinuousStates": count,
        "GetEventIndicators": bench.description.indicators,
    }
    outputs = tuple(v for v in bench.description.variables if v.causality == "output")

    def look(instance: Instance, mode: str) -> Iterator[str]:
        for name, length in numbers.items():
            status, values = instance.vector(name, length)
            if status not in (Status.OK, Status.WARNING):
                yield f"fmi2{name} in {mode} returned {status}"
            elif not all(map(math.isfinite, values)):
                yield f"fmi2{name} in {mode}: a number is not finite"
        read(instance, outputs)

    instance = bench.exchange()
    yield from look(instance, "event mode")
    _settled(instance, bench.grid.start)
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
    yield from look(instance, "continuous-time mode")
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime in continuous-time mode")
    x = _got(instance, "GetContinuousStates", count)
    demand(instance.set_states(x), "fmi2SetContinuousStates in continuous-time mode")
    demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
    demand(instance.enter_event_mode(), "fmi2EnterEventMode")
    excite(instance, bench.description, 1)
    _settled(instance, bench.grid.time(1))
    yield from look(instance, "event mode after a step")
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode after an event")
    demand(instance.terminate(), "fmi2Terminate in continuous-time mode")
    read(instance, outputs)
    instance.free()
    instance = bench.exchange()
    demand(instance.terminate(), "fmi2Terminate in event mode")
    instance.free()


@dynamic("FMI2-ME-02", "3.2.3", Level.ROBUSTNESS, interface=MODEL_EXCHANGE)
def forbidden_calls(bench: Bench) -> Iterator[str]:
    """A call that belongs to another mode of model exchange is refused.

    Standard: the table does not allow the call; what it returns is not said.

    Why: A solver with a wrong order of calls gets numbers instead of an error.

    Remedy: Check the mode at the head of each function, and return fmi2Error

    Example: fmi2EnterContinuousTimeMode in continuous-time mode.
    """
    x = [0.0] * len(bench.description.state_vector)
    in_event_mode: dict[str, Callable[[Instance], Status]] = {
        "fmi2EnterEventMode": lambda i: i.enter_event_mode(),
        "fmi2CompletedIntegratorStep": lambda i: i.completed_step()[0],
        "fmi2DoStep": lambda i: i.step(bench.grid.start, bench.grid.step),
    }
    in_continuous_time_mode: dict[str, Callable[[Instance], Status]] = {
        "fmi2EnterContinuousTimeMode": lambda i: i.enter_continuous_time_mode(),
        "fmi2NewDiscreteStates": lambda i: i.new_discrete_states()[0],
        "fmi2DoStep": lambda i: i.step(bench.grid.start, bench.grid.step),
    }
    if x:
        in_event_mode["fmi2SetContinuousStates"] = lambda i: i.set_states(x)
    for mode, calls in (
        ("event mode", in_event_mode),
        ("continuous-time mode", in_continuous_time_mode),
    ):
        for name, call in calls.items():
            bench.library.probe = ""
            instance = bench.exchange() if mode == "event mode" else _continuous(bench)[0]
            bench.library.probe = f"in {mode}"
            status = call(instance)
            if status in (Status.OK, Status.WARNING, Status.PENDING):
                yield f"{name} in {mode} returned {status}"
            if status != Status.FATAL:
                instance.free()


@dynamic("FMI2-ME-03", "3.2.1, 3.2.2", Level.VIOLATION, interface=MODEL_EXCHANGE)
def states_are_set(bench: Bench) -> Iterator[str]:
    """The states are those that were set, by fmi2GetContinuousStates and as variables.

    Standard: fmi2SetContinuousStates: "Set a new (continuous) state vector"

    Why: A solver repeats steps from former states.

    Remedy: Store what fmi2SetContinuousStates gets

    Example: A state that is computed inside the FMU.
    """
    count = _states(bench)
    states = tuple(state for state, _ in bench.description.state_vector)
    instance, _ = _continuous(bench)
    x = _got(instance, "GetContinuousStates", count)
    for vector in (_moved(x), x):
        demand(instance.set_states(vector), "fmi2SetContinuousStates")
        found = _got(instance, "GetContinuousStates", count)
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
    count = _states(bench)
    derivatives = tuple(derivative for _, derivative in bench.description.state_vector)
    instance, _ = _continuous(bench)
    demand(
        instance.set_states(_moved(_got(instance, "GetContinuousStates", count))),
        "fmi2SetContinuousStates",
    )
    found = _got(instance, "GetDerivatives", count)
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
    count = _states(bench)
    time, later = bench.grid.start, bench.grid.time(1)
    instance, _ = _continuous(bench)
    x = _got(instance, "GetContinuousStates", count)
    first = _got(instance, "GetDerivatives", count)
    for t, states in ((later, _moved(x)), (time, x)):
        demand(instance.set_time(t), "fmi2SetTime")
        demand(instance.set_states(states), "fmi2SetContinuousStates")
        again = _got(instance, "GetDerivatives", count)
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
    count = _states(bench)
    instance, _ = _continuous(bench)
    before = _got(instance, "GetContinuousStates", count)
    demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
    after = _got(instance, "GetContinuousStates", count)
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
    count = _states(bench)
    instance, _ = _continuous(bench)
    found = _got(instance, "GetNominalsOfContinuousStates", count)
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
        before = _got(instance, "GetContinuousStates", count) if count else []
        info = _settled(instance, time)
        after = _got(instance, "GetContinuousStates", count) if count else []
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
    count = _states(bench)
    description = _moving(bench)
    if not description.flag("canHandleVariableCommunicationStepSize"):
        raise NotApplicable("canHandleVariableCommunicationStepSize is false")
    states = tuple(state for state, _ in description.state_vector)
    instance, _ = _continuous(bench, description)
    slave = _slave(bench, description)
    time = bench.grid.start
    for _ in range(2):
        begin = [float(value) for value in read(slave, states).values()]
        demand(instance.set_time(time), "fmi2SetTime")
        demand(instance.set_states(begin), "fmi2SetContinuousStates")
        slopes = _got(instance, "GetDerivatives", count)
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
    _states(bench)
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
    instance = bench.exchange(description)
    info = _settled(instance, bench.grid.start)
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")

    def rates(t: float, x: Sequence[float]) -> list[float]:
        demand(instance.set_time(t), "fmi2SetTime")
        demand(instance.set_states(x), "fmi2SetContinuousStates")
        return _got(instance, "GetDerivatives", count)

    def event(t: float, point: int) -> EventInfo:
        demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
        demand(instance.enter_event_mode(), "fmi2EnterEventMode")
        excite(instance, description, point)
        told = _settled(instance, t)
        demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
        return told

    x = _got(instance, "GetContinuousStates", count)
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
            x = _got(instance, "GetContinuousStates", count)
        rows.append(x)
    instance.free()
    return rows


@dynamic("FMI2-ME-11", "2.1.9, 3.3.1", Level.VIOLATION, interface=MODEL_EXCHANGE)
def jacobian(bench: Bench) -> Iterator[str]:
    """With providesDirectionalDerivative the derivatives with respect to states are those
    measured.

    Standard: "fmi2GetDirectionalDerivative computes a linear combination of the partial
    derivatives"

    Why: Implicit solvers take their Jacobian from it.

    Remedy: Return the derivatives, or set the flag to false

    Example: 0 for every state.
    """
    count = _states(bench)
    if not bench.description.exchange_flag("providesDirectionalDerivative"):
        raise NotApplicable("providesDirectionalDerivative is false")
    instance, _ = _continuous(bench)
    x = _moved(_got(instance, "GetContinuousStates", count))
    unknowns = [derivative.reference for _, derivative in bench.description.state_vector]

    def rates(states: Sequence[float]) -> list[float]:
        demand(instance.set_states(states), "fmi2SetContinuousStates")
        return _got(instance, "GetDerivatives", count)

    for i, (state, _) in enumerate(bench.description.state_vector):
        step = _QUOTIENT_STEP * (1.0 + abs(x[i]))
        high, low = (rates([*x[:i], x[i] + d, *x[i + 1 :]]) for d in (step, -step))
        demand(instance.set_states(x), "fmi2SetContinuousStates")
        status, found = instance.directional_derivative(unknowns, [state.reference], [1.0])
        demand(status, f"fmi2GetDirectionalDerivative with respect to {state.name}")
        for (_, v), a, b, value in zip(
            bench.description.state_vector, high, low, found, strict=True
        ):
            quotient = (a - b) / (2 * step)
            if not abs(value - quotient) <= _QUOTIENT_ERROR * (1.0 + abs(quotient)):
                yield f"d {v.name} / d {state.name} is {value!r}, measured {quotient!r}"
    instance.free()


@dynamic("FMI2-ME-12", "2.1.8, 3.3.1", Level.VIOLATION, interface=MODEL_EXCHANGE)
def state_holds(bench: Bench) -> Iterator[str]:
    """With canGetAndSetFMUstate of model exchange a state brings time, states and inputs back.

    Standard: "fmi2GetFMUstate makes a copy of the internal FMU state and returns a pointer to this
    copy"

    Why: A solver goes back over an event.

    Remedy: Copy all that a simulation needs to go on, or set the flag to false

    Example: The continuous states are left out.
    """
    if not bench.description.exchange_flag("canGetAndSetFMUstate"):
        raise NotApplicable("canGetAndSetFMUstate is false")
    count = _states(bench)
    description = bench.description
    real = tuple(v for v in description.variables if v.base == "Real")
    instance, _ = _continuous(bench)
    before = (_got(instance, "GetDerivatives", count), read(instance, real))
    status, state = instance.get_state()
    demand(status, "fmi2GetFMUstate")
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime")
    demand(
        instance.set_states(_moved(_got(instance, "GetContinuousStates", count))),
        "fmi2SetContinuousStates",
    )
    demand(instance.enter_event_mode(), "fmi2EnterEventMode")
    excite(instance, description, 1)
    _settled(instance, bench.grid.time(1))
    demand(instance.set_state(state), "fmi2SetFMUstate")
    after = (_got(instance, "GetDerivatives", count), read(instance, real))
    for v in real:
        if not same(before[1][v.index], after[1][v.index]):
            was, now = before[1][v.index], after[1][v.index]
            yield f"after fmi2SetFMUstate {v.name} is {now!r}, before {was!r}"
    if not all(map(same, before[0], after[0])):
        yield f"after fmi2SetFMUstate the derivatives are {after[0]}, before {before[0]}"
    # It went back to continuous-time mode, too.
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime after fmi2SetFMUstate")
    demand(instance.free_state(state), "fmi2FreeFMUstate")
    instance.free()


@dynamic("FMI2-ME-13", "2.1.6", Level.VIOLATION, interface=MODEL_EXCHANGE)
def reset_is_new(bench: Bench) -> Iterator[str]:
    """After fmi2Reset a model exchange is as a new one.

    Standard: "The FMU goes into the same state as if fmi2Instantiate would have been called. All
    variables have their default values."

    Why: Sweeps reset in place of making a new instance.

    Remedy: Set every value back in fmi2Reset

    Example: A continuous state that survives.
    """
    count = _states(bench)
    instance, _ = _continuous(bench)
    x = _got(instance, "GetContinuousStates", count)
    slopes = _got(instance, "GetDerivatives", count)
    demand(instance.set_time(bench.grid.time(3)), "fmi2SetTime")
    demand(instance.set_states(_moved(x)), "fmi2SetContinuousStates")
    demand(instance.reset(), "fmi2Reset in continuous-time mode")
    demand(instance.setup(bench.grid.start), "fmi2SetupExperiment after fmi2Reset")
    demand(instance.enter(), "fmi2EnterInitializationMode after fmi2Reset")
    excite(instance, bench.description, 0)
    demand(instance.leave(), "fmi2ExitInitializationMode after fmi2Reset")
    _settled(instance, bench.grid.start)
    again = _got(instance, "GetContinuousStates", count)
    for (v, _), one, other in zip(bench.description.state_vector, x, again, strict=True):
        if not same(one, other):
            yield f"after the reset {v.name} starts with {other!r} instead of {one!r}"
    if not all(map(same, slopes, _got(instance, "GetDerivatives", count))):
        yield "after the reset the derivatives are other ones"
    instance.free()
