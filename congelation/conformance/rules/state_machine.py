"""Rules about the state machine of section 4.2.4, and about fmi2Reset."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from ctypes import byref, c_double, c_int
from functools import partial

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Variable
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read, shifted
from congelation.conformance.rule import (
    NOT_RESTORED,
    Level,
    NotApplicable,
    Violated,
    dynamic,
    require,
)
from congelation.conformance.trajectory import demand, excite, inputs, observe, same

__all__: list[str] = []

_Call = Callable[[Bench, Instance], Status]

# fmi2StatusKind
_LAST_TIME, _TERMINATED = 2, 3

# A step so many times as large as usual may be more than the FMU can do.
_LARGE = 1000.0


def _terminated(bench: Bench) -> Instance:
    instance = bench.ready()
    demand(instance.terminate(), "fmi2Terminate")
    return instance


# How to get a new instance into each state in which a master leaves it, at the start time.
_STATES: Mapping[str, Callable[[Bench], Instance]] = {
    "instantiated": lambda bench: bench.fresh(),
    "Initialization Mode": lambda bench: bench.begin(bench.fresh()),
    "stepComplete": lambda bench: bench.ready(),
    "terminated": _terminated,
}


def _get(bench: Bench, instance: Instance) -> Status:
    readable = _readable_in_initialization(bench)
    variables = readable or bench.description.variables[:1]
    return instance.get(variables[0].base, [variables[0].reference])[0]


def _set(bench: Bench, instance: Instance) -> Status:
    found = [v for v in bench.description.variables if v.is_exact and v.start is not None]
    if not found or found[0].start is None:
        return Status.OK
    return instance.set(found[0].base, [found[0].reference], [found[0].start])


def _step(bench: Bench, instance: Instance) -> Status:
    return instance.step(bench.grid.start, bench.grid.step)


# The calls of the table in section 4.2.4 that change the state or need one.
_CALLS: Mapping[str, _Call] = {
    "fmi2SetupExperiment": lambda bench, instance: instance.setup(bench.grid.start),
    "fmi2EnterInitializationMode": lambda bench, instance: instance.enter(),
    "fmi2ExitInitializationMode": lambda bench, instance: instance.leave(),
    "fmi2Terminate": lambda bench, instance: instance.terminate(),
    "fmi2GetXXX": _get,
    "fmi2SetXXX": _set,
    "fmi2DoStep": _step,
    "fmi2CancelStep": lambda bench, instance: instance.call("CancelStep"),
}

# Which of these calls the table allows; fmi2SetXXX of an exact variable only before the steps.
_ALLOWED: Mapping[str, frozenset[str]] = {
    "instantiated": frozenset({"fmi2SetupExperiment", "fmi2SetXXX"}),
    "Initialization Mode": frozenset({"fmi2ExitInitializationMode", "fmi2GetXXX", "fmi2SetXXX"}),
    "stepComplete": frozenset({"fmi2Terminate", "fmi2GetXXX", "fmi2DoStep"}),
    "terminated": frozenset({"fmi2GetXXX"}),
}


def _readable_in_initialization(bench: Bench) -> tuple[Variable, ...]:
    """Outputs and InitialUnknowns (note 2 of the table)."""
    unknowns = {unknown.index for unknown in bench.description.initial_unknowns}
    return tuple(
        v for v in bench.description.variables if v.causality == "output" or v.index in unknowns
    )


@dynamic("FMI2-STATE-01", "4.2.4", Level.VIOLATION)
def allowed_calls(bench: Bench) -> Iterator[str]:
    """Every call that the table allows in a state succeeds there.

    Standard: "x means: call is allowed in the corresponding state"

    Why: Hosts rely on the table.

    Remedy: Let the call succeed in this state

    Example: fmi2GetReal of an output refused in Initialization Mode.
    """
    for state, reach in _STATES.items():
        for name in sorted(_ALLOWED[state]):
            instance = reach(bench)
            if state == "stepComplete" and name == "fmi2DoStep":
                excite(instance, bench.description, 0)
            status = _CALLS[name](bench, instance)
            if status not in (Status.OK, Status.WARNING):
                yield f"{name} in state {state} returned {status}"
            instance.free()
        instance = reach(bench)
        for on in (True, False):
            demand(instance.set_logging(on), f"fmi2SetDebugLogging in state {state}")
        if state == "Initialization Mode":
            read(instance, _readable_in_initialization(bench))
        instance.free()


@dynamic("FMI2-STATE-02", "4.2.4", Level.ROBUSTNESS)
def no_step_outside(bench: Bench) -> Iterator[str]:
    """fmi2DoStep is refused before initialization, during it, and after fmi2Terminate.

    Standard: the table does not allow the call; what it returns is not said.

    Why: A host with a wrong order of calls gets numbers instead of an error.

    Remedy: Return fmi2Error outside of stepComplete

    Example: A step that is made before initialization.
    """
    for state in ("instantiated", "Initialization Mode", "terminated"):
        instance = _STATES[state](bench)
        bench.library.probe = f"in {state}"
        status = _step(bench, instance)
        if status in (Status.OK, Status.WARNING, Status.PENDING):
            yield f"fmi2DoStep in state {state} returned {status}"
        instance.free()


@dynamic("FMI2-STATE-03", "4.2.4", Level.ROBUSTNESS)
def forbidden_calls(bench: Bench) -> Iterator[str]:
    """A call that the table forbids in a state does no harm: the instance can be reset and is as
    new.

    Standard: the table does not allow the call; what it returns is not said.

    Why: A mistake of the host should be an error and no crash.

    Remedy: Check the state at the head of each function

    Example: fmi2DoStep on a null pointer of data not yet made.
    """
    for state, reach in _STATES.items():
        for name, call in _CALLS.items():
            if name in _ALLOWED[state]:
                continue
            bench.library.probe = ""
            instance = reach(bench)
            bench.library.probe = f"{name} in {state}"
            status = call(bench, instance)
            what = f"after {name} in state {state}"
            if status == Status.FATAL:
                yield f"{name} in state {state} returned {status}"
                continue
            demand(instance.reset(), f"fmi2Reset {what}")
            yield from bench.compare(bench.run(bench.initialize(instance)), what)
            instance.free()


@dynamic("FMI2-STATE-04", "2.1.6", Level.VIOLATION)
def values_after_termination(bench: Bench) -> Iterator[str]:
    """After fmi2Terminate the final values of all variables can be read.

    Standard: "After calling this function, the final values of all variables can be inquired"

    Why: Hosts read results last.

    Remedy: Keep the values until fmi2FreeInstance

    Example: Data freed in fmi2Terminate.
    """
    with bench.held() as instance:
        bench.run(instance)
        before = observe(instance, bench.description)
        demand(instance.terminate(), "fmi2Terminate")
        after = observe(instance, bench.description)
        if not all(map(same, before, after)):
            yield "the values read after fmi2Terminate are not those read before"


@dynamic("FMI2-STATE-05", "4.2.3", Level.VIOLATION)
def status_inquiry(bench: Bench) -> Iterator[str]:
    """The last successful time of a discarded step is available, or fmi2Discard is returned.

    Standard: "Returns the end time of the last successfully completed communication step. Can be
    called after fmi2DoStep(..) returned fmi2Discard."; "If a status is required which cannot be
    retrieved by the slave it returns fmi2Discard."

    Why: A master repeats a discarded step up to that time.

    Remedy: Return the time that was reached, or fmi2Discard

    Example: fmi2Error for fmi2GetRealStatus.
    """
    discarded = False
    for what, fail in _FAILURES.items():
        instance = bench.fresh()
        status = fail(bench, instance)
        if status == Status.DISCARD:
            discarded = True
            time, ended = c_double(math.nan), c_int()
            answers = {
                "fmi2GetRealStatus": instance.call("GetRealStatus", _LAST_TIME, byref(time)),
                "fmi2GetBooleanStatus": instance.call(
                    "GetBooleanStatus", _TERMINATED, byref(ended)
                ),
            }
            for name, answer in answers.items():
                if answer not in (Status.OK, Status.DISCARD):
                    yield f"{name} after {what} returned {answer}"
            begin = bench.grid.time(2)
            # The step began at communication point 2 and was not completed.
            if answers["fmi2GetRealStatus"] == Status.OK and not (
                begin - 1e-9 <= time.value < begin + _LARGE * bench.grid.step
            ):
                yield f"fmi2LastSuccessfulTime is {time.value!r} after {what} from {begin!r}"
        instance.free()
    require(discarded, "no step was discarded")


@dynamic("FMI2-STATE-06", "2.2.7, 4.2.4", Level.VIOLATION)
def inputs_settable(bench: Bench) -> Iterator[str]:
    """Inputs can be set in Initialization Mode and at communication points, tunable parameters too.

    Standard: note 6 of the table: fmi2SetXXX "for a variable with causality = input or (causality
    = parameter and variability = tunable)"

    Why: Inputs are what a master sets.

    Remedy: Accept inputs and tunable parameters at communication points

    Example: A tunable parameter that is refused after initialization.
    """
    description = bench.description
    tunable = tuple(
        v
        for v in description.variables
        if v.causality == "parameter" and v.variability == "tunable" and v.start is not None
    )
    if not tunable and not inputs(description):
        raise NotApplicable("there are neither inputs nor tunable parameters")
    with bench.held() as instance:
        for point in (0, 1):
            for v in tunable:
                demand(
                    instance.set(v.base, [v.reference], [v.start if v.start is not None else 0]),
                    f"fmi2Set{v.base} of the tunable parameter {v.name}",
                )
            bench.run(instance, first=point, last=point + 1)
    yield from ()


@dynamic("FMI2-RESET-01", "2.1.6", Level.VIOLATION, owns=(NOT_RESTORED,))
def reset_is_new(bench: Bench) -> Iterator[str]:
    """After fmi2Reset an instance does what a new one does, to the last bit.

    Standard: "The FMU goes into the same state as if fmi2Instantiate would have been called. All
    variables have their default values."

    Why: Sweeps reset in place of making a new instance.

    Remedy: Set every value back in fmi2Reset

    Example: A state that survives.
    """
    with bench.held() as instance:
        bench.run(instance, phase=1.0)
        for times in ("once", "twice"):
            demand(instance.reset(), "fmi2Reset")
            found = bench.run(bench.initialize(instance))
            yield from bench.compare(found, f"after fmi2Reset {times}")


@dynamic("FMI2-RESET-02", "2.1.6", Level.VIOLATION, time_factor=2.0)
def reset_restores_starts(bench: Bench) -> Iterator[str]:
    """fmi2Reset gives every variable its default value again, also those that were set.

    Standard: "All variables have their default values."

    Why: The next run starts from the defaults.

    Remedy: Set every start value back in fmi2Reset

    Example: A parameter that survives.
    """
    description = bench.description
    settable = [v for v in description.variables if v.settable_before_start and v.start is not None]
    require(settable, "no start value can be set")
    instance = bench.fresh()
    _set_all_otherwise(bench, instance, settable)
    demand(instance.reset(), "fmi2Reset")
    found = bench.run(bench.initialize(instance))
    instance.free()
    yield from bench.compare(found, "after setting start values and fmi2Reset")


def _set_all_otherwise(bench: Bench, instance: Instance, variables: list[Variable]) -> None:
    """Set variables to other values than their starts, as far as the FMU takes them."""
    for v in variables:
        value = None if v.start is None else shifted(v, v.start, bench.description)
        if value is not None:
            instance.set(v.base, [v.reference], [value])


@dynamic("FMI2-RESET-03", "4.2.4", Level.VIOLATION, owns=("fmi2Reset",))
def reset_anywhere(bench: Bench) -> Iterator[str]:
    """fmi2Reset succeeds in every state and leads to "instantiated".

    Standard: "x means: call is allowed in the corresponding state"; fmi2Reset has it in every state
    but stepInProgress and fatal.

    Why: A host gives up a run at any point.

    Remedy: Accept fmi2Reset in every state

    Example: fmi2Error after fmi2Terminate.
    """
    for state, reach in _STATES.items():
        instance = reach(bench)
        status = instance.reset()
        if status != Status.OK:
            yield f"fmi2Reset in state {state} returned {status}"
        else:
            found = bench.run(bench.initialize(instance))
            yield from bench.compare(found, f"after fmi2Reset in state {state}")
        instance.free()


@dynamic("FMI2-RESET-04", "2.1.3, 4.2.4", Level.VIOLATION)
def reset_after_failure(bench: Bench) -> Iterator[str]:
    """After a step that was discarded or failed fmi2Reset succeeds, and the next run is that of a
    new instance.

    Standard: The table allows fmi2Reset in stepFailed and error; "It is also possible to reset the
    instance of the FMU by calling fmi2Reset"

    Why: A sweep goes on with the next run after a failed one.

    Remedy: Accept fmi2Reset after a step that failed, and set every value back

    Example: fmi2Error for every call after a discarded step.
    """
    failed = False
    for what, fail in _FAILURES.items():
        instance = bench.fresh()
        status = fail(bench, instance)
        if status in (Status.DISCARD, Status.ERROR):
            failed = True
            demand(instance.reset(), f"fmi2Reset after {what} ({status})")
            try:
                found = bench.run(bench.initialize(instance))
            except Violated as breach:
                raise Violated(f"after {what} ({status}) and fmi2Reset: {breach}") from None
            yield from bench.compare(found, f"after {what} ({status}) and fmi2Reset")
        instance.free()
    require(failed, "no step was discarded or failed")


def _past_stop(bench: Bench, instance: Instance) -> Status:
    grid = bench.grid
    demand(instance.setup(grid.start, grid.time(2)), "fmi2SetupExperiment")
    bench.initialize(instance, setup=False)
    bench.run(instance, last=2)
    return instance.step(grid.time(2), grid.step)


def _sized(factor: float, bench: Bench, instance: Instance) -> Status:
    bench.run(bench.initialize(instance), last=2)
    return instance.step(bench.grid.time(2), factor * bench.grid.step)


# Steps that an FMU may discard or fail, although the calls are correct.
_FAILURES: Mapping[str, _Call] = {
    "a step past stopTime": _past_stop,
    "a step of another size": partial(_sized, 1.7),
    "a large step": partial(_sized, _LARGE),
}
