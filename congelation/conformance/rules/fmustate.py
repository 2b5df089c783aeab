"""Rules about the complete FMU state (section 2.1.8): getting, setting and freeing it."""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_void_p

from congelation.conformance.bench import Bench
from congelation.conformance.description import Value
from congelation.conformance.instance import Instance
from congelation.conformance.probe import shifted
from congelation.conformance.rule import STATE_NOT_RESTORED, Level, NotApplicable, dynamic
from congelation.conformance.trajectory import demand, excitation, excite, inputs, same

__all__ = ["restore", "save"]


def _needs_state(bench: Bench) -> None:
    if not bench.description.flag("canGetAndSetFMUstate"):
        raise NotApplicable("canGetAndSetFMUstate is false")


def save(instance: Instance, where: str = "") -> c_void_p:
    """Get the FMU state into a new handle."""
    status, state = instance.get_state()
    demand(status, f"fmi2GetFMUstate{where}")
    return state


def restore(instance: Instance, state: c_void_p, where: str = "") -> None:
    """Set the FMU state."""
    demand(instance.set_state(state), f"fmi2SetFMUstate{where}")


@dynamic("FMI2-FMUSTATE-01", "2.1.8", Level.VIOLATION, owns=(STATE_NOT_RESTORED,))
def replay(bench: Bench) -> Iterator[str]:
    """From a state set again the simulation repeats itself, to the last bit.

    Standard: fmi2SetFMUstate "copies the content of the previously copied FMUstate back and uses
    it as actual new FMU state"

    Why: Rollback repeats a step.

    Remedy: Save everything that a simulation needs to go on

    Example: A state without the integrator's history.
    """
    _needs_state(bench)
    with bench.held() as instance:
        bench.run(instance, last=4)
        state = save(instance)
        bench.run(instance, first=4, phase=1.0)
        for times in ("once", "twice"):
            restore(instance, state)
            yield from bench.compare(bench.run(instance, first=4), f"after setting it {times}")
        demand(instance.free_state(state), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-02", "2.1.8", Level.VIOLATION)
def several_handles(bench: Bench) -> Iterator[str]:
    """Several saved states are independent of each other and of the running instance.

    Standard: fmi2GetFMUstate "makes a copy of the internal FMU state"; after fmi2SetFMUstate "The
    FMUstate copy still exists"

    Why: Iterating masters hold several states.

    Remedy: Copy, and do not share

    Example: One buffer for all states.
    """
    _needs_state(bench)
    points = (0, 3, 6, 9)
    with bench.held() as instance:
        handles: dict[int, c_void_p] = {}
        for point in points:
            bench.run(instance, first=max(point - 3, 0), last=point, quiet=True)
            handles[point] = save(instance)
        for point in (6, 0, 9, 3):
            restore(instance, handles[point])
            yield from bench.compare(bench.run(instance, first=point), f"from state {point}")
        demand(instance.free_state(handles[3]), "fmi2FreeFMUstate")
        restore(instance, handles[6])
        yield from bench.compare(bench.run(instance, first=6), "after freeing another state")
        for point in (0, 6, 9):
            demand(instance.free_state(handles[point]), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-03", "2.1.8", Level.VIOLATION)
def handle_reused(bench: Bench) -> Iterator[str]:
    """fmi2GetFMUstate into a former handle leaves the new state in it.

    Standard: "If *FMUstate != NULL, then *FMUstate points to a previously returned FMUstate"; a
    note: the memory is reused "with the actual FMUstate"

    Why: Masters save into one handle at each step.

    Remedy: Write the new state into the former handle

    Example: A former handle that keeps the old state.
    """
    _needs_state(bench)
    with bench.held() as instance:
        state = save(instance)
        bench.run(instance, last=5)
        status, state = instance.get_state(state)
        demand(status, "fmi2GetFMUstate into a former handle")
        bench.run(instance, first=5)
        restore(instance, state)
        yield from bench.compare(bench.run(instance, first=5), "from a handle used again")
        demand(instance.free_state(state), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-04", "2.1.8", Level.VIOLATION)
def freed_is_null(bench: Bench) -> Iterator[str]:
    """fmi2FreeFMUstate returns a null pointer in its argument.

    Standard: "The function returns a null pointer in argument FMUstate."

    Why: A second free does no harm then.

    Remedy: Set *FMUstate to NULL

    Example: A freed pointer that is left.
    """
    _needs_state(bench)
    with bench.held() as instance:
        state = save(instance)
        demand(instance.free_state(state), "fmi2FreeFMUstate")
        if state.value is not None:
            yield "the argument of fmi2FreeFMUstate is not null afterwards"


@dynamic("FMI2-FMUSTATE-05", "2.1.8", Level.VIOLATION)
def holds_inputs_and_parameters(bench: Bench) -> Iterator[str]:
    """The state holds the inputs and the tunable parameters.

    Standard: the state consists of "all values that are needed to continue a simulation",
    "especially of [..] parameter values, input values"

    Why: A repeated step uses the same inputs.

    Remedy: Save inputs and parameters too

    Example: A state without inputs.
    """
    _needs_state(bench)
    description = bench.description
    with bench.held() as instance:
        bench.run(instance, last=3)
        excite(instance, description, 3)
        state = save(instance)
        expected = _untouched(bench, instance)
        restore(instance, state)
        other: dict[int, Value] = {}
        for v in inputs(description):
            value = shifted(v, excitation(v, 3), description)
            other |= {} if value is None else {v.index: value}
        excite(instance, description, 3, instead=other)
        for v in description.variables:
            if v.causality == "parameter" and v.variability == "tunable" and v.start is not None:
                value = shifted(v, v.start, description)
                if value is not None:
                    instance.set(v.base, [v.reference], [value])
        restore(instance, state)
        found = _untouched(bench, instance)
        demand(instance.free_state(state), "fmi2FreeFMUstate")
    if not all(map(same, found, expected)):
        yield "a step from the state set again differs after inputs or tunable parameters were set"


def _untouched(bench: Bench, instance: Instance) -> list[Value]:
    """All values after one step, nothing set before it."""
    time = bench.grid.time(3)
    demand(instance.step(time, bench.grid.time(4) - time), "fmi2DoStep")
    # Nothing is excited between 4 and 4: this only reads.
    return list(bench.run(instance, first=4, last=4).rows[0])


@dynamic("FMI2-FMUSTATE-06", "2.1.8, 4.2.4", Level.VIOLATION)
def holds_the_mode(bench: Bench) -> Iterator[str]:
    """A state can be saved in "instantiated", Initialization Mode and stepComplete, and leads back
    there.

    Standard: the table allows fmi2GetFMUstate in instantiated, Initialization Mode and
    stepComplete; the state includes "FMU internal status information"

    Why: A host goes back behind initialization.

    Remedy: Save the mode too

    Example: A state without the mode.
    """
    _needs_state(bench)
    instance = bench.fresh()
    new = save(instance, ' in "instantiated"')
    begun = save(bench.begin(instance), " in Initialization Mode")
    demand(instance.leave(), "fmi2ExitInitializationMode")
    ready = save(instance, " in stepComplete")
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    restore(instance, ready, " in terminated")
    yield from bench.compare(bench.run(instance), "from a state before the first step")
    restore(instance, begun, " in stepComplete")
    demand(instance.leave(), "fmi2ExitInitializationMode after going back before it")
    yield from bench.compare(bench.run(instance), "from a state in Initialization Mode")
    restore(instance, new, " in stepComplete")
    found = bench.run(bench.initialize(instance))
    yield from bench.compare(found, 'from a state in "instantiated"')
    for state in (new, begun, ready):
        demand(instance.free_state(state), "fmi2FreeFMUstate")
    instance.free()


@dynamic("FMI2-FMUSTATE-07", "2.1.3, 2.1.8", Level.ROBUSTNESS)
def after_an_error(bench: Bench) -> Iterator[str]:
    """After a refused step the simulation goes on from a state saved before it.

    Standard: after fmi2Error "it can be tried to restart the simulation from a formerly stored
    FMU state".

    Why: A master goes on from there.

    Remedy: Take the instance's mode from the state

    Example: An error flag outside of the state.
    """
    _needs_state(bench)
    with bench.held() as instance:
        bench.run(instance, last=4)
        state = save(instance)
        excite(instance, bench.description, 4)
        status = instance.step(bench.grid.time(4), -bench.grid.step)
        restore(instance, state, f" after a step that returned {status}")
        yield from bench.compare(bench.run(instance, first=4), "after a refused step")
        demand(instance.free_state(state), "fmi2FreeFMUstate")
