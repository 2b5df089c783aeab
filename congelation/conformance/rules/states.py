"""Rules about the state machine of section 4.2.4, and about fmi2Reset."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping
from ctypes import byref, c_double, c_int
from typing import Any

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Variable
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read, shifted
from congelation.conformance.rule import NotApplicable, Rule, dynamic
from congelation.conformance.trajectory import demand, excite, inputs, observe, same

__all__ = ["RULES"]

_Call = Callable[[Bench, Instance], Status]

# fmi2StatusKind
_DO_STEP, _PENDING, _LAST_TIME, _TERMINATED = range(4)


def _instantiated(bench: Bench) -> Instance:
    return bench.fresh()


def _initializing(bench: Bench) -> Instance:
    return bench.begin(bench.fresh())


def _stepping(bench: Bench) -> Instance:
    return bench.ready()


def _terminated(bench: Bench) -> Instance:
    instance = bench.ready()
    demand(instance.terminate(), "fmi2Terminate")
    return instance


# How to get a new instance into each state in which a master leaves it, at the start time.
_STATES: Mapping[str, Callable[[Bench], Instance]] = {
    "instantiated": _instantiated,
    "Initialization Mode": _initializing,
    "stepComplete": _stepping,
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


@dynamic("FMI2-STATE-01", "4.2.4")
def allowed_calls(bench: Bench) -> Iterator[str]:
    """Every call that the table allows in a state succeeds there."""
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


@dynamic("FMI2-STATE-02", "4.2.4")
def no_step_outside(bench: Bench) -> Iterator[str]:
    """fmi2DoStep is refused before initialization, during it, and after fmi2Terminate."""
    for state in ("instantiated", "Initialization Mode", "terminated"):
        instance = _STATES[state](bench)
        status = _step(bench, instance)
        if status in (Status.OK, Status.WARNING, Status.PENDING):
            yield f"fmi2DoStep in state {state} returned {status}"
        instance.free()


@dynamic("FMI2-STATE-03", "4.2.4")
def forbidden_calls(bench: Bench) -> Iterator[str]:
    """A call that the table forbids in a state does no harm: the instance can be reset and is as
    new."""
    for state, reach in _STATES.items():
        for name, call in _CALLS.items():
            if name in _ALLOWED[state]:
                continue
            instance = reach(bench)
            status = call(bench, instance)
            what = f"after {name} in state {state}"
            if status == Status.FATAL:
                yield f"{name} in state {state} returned {status}"
                continue
            demand(instance.reset(), f"fmi2Reset {what}")
            yield from bench.compare(bench.run(bench.initialize(instance)), what)
            instance.free()


@dynamic("FMI2-STATE-04", "2.1.6")
def values_after_termination(bench: Bench) -> Iterator[str]:
    """After fmi2Terminate the final values of all variables can be read."""
    with bench.held() as instance:
        bench.run(instance)
        before = observe(instance, bench.description)
        demand(instance.terminate(), "fmi2Terminate")
        after = observe(instance, bench.description)
        if not all(map(same, before, after)):
            yield "the values read after fmi2Terminate are not those read before"


@dynamic("FMI2-STATE-05", "4.2.3")
def status_inquiry(bench: Bench) -> Iterator[str]:
    """A status that cannot be given is answered with fmi2Discard."""
    kinds: dict[str, tuple[int, type[ctypes._SimpleCData[Any]]]] = {
        "GetStatus": (_DO_STEP, c_int),
        "GetIntegerStatus": (_PENDING, c_int),
        "GetBooleanStatus": (_TERMINATED, c_int),
        "GetRealStatus": (_LAST_TIME, c_double),
        "GetStringStatus": (_PENDING, ctypes.c_char_p),
    }
    with bench.held() as instance:
        bench.run(instance, last=1)
        for name, (kind, holder) in kinds.items():
            status = instance.call(name, kind, byref(holder()))
            if status not in (Status.OK, Status.DISCARD):
                yield f"fmi2{name} returned {status}"


@dynamic("FMI2-RESET-01", "2.1.6")
def reset_is_new(bench: Bench) -> Iterator[str]:
    """After fmi2Reset an instance does what a new one does, to the last bit."""
    with bench.held() as instance:
        bench.run(instance, phase=1.0)
        for times in ("once", "twice"):
            demand(instance.reset(), "fmi2Reset")
            found = bench.run(bench.initialize(instance))
            yield from bench.compare(found, f"after fmi2Reset {times}")


@dynamic("FMI2-RESET-02", "2.1.6", patience=2.0)
def reset_restores_starts(bench: Bench) -> Iterator[str]:
    """fmi2Reset gives every variable its default value again, also those that were set."""
    description = bench.description
    settable = [v for v in description.variables if v.settable_before_start and v.start is not None]
    if not settable:
        raise NotApplicable("no start value can be set")
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


@dynamic("FMI2-RESET-03", "4.2.4")
def reset_anywhere(bench: Bench) -> Iterator[str]:
    """fmi2Reset succeeds in every state and leads to "instantiated"."""
    for state, reach in _STATES.items():
        instance = reach(bench)
        status = instance.reset()
        if status != Status.OK:
            yield f"fmi2Reset in state {state} returned {status}"
        else:
            found = bench.run(bench.initialize(instance))
            yield from bench.compare(found, f"after fmi2Reset in state {state}")
        instance.free()


@dynamic("FMI2-STATE-06", "2.2.7, 4.2.4")
def inputs_settable(bench: Bench) -> Iterator[str]:
    """Inputs can be set in Initialization Mode and at communication points, tunable parameters
    too."""
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


RULES: tuple[Rule, ...] = (
    allowed_calls,
    no_step_outside,
    forbidden_calls,
    values_after_termination,
    status_inquiry,
    inputs_settable,
    reset_is_new,
    reset_restores_starts,
    reset_anywhere,
)
