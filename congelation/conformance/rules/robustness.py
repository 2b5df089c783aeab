"""Rules about data that no one should send: the process lives on and the instance can be reset.

The standard leaves it to the FMU what to answer. What it does not leave open is the damage: an
error ends one run of one instance, which fmi2Reset makes as good as new (section 2.1.3), while
fmi2Fatal ends all instances and is kept for corrupted computations.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Level, dynamic, require
from congelation.conformance.trajectory import demand, excite, inputs

__all__: list[str] = []

_BAD_REALS = (math.nan, math.inf, -math.inf, 1e308, -1e308)
_BAD_INTEGERS = (2**31 - 1, -(2**31), 0, -1)
_BAD_STRINGS = ("", "x" * 100_000, "/no/such/file", "Größe θ", "%s%n")
_BAD: Mapping[str, Sequence[Value]] = {
    "Real": _BAD_REALS,
    "Integer": _BAD_INTEGERS,
    "String": _BAD_STRINGS,
}
_FAULTS = 1000
# Only this often a run is compared with the reference in the long test, to keep it short.
_COMPARE_EVERY = 100


def _not_fatal(status: Status, what: str) -> Status:
    if status == Status.FATAL:
        # No further call is allowed, so there is nothing more to learn.
        demand(status, what)
    return status


def _bad_input(bench: Bench, instance: Instance, v: Variable, value: Value) -> None:
    """A bad value in an input at a communication point, and a step with it."""
    bench.initialize(instance)
    what = f"with {_shown(value)} in {v.name}"
    excite(instance, bench.description, 0)
    _not_fatal(instance.set(v.base, [v.reference], [value]), f"fmi2Set{v.base} {what}")
    _not_fatal(instance.step(bench.grid.start, bench.grid.step), f"fmi2DoStep {what}")


def _bad_start(bench: Bench, instance: Instance, v: Variable, value: Value) -> None:
    """A bad start value or parameter, and whatever initialization and a step make of it."""
    what = f"with {_shown(value)} in {v.name}"
    calls: tuple[tuple[str, Callable[[], Status]], ...] = (
        (f"fmi2Set{v.base}", lambda: instance.set(v.base, [v.reference], [value])),
        ("fmi2SetupExperiment", lambda: instance.setup(bench.grid.start)),
        ("fmi2EnterInitializationMode", instance.enter),
        ("fmi2ExitInitializationMode", instance.leave),
        ("fmi2DoStep", lambda: instance.step(bench.grid.start, bench.grid.step)),
    )
    for name, call in calls:
        if _not_fatal(call(), f"{name} {what}") == Status.ERROR:
            return


def _shown(value: Value) -> str:
    text = repr(value)
    return text if len(text) < 40 else f"{text[:20]}... ({len(text)} characters)"


def _as_new(bench: Bench, instance: Instance, what: str) -> Iterator[str]:
    demand(instance.reset(), f"fmi2Reset {what}")
    yield from bench.compare(bench.run(bench.initialize(instance)), f"{what} and fmi2Reset")
    demand(instance.reset(), "fmi2Reset")


def _survives(
    bench: Bench,
    variables: Sequence[Variable],
    fault: Callable[[Bench, Instance, Variable, Value], None],
) -> Iterator[str]:
    instance = bench.fresh()
    for v in variables:
        for value in _BAD[v.base]:
            fault(bench, instance, v, value)
            demand(instance.reset(), f"fmi2Reset after {_shown(value)} in {v.name}")
        yield from _as_new(bench, instance, f"after bad values in {v.name}")
    instance.free()


@dynamic("FMI2-ROBUST-01", "2.1.3", Level.ROBUSTNESS, time_factor=2.0)
def bad_inputs(bench: Bench) -> Iterator[str]:
    """NaN, infinite and huge values in Real inputs do no lasting harm.

    Standard: nothing; a host's mistake should be an error and no crash.

    Why: A diverging partner sends such values.

    Remedy: Return fmi2Error or fmi2Discard, and let fmi2Reset restore all

    Example: A crash for NaN.
    """
    found = [v for v in inputs(bench.description) if v.element == "Real"]
    require(found, "there is no Real input")
    yield from _survives(bench, found, _bad_input)


@dynamic("FMI2-ROBUST-02", "2.1.3", Level.ROBUSTNESS, time_factor=3.0)
def bad_parameters(bench: Bench) -> Iterator[str]:
    """NaN, infinite and huge values in Real parameters and start values do no lasting harm.

    Standard: nothing; a host's mistake should be an error and no crash.

    Why: A sweep's table may hold such values.

    Remedy: Return fmi2Error or fmi2Discard, and let fmi2Reset restore all

    Example: A NaN that survives fmi2Reset.
    """
    found = [
        v for v in bench.description.variables if v.settable_before_start and v.element == "Real"
    ]
    require(found, "no Real start value can be set")
    yield from _survives(bench, found, _bad_start)


@dynamic("FMI2-ROBUST-03", "2.1.3", Level.ROBUSTNESS)
def bad_discrete(bench: Bench) -> Iterator[str]:
    """Extreme integers and strings, and items that an enumeration lacks, do no lasting harm.

    Standard: nothing; a host's mistake should be an error and no crash.

    Why: A file name may not exist.

    Remedy: Return fmi2Error or fmi2Discard, and let fmi2Reset restore all

    Example: An item number used as an index.
    """
    settable = [
        v
        for v in bench.description.variables
        if (v.settable_before_start or v.causality == "input") and v.base in ("Integer", "String")
    ]
    require(settable, "no Integer, Enumeration or String can be set")
    before = [v for v in settable if v.causality != "input"]
    yield from _survives(bench, before, _bad_start)
    yield from _survives(bench, [v for v in settable if v.causality == "input"], _bad_input)


@dynamic("FMI2-ROBUST-04", "2.1.3", Level.ROBUSTNESS, time_factor=4.0)
def many_faults(bench: Bench) -> Iterator[str]:
    """A thousand faults in a row (bad inputs, steps, parameters, states) do not end the process.

    Standard: nothing; a host lives on after failed runs.

    Why: A sweep of a thousand runs meets a thousand failures.

    Remedy: Return fmi2Error and let fmi2Reset restore all

    Example: A leak or a crash after some failures.
    """
    # Fixed seed: the same faults in every check.
    chance = random.Random(3)
    faults = _faults(bench)
    instance = bench.fresh()
    for number in range(_FAULTS):
        chance.choice(faults)(bench, instance, chance)
        demand(instance.reset(), f"fmi2Reset after fault {number}")
        if number % _COMPARE_EVERY == 0:
            yield from _as_new(bench, instance, f"after fault {number}")
    yield from _as_new(bench, instance, f"after {_FAULTS} faults")
    instance.free()


_Fault = Callable[[Bench, Instance, random.Random], None]


def _faults(bench: Bench) -> list[_Fault]:
    description = bench.description
    reals = [v for v in inputs(description) if v.element == "Real"]
    starts = [v for v in description.variables if v.settable_before_start and v.base in _BAD]

    def wrong_input(bench: Bench, instance: Instance, chance: random.Random) -> None:
        _bad_input(bench, instance, chance.choice(reals), chance.choice(_BAD_REALS))

    def wrong_start(bench: Bench, instance: Instance, chance: random.Random) -> None:
        v = chance.choice(starts)
        _bad_start(bench, instance, v, chance.choice(_BAD[v.base]))

    def wrong_step(bench: Bench, instance: Instance, chance: random.Random) -> None:
        bench.initialize(instance)
        size = chance.choice((0.0, -1.0, math.nan))
        _not_fatal(instance.step(bench.grid.start, size), f"fmi2DoStep with h = {size:g}")

    def wrong_state(bench: Bench, instance: Instance, chance: random.Random) -> None:
        bench.initialize(instance)
        data = chance.randbytes(chance.randrange(200))
        status, state = instance.deserialize(data)
        if _not_fatal(status, "fmi2DeSerializeFMUstate of noise") == Status.OK:
            _not_fatal(instance.set_state(state), "fmi2SetFMUstate of noise")
            instance.free_state(state)

    faults: list[_Fault] = [wrong_step]
    if reals:
        faults.append(wrong_input)
    if starts:
        faults.append(wrong_start)
    if description.flag("canSerializeFMUstate"):
        faults.append(wrong_state)
    return faults
