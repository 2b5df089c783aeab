"""Rules about model exchange (section 3): which calls each mode allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.exchange import continuous, numbers_of, settled
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read
from congelation.conformance.rule import MODEL_EXCHANGE, Level, dynamic
from congelation.conformance.trajectory import demand, excite

__all__: list[str] = []


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
    settled(instance, bench.grid.start)
    demand(instance.enter_continuous_time_mode(), "fmi2EnterContinuousTimeMode")
    yield from look(instance, "continuous-time mode")
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime in continuous-time mode")
    x = numbers_of(instance, "GetContinuousStates", count)
    demand(instance.set_states(x), "fmi2SetContinuousStates in continuous-time mode")
    demand(instance.completed_step()[0], "fmi2CompletedIntegratorStep")
    demand(instance.enter_event_mode(), "fmi2EnterEventMode")
    excite(instance, bench.description, 1)
    settled(instance, bench.grid.time(1))
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
            instance = bench.exchange() if mode == "event mode" else continuous(bench)[0]
            bench.library.probe = f"in {mode}"
            status = call(instance)
            if status in (Status.OK, Status.WARNING, Status.PENDING):
                yield f"{name} in {mode} returned {status}"
            if status != Status.FATAL:
                instance.free()
