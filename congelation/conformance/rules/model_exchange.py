"""Rules about model exchange (section 3): modes, continuous states, events, capability flags.

Of an FMU that is for co-simulation, too, both kinds are of one model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.instance import Instance
from congelation.conformance.model_exchange import (
    Model,
    integrated,
    moved,
    require_states,
    without_slopes,
)
from congelation.conformance.probe import QUOTIENT_STEP, is_derivative, read
from congelation.conformance.rule import Level, NotEvaluated, dynamic
from congelation.conformance.rules.fmu_states import restore, save
from congelation.conformance.trajectory import demand, excite, same

__all__: list[str] = []

# Time events that are visited one after another.
_EVENTS = 4
# Steps of the Runge-Kutta method in a communication step; half as many tell its error.
_SUBSTEPS = 16
# The largest share of the way of a state by which both kinds may differ.
_DISAGREEMENT = 1e-2


@dynamic("FMI2-ME-01", "3.2.3", Level.VIOLATION)
def allowed_calls(bench: Bench) -> Iterator[str]:
    """Every call that the table allows in a mode of model exchange succeeds there.

    Standard: "x means: call is allowed in the corresponding state"

    Why: Solvers rely on the table.

    Remedy: Let the call succeed in this mode

    Example: fmi2EnterEventMode refused in continuous-time mode.
    """
    outputs = tuple(v for v in bench.description.variables if v.causality == "output")
    count = len(bench.description.state_vector)
    numbers = {
        "GetContinuousStates": count,
        "GetDerivatives": count,
        "GetNominalsOfContinuousStates": count,
        "GetEventIndicators": bench.description.indicators,
    }

    def look(model: Model, mode: str) -> Iterator[str]:
        for name, length in numbers.items():
            status, values = model.instance.vector(name, length)
            if status not in (Status.OK, Status.WARNING):
                yield f"fmi2{name} in {mode} returned {status}"
            elif not all(map(math.isfinite, values)):
                yield f"fmi2{name} in {mode}: a number is not finite"
        read(model.instance, outputs)

    model = Model(bench)
    yield from look(model, "event mode")
    model.settle(bench.grid.start)
    model.enter_continuous_time_mode()
    yield from look(model, "continuous-time mode")
    model.set_time(bench.grid.time(1), " in continuous-time mode")
    status = model.instance.set_states(model.x)
    demand(status, "fmi2SetContinuousStates in continuous-time mode")
    model.end_step()
    model.enter_event_mode()
    model.excite(1)
    model.settle(bench.grid.time(1))
    yield from look(model, "event mode after a step")
    model.enter_continuous_time_mode(" after an event")
    demand(model.instance.terminate(), "fmi2Terminate in continuous-time mode")
    read(model.instance, outputs)
    model.instance.free()
    model = Model(bench)
    demand(model.instance.terminate(), "fmi2Terminate in event mode")
    model.instance.free()


@dynamic("FMI2-ME-02", "3.2.3", Level.ROBUSTNESS)
def forbidden_calls(bench: Bench) -> Iterator[str]:
    """A call that belongs to another mode of model exchange is refused.

    Standard: the table does not allow the call; what it returns is not said.

    Why: A solver with a wrong order of calls gets numbers instead of an error.

    Remedy: Check the mode at the head of each function, and return fmi2Error

    Example: fmi2EnterContinuousTimeMode in continuous-time mode.
    """
    step = partial(Instance.step, time=bench.grid.start, size=bench.grid.step)
    forbidden: dict[str, dict[str, Callable[[Instance], Status]]] = {
        "event mode": {
            "fmi2EnterEventMode": Instance.enter_event_mode,
            "fmi2CompletedIntegratorStep": lambda i: i.completed_step()[0],
            "fmi2DoStep": step,
        },
        "continuous-time mode": {
            "fmi2EnterContinuousTimeMode": Instance.enter_continuous_time_mode,
            "fmi2NewDiscreteStates": lambda i: i.new_discrete_states()[0],
            "fmi2DoStep": step,
        },
    }
    if x := [0.0] * len(bench.description.state_vector):
        forbidden["event mode"]["fmi2SetContinuousStates"] = lambda i: i.set_states(x)
    for mode, calls in forbidden.items():
        for name, call in calls.items():
            bench.library.probe = ""
            model = Model(bench) if mode == "event mode" else Model.continuous(bench)
            bench.library.probe = f"in {mode}"
            status = call(model.instance)
            if status in (Status.OK, Status.WARNING, Status.PENDING):
                yield f"{name} in {mode} returned {status}"
            model.instance.free()


@dynamic("FMI2-ME-03", "3.2.1, 3.2.2", Level.VIOLATION)
def states_are_set(bench: Bench) -> Iterator[str]:
    """The states are those that were set, by fmi2GetContinuousStates and as variables.

    Standard: fmi2SetContinuousStates: "Set a new (continuous) state vector"

    Why: A solver repeats steps from former states.

    Remedy: Store what fmi2SetContinuousStates gets

    Example: A state that is computed inside the FMU.
    """
    states = tuple(state for state, _ in bench.description.state_vector)
    model = Model.continuous(bench)
    x = model.x
    for vector in (moved(x), x):
        model.x = vector
        found, variables = model.x, read(model.instance, states)
        for v, wanted, value in zip(states, vector, found, strict=True):
            if not same(value, wanted):
                yield f"{v.name} was set to {wanted!r} and is {value!r}"
            elif not same(variables[v.index], wanted):
                yield f"{v.name} was set to {wanted!r}; as a variable it is {variables[v.index]!r}"
    model.instance.free()


@dynamic("FMI2-ME-04", "3.2.2, 2.2.7", Level.VIOLATION)
def derivatives_are_variables(bench: Bench) -> Iterator[str]:
    """The derivatives are the variables that modelDescription.xml lists as Derivatives.

    Standard: fmi2GetDerivatives: "The derivatives are returned as a vector with nx elements"; its
    order is that of the list Derivatives of ModelStructure.

    Why: Tools read derivatives either way.

    Remedy: Return the values of the listed variables, in their order

    Example: Derivatives in another order than the list.
    """
    derivatives = tuple(derivative for _, derivative in bench.description.state_vector)
    model = Model.continuous(bench)
    model.x = moved(model.x)
    found, variables = model.rates, read(model.instance, derivatives)
    for v, value in zip(derivatives, found, strict=True):
        if not same(value, variables[v.index]):
            yield f"{v.name} is {variables[v.index]!r}, by fmi2GetDerivatives {value!r}"
    model.instance.free()


@dynamic("FMI2-ME-05", "3.2.1", Level.VIOLATION)
def derivatives_follow(bench: Bench) -> Iterator[str]:
    """In continuous-time mode derivatives follow from time, states and inputs alone.

    Standard: fmi2SetTime: "re-initialize caching of variables that depend on time, provided the
    newly provided time value is different to the previously set time value"; for the states
    fmi2SetContinuousStates does the same.

    Why: Solvers evaluate at trial points, and step back in time.

    Remedy: Remember nothing from one evaluation to the next

    Example: A difference quotient over the last two calls in place of a derivative.
    """
    model = Model.continuous(bench)
    x, first = model.x, model.rates
    for time, states in ((bench.grid.time(1), moved(x)), (bench.grid.start, x)):
        model.set_time(time)
        model.x = states
        again = model.rates
    for (_, v), one, other in zip(bench.description.state_vector, first, again, strict=True):
        if not same(one, other):
            yield f"{v.name} is {other!r} after an evaluation elsewhere, {one!r} before"
    model.instance.free()


@dynamic("FMI2-ME-06", "3.2.2", Level.VIOLATION)
def completed_step_keeps(bench: Bench) -> Iterator[str]:
    """fmi2CompletedIntegratorStep leaves the continuous states as they are.

    Standard: "This function must be called by the environment after every completed step of the
    integrator": states change in Event Mode alone.

    Why: A multistep method goes on with the states that it knows.

    Remedy: Ask for Event Mode by enterEventMode, and change states there

    Example: A state that is projected in fmi2CompletedIntegratorStep.
    """
    model = Model.continuous(bench)
    before = model.x
    model.end_step()
    for (v, _), one, other in zip(bench.description.state_vector, before, model.x, strict=True):
        if not same(one, other):
            yield f"{v.name} went from {one!r} to {other!r}"
    model.instance.free()


@dynamic("FMI2-ME-07", "3.2.2", Level.VIOLATION)
def nominals(bench: Bench) -> Iterator[str]:
    """The nominal values of the states are positive, and those of modelDescription.xml.

    Standard: "it is required that x_nominal[i] > 0.0"

    Why: Solvers scale their tolerances by them.

    Remedy: Return the attribute nominal of each state, 1 where there is none

    Example: 0 for a state that starts at 0.
    """
    model = Model.continuous(bench)
    found = model.numbers("GetNominalsOfContinuousStates")
    for (v, _), value in zip(bench.description.state_vector, found, strict=True):
        given = v.bound("nominal")
        if not 0.0 < value < math.inf:
            yield f"the nominal value of {v.name} is {value!r}"
        elif given is not None and value != given:
            bench.notes.append(f"the nominal value of {v.name} is {value!r}, in the XML {given!r}")
    model.instance.free()


@dynamic("FMI2-ME-08", "3.2.2", Level.VIOLATION)
def time_events(bench: Bench) -> Iterator[str]:
    """Event iterations end, and the next time event is later than the present time.

    Standard: "the simulation shall integrate at most until time = nextEventTime, and shall call
    fmi2EnterEventMode at this time instant"

    Why: A solver that is sent to the same time again does not end.

    Remedy: At the time of an event, announce the one after it

    Example: The event at which the FMU stands is announced again.
    """
    model, time, seen = Model(bench), bench.grid.start, 0
    for _ in range(_EVENTS):
        before = model.x if bench.description.state_vector else []
        info = model.settle(time)
        after = model.x if bench.description.state_vector else []
        if info.valuesOfContinuousStatesChanged and all(map(same, before, after)):
            yield f"at t = {time:.9g} valuesOfContinuousStatesChanged is true, and none changed"
        if not info.nextEventTimeDefined:
            break
        if not info.nextEventTime > time:
            yield f"at t = {time!r} the next event is announced for {info.nextEventTime!r}"
            break
        seen += 1
        time = info.nextEventTime
        model.enter_continuous_time_mode()
        model.set_time(time, f" to the event at {time:.9g}")
        model.end_step()
        model.enter_event_mode()
    model.instance.free()
    if not seen:
        bench.notes.append("no time event is announced")


# -- where the FMU is for co-simulation, too -------------------------------------------------------


@dynamic("FMI2-ME-09", "3.1, 4.1", Level.ROBUSTNESS)
def derivatives_are_slopes(bench: Bench) -> Iterator[str]:
    """Where the FMU is for co-simulation, too, its states move there at the rate of their
    derivatives.

    Standard: nothing; both kinds are of one model.

    Why: A user expects the same results of both kinds.

    Remedy: Compute both from the same equations

    Example: A derivative without its input.
    """
    require_states(bench)
    description = without_slopes(bench)
    bench.require_flag("canHandleVariableCommunicationStepSize")
    states = tuple(state for state, _ in description.state_vector)
    model = Model.continuous(bench, description)
    slave = bench.initialize(bench.fresh("slave"), description=description)
    time = bench.grid.start
    for _ in range(2):
        begin = [float(value) for value in read(slave, states).values()]
        model.set_time(time)
        model.x = begin
        slopes = model.rates
        excite(slave, description, 0)
        demand(slave.step(time, QUOTIENT_STEP), "fmi2DoStep")
        end = [float(value) for value in read(slave, states).values()]
        for (_, v), x, y, slope in zip(description.state_vector, begin, end, slopes, strict=True):
            quotient = (y - x) / QUOTIENT_STEP
            if not is_derivative(slope, quotient):
                yield f"{v.name} is {slope!r} at t = {time:.9g}; measured: {quotient!r}"
        # Once more after a step, where the states have left their start values.
        time += QUOTIENT_STEP
        demand(slave.step(time, bench.grid.step), "fmi2DoStep")
        time += bench.grid.step
    for each in (model.instance, slave):
        each.free()


@dynamic("FMI2-ME-10", "3.1, 4.1", Level.ROBUSTNESS, time_factor=2.0)
def kinds_agree(bench: Bench) -> Iterator[str]:
    """Integrated by the importer, the states are those of co-simulation, across events, too.

    Standard: nothing; both kinds are of one model.

    Why: A user expects the same results of both kinds.

    Remedy: Compute both from the same equations, with the same events

    Example: A jump of a parameter that model exchange does not announce.
    """
    require_states(bench)
    description = without_slopes(bench)
    states = tuple(state for state, _ in description.state_vector)
    slave = bench.initialize(bench.fresh("slave"), description=description)
    expected = [[float(value) for value in read(slave, states).values()]]
    for point in range(bench.grid.steps):
        excite(slave, description, point)
        time = bench.grid.time(point)
        demand(slave.step(time, bench.grid.time(point + 1) - time), f"fmi2DoStep at t = {time:.9g}")
        expected.append([float(value) for value in read(slave, states).values()])
    slave.free()
    coarse = integrated(bench, description, _SUBSTEPS // 2)
    fine = integrated(bench, description, _SUBSTEPS)
    for i, v in enumerate(states):
        own = [row[i] for row in expected]
        way = max(abs(value - own[0]) for value in own)
        unsure = max(abs(a[i] - b[i]) for a, b in zip(coarse, fine, strict=True))
        apart = max(abs(row[i] - value) for row, value in zip(fine, own, strict=True))
        if not unsure <= _DISAGREEMENT * (way + 1e-6):
            raise NotEvaluated(f"{_SUBSTEPS} steps of Runge and Kutta are too few for {v.name}")
        if not apart <= _DISAGREEMENT * way + 1e-6 * (1.0 + abs(own[0])):
            yield f"{v.name} differs by {apart:.3g} between both kinds; it moves by {way:.3g}"


@dynamic("FMI2-ME-11", "2.1.9, 3.3.1", Level.VIOLATION)
def jacobian(bench: Bench) -> Iterator[str]:
    """With providesDirectionalDerivative the derivatives with respect to states are those
    measured.

    Standard: "fmi2GetDirectionalDerivative computes a linear combination of the partial
    derivatives"

    Why: Implicit solvers take their Jacobian from it.

    Remedy: Return the derivatives, or set the flag to false

    Example: 0 for every state.
    """
    require_states(bench)
    bench.require_flag("providesDirectionalDerivative", exchange=True)
    vector = bench.description.state_vector
    unknowns = [derivative.reference for _, derivative in vector]
    model = Model.continuous(bench)
    x = moved(model.x)

    def rates(states: Sequence[float]) -> list[float]:
        model.x = states
        return model.rates

    for i, (state, _) in enumerate(vector):
        step = QUOTIENT_STEP * (1.0 + abs(x[i]))
        high, low = (rates([*x[:i], x[i] + d, *x[i + 1 :]]) for d in (step, -step))
        model.x = x
        status, found = model.instance.directional_derivative(unknowns, [state.reference], [1.0])
        demand(status, f"fmi2GetDirectionalDerivative with respect to {state.name}")
        for (_, v), a, b, value in zip(vector, high, low, found, strict=True):
            quotient = (a - b) / (2 * step)
            if not is_derivative(value, quotient):
                yield f"d {v.name} / d {state.name} is {value!r}, measured {quotient!r}"
    model.instance.free()


@dynamic("FMI2-ME-12", "2.1.8, 3.3.1", Level.VIOLATION)
def state_holds(bench: Bench) -> Iterator[str]:
    """With canGetAndSetFMUstate of model exchange a state brings time, states and inputs back.

    Standard: "fmi2GetFMUstate makes a copy of the internal FMU state and returns a pointer to this
    copy"

    Why: A solver goes back over an event.

    Remedy: Copy all that a simulation needs to go on, or set the flag to false

    Example: The continuous states are left out.
    """
    bench.require_flag("canGetAndSetFMUstate", exchange=True)
    real = tuple(v for v in bench.description.variables if v.base == "Real")
    model = Model.continuous(bench)
    rates, values = model.rates, read(model.instance, real)
    state = save(model.instance)
    model.set_time(bench.grid.time(1))
    model.x = moved(model.x)
    model.enter_event_mode()
    model.excite(1)
    model.settle(bench.grid.time(1))
    restore(model.instance, state)
    again, found = model.rates, read(model.instance, real)
    for v in real:
        if not same(values[v.index], found[v.index]):
            was, now = values[v.index], found[v.index]
            yield f"after fmi2SetFMUstate {v.name} is {now!r}, before {was!r}"
    if not all(map(same, rates, again)):
        yield f"after fmi2SetFMUstate the derivatives are {again}, before {rates}"
    # It went back to continuous-time mode, too.
    model.set_time(bench.grid.time(1), " after fmi2SetFMUstate")
    demand(model.instance.free_state(state), "fmi2FreeFMUstate")
    model.instance.free()


@dynamic("FMI2-ME-13", "2.1.6", Level.VIOLATION)
def reset_is_new(bench: Bench) -> Iterator[str]:
    """After fmi2Reset a model exchange is as a new one.

    Standard: "The FMU goes into the same state as if fmi2Instantiate would have been called. All
    variables have their default values."

    Why: Sweeps reset in place of making a new instance.

    Remedy: Set every value back in fmi2Reset

    Example: A continuous state that survives.
    """
    model = Model.continuous(bench)
    x, rates = model.x, model.rates
    model.set_time(bench.grid.time(3))
    model.x = moved(x)
    demand(model.instance.reset(), "fmi2Reset in continuous-time mode")
    bench.initialize(model.instance, what=" after fmi2Reset")
    model.settle(bench.grid.start)
    for (v, _), one, other in zip(bench.description.state_vector, x, model.x, strict=True):
        if not same(one, other):
            yield f"after the reset {v.name} starts with {other!r} instead of {one!r}"
    if not all(map(same, rates, model.rates)):
        yield "after the reset the derivatives are other ones"
    model.instance.free()
