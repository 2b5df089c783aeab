"""Rules about getting and setting values (sections 2.1.2, 2.1.7 and 2.2.7)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from decimal import Decimal
from functools import partial

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import BASE_TYPES, Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read, shifted
from congelation.conformance.rule import Level, dynamic, require
from congelation.conformance.trajectory import by_base, demand, excite, inputs, same

__all__ = ["UNKNOWN"]

# What the calls with a reference that does not exist are noted as.
UNKNOWN = "an unknown value reference"

# Start values of the XML and of the code are equal if they agree to this, or to half the last digit
# of a number in the XML that is long enough to be a rounded one.
_EQUAL, _ROUNDED = 1e-12, 6

_Attempt = Callable[[Instance], Status]

_LARGEST = 2**32 - 1
_ANY: dict[str, Value] = {"Real": 0.5, "Integer": 1, "Boolean": True, "String": "text"}


def _initialized(bench: Bench, instance: Instance, *, excited: bool = False) -> Status:
    """Initialize, inputs left alone unless asked for; the first status that is not fmi2OK."""
    for status in (instance.setup(bench.grid.start), instance.enter()):
        if status != Status.OK:
            return status
    if excited:
        excite(instance, bench.description, 0)
    return instance.leave()


@dynamic("FMI2-VALUE-01", "2.2.7", Level.VIOLATION)
def start_values(bench: Bench) -> Iterator[str]:
    """The start values in modelDescription.xml are those of the FMU.

    Standard: "Initial or guess value of variable. This value is also stored in the C functions."

    Why: Hosts show the XML's values and do not set them.

    Remedy: Write the start values of the code into the XML

    Example: k = 1.6 in the code, start="1.5" in the XML.
    """
    started = tuple(v for v in bench.description.variables if v.start is not None)
    require(started, "no variable has a start value")
    instance = bench.fresh()
    demand(_initialized(bench, instance), "initialization")
    found = read(instance, tuple(v for v in started if v.initial != "approx"))
    instance.free()
    for v in started:
        if v.index in found and not _equal(v, found[v.index]):
            yield f"{v.name} starts with {found[v.index]!r}, the XML says {v.start!r}"


def _equal(v: Variable, value: Value) -> bool:
    if v.base == "Boolean":
        return value == int(bool(v.start))
    if v.base == "Real" and v.start_text is not None:
        # The XML may hold fewer digits than the code.
        _, digits, exponent = Decimal(v.start_text.strip()).as_tuple()
        given, found = float(v.start_text), float(value)
        slack = _EQUAL * abs(given)
        if isinstance(exponent, int) and max(len(digits), -exponent) >= _ROUNDED:
            slack = max(slack, 0.5 * 10.0**exponent)
        return abs(found - given) <= slack
    return value == v.start


@dynamic("FMI2-VALUE-02", "2.1.7, 2.2.7", Level.VIOLATION, time_factor=2.0)
def set_values(bench: Bench) -> Iterator[str]:
    """What is set before or during initialization is read after it.

    Standard: the value is "either the start value [..] or the value provided by fmi2SetXXX"

    Why: A parameter that is ignored spoils a study silently.

    Remedy: Store the value, or return fmi2Discard

    Example: fmi2OK for a value that is not kept.
    """
    description = bench.description
    instance = bench.fresh()
    for v in description.variables:
        if v.start is None or not (v.is_exact or v.causality == "input"):
            continue
        value = shifted(v, v.start, description)
        if value is None or not _set_and_initialize(bench, instance, v, value):
            demand(instance.reset(), "fmi2Reset")
            continue
        found = read(instance, (v,))[v.index]
        if not (same(found, value) or (v.base == "Boolean" and found == int(value is True))):
            yield f"{v.name} was set to {value!r} and is {found!r}"
        demand(instance.reset(), "fmi2Reset")
    instance.free()


def _set_and_initialize(bench: Bench, instance: Instance, v: Variable, value: Value) -> bool:
    """Set one variable where the table allows it; False if the FMU does not take the value."""
    if v.causality != "input":
        if instance.set(v.base, [v.reference], [value]) != Status.OK:
            return False
        return _initialized(bench, instance) == Status.OK
    demand(instance.setup(bench.grid.start), "fmi2SetupExperiment")
    demand(instance.enter(), "fmi2EnterInitializationMode")
    if instance.set(v.base, [v.reference], [value]) != Status.OK:
        return False
    return instance.leave() == Status.OK


@dynamic("FMI2-VALUE-03", "2.2.7", Level.VIOLATION)
def fixed_values(bench: Bench) -> Iterator[str]:
    """Constants, parameters and fixed variables do not change after initialization.

    Standard: fixed: "after fmi2ExitInitializationMode was called the variable value does not
    change anymore"; constant: "never changes"

    Why: Hosts read such values once.

    Remedy: Declare the variable discrete or continuous

    Example: A counter that is declared fixed.
    """
    kept = tuple(
        v for v in bench.description.variables if v.variability in ("constant", "fixed", "tunable")
    )
    require(kept, "there are no constants, parameters or fixed variables")
    with bench.held() as instance:
        before = read(instance, kept)
        bench.run(instance, quiet=True)
        after = read(instance, kept)
    for v in kept:
        if not same(before[v.index], after[v.index]):
            yield f"{v.name} ({v.variability}) went from {before[v.index]!r} to {after[v.index]!r}"


@dynamic("FMI2-VALUE-04", "2.1.7", Level.ROBUSTNESS)
def empty_vectors(bench: Bench) -> Iterator[str]:
    """Getting and setting with nvr = 0 succeeds and does nothing.

    Standard: nothing; a host passes empty lists.

    Why: Nvr = 0 comes up where a list of variables is empty.

    Remedy: Return fmi2OK for nvr = 0, also with null pointers

    Example: A test of the pointers before that of nvr.
    """
    with bench.held() as instance:
        for base in BASE_TYPES:
            for verb in ("Get", "Set"):
                for pointer in (None, (ctypes.c_uint * 1)()):
                    bench.library.probe = "nvr = 0"
                    status = instance.call(f"{verb}{base}", pointer, 0, None)
                    if status != Status.OK:
                        yield f"fmi2{verb}{base} with nvr = 0 returned {status}"
        yield from bench.compare(bench.run(instance), "after getting and setting nothing")


def _unknown_references(bench: Bench) -> list[int]:
    """References that no variable of any type has."""
    used = {v.reference for v in bench.description.variables}
    return [r for r in (max(used, default=0) + 1, 2**31 - 1, 2**31, _LARGEST) if r not in used]


def _attempts(references: dict[str, list[int]]) -> Iterator[tuple[str, _Attempt]]:
    """Get and set with references that do not exist for a type, one call after the other."""
    for base, numbers in references.items():
        for number in numbers:
            yield f"fmi2Get{base}({number})", partial(_try_get, base, number)
            yield f"fmi2Set{base}({number})", partial(_try_set, base, number)


def _try_get(base: str, reference: int, instance: Instance) -> Status:
    return instance.get(base, [reference])[0]


def _try_set(base: str, reference: int, instance: Instance) -> Status:
    return instance.set(base, [reference], [_ANY[base]])


@dynamic("FMI2-VALUE-05", "2.1.2", Level.VIOLATION, owns=(f"({UNKNOWN})",))
def unknown_reference(bench: Bench) -> Iterator[str]:
    """A value reference that does not exist is answered with fmi2Error.

    Standard: "If a function [..] is called with a wrong fmi2ValueReference value [..], then the
    function has to return with an error (fmi2Status = fmi2Error)"

    Why: A wrong connection has to be seen.

    Remedy: Check the reference and return fmi2Error

    Example: fmi2OK, or a read behind the end of an array.
    """
    references = {base: _unknown_references(bench)[:2] for base in BASE_TYPES}
    bench.library.probe = UNKNOWN
    yield from _not_error(bench, references)


def _not_error(bench: Bench, references: dict[str, list[int]]) -> Iterator[str]:
    """Lines for wrong calls that are not answered with fmi2Error."""
    for what, attempt in _attempts(references):
        # Each on an instance of its own, since an error ends its usefulness.
        with bench.held() as instance:
            if (status := attempt(instance)) != Status.ERROR:
                yield f"{what} returned {status}"


@dynamic("FMI2-VALUE-06", "2.1.3", Level.ROBUSTNESS)
def bad_reference_survived(bench: Bench) -> Iterator[str]:
    """A wrong value reference or type leaves the process, other instances and later ones intact.

    Standard: after fmi2Error "other FMU instances are not affected".

    Why: One wrong reference ends a whole study.

    Remedy: Return fmi2Error, not fmi2Fatal, and change nothing

    Example: A crash for a reference of 2^32 - 1.
    """
    other = None if bench.alone_only else bench.ready("bystander")
    bench.library.probe = UNKNOWN
    references = {
        base: [*_unknown_references(bench), *_foreign(bench, base)] for base in BASE_TYPES
    }
    for base, numbers in references.items():
        instance = bench.ready()
        for what, attempt in _attempts({base: numbers}):
            if attempt(instance) == Status.FATAL:
                yield f"{what} returned fmi2Fatal, which ends all instances"
                return
        instance.free()
    if other is not None:
        yield from bench.compare(bench.run(other), "another instance after wrong references")
        other.free()
    yield from bench.compare(bench.alone(), "a later instance after wrong references")


def _foreign(bench: Bench, base: str) -> list[int]:
    """One reference that only variables of other types have, if there is any."""
    own = {v.reference for v in bench.description.variables if v.base == base}
    return sorted({v.reference for v in bench.description.variables} - own)[:1]


@dynamic("FMI2-VALUE-07", "2.1.2", Level.VIOLATION)
def wrong_type(bench: Bench) -> Iterator[str]:
    """A value reference of another type is answered with fmi2Error.

    Standard: "Handle and base type uniquely identify the value of a variable"; a wrong reference
    "has to return with an error (fmi2Status = fmi2Error)"

    Why: A wrong connection has to be seen.

    Remedy: Check the reference for each type

    Example: fmi2GetReal with the reference of an Integer returns 0.
    """
    references = {base: found for base in BASE_TYPES if (found := _foreign(bench, base))}
    require(references, "every value reference exists for every type")
    bench.library.probe = "a reference of another type"
    yield from _not_error(bench, references)


@dynamic("FMI2-VALUE-08", "2.1.2, 2.2.7", Level.VIOLATION)
def constants(bench: Bench) -> Iterator[str]:
    """Setting a constant is answered with fmi2Error.

    Standard: "for example, setting a constant with a fmi2SetReal function call [..] the function
    has to return with an error (fmi2Status = fmi2Error)"

    Why: A constant that can be set is none.

    Remedy: Return fmi2Error

    Example: fmi2OK.
    """
    found = [v for v in bench.description.variables if v.variability == "constant"]
    require(found, "there is no constant")
    for v in found:
        with bench.held() as instance:
            _, (value,) = instance.get(v.base, [v.reference])
            bench.library.probe = "a constant"
            status = instance.set(v.base, [v.reference], [value])
            if status != Status.ERROR:
                yield f"fmi2Set{v.base} of {v.name} returned {status}"


@dynamic("FMI2-VALUE-09", "2.1.7", Level.VIOLATION)
def grouping(bench: Bench) -> Iterator[str]:
    """The value of a variable does not depend on the order and grouping of references in a call.

    Standard: "Handle and base type [..] uniquely identify the value of a variable."

    Why: Hosts group references as they like.

    Remedy: Look up each reference by itself

    Example: A result that is sorted by reference.
    """
    with bench.held() as instance:
        bench.run(instance, last=3)
        for base, group in by_base(bench.description.variables):
            references = [v.reference for v in group]
            _, together = instance.get(base, references)
            _, backwards = instance.get(base, [*reversed(references), references[0]])
            single = [instance.get(base, [reference])[1][0] for reference in references]
            for v, one, other, last in zip(
                group, together, single, reversed(backwards[:-1]), strict=True
            ):
                if not (same(one, other) and same(one, last)):
                    yield f"{v.name} is {one!r}, alone {other!r}, in reverse order {last!r}"


@dynamic("FMI2-VALUE-10", "2.1.2, 2.2.3", Level.VIOLATION)
def ranges(bench: Bench) -> Iterator[str]:
    """Booleans are 0 or 1, and enumerations have the value of one of their items.

    Standard: fmi2Boolean has "only two values: fmi2False, fmi2True"; an enumeration has the
    values of its items

    Why: Hosts compare with fmi2True.

    Remedy: Return 0 or 1, and values of items

    Example: A bit mask as a Boolean.
    """
    description = bench.description
    judged = tuple(v for v in description.variables if v.element in ("Boolean", "Enumeration"))
    require(judged, "there are no Booleans and no enumerations")
    with bench.held() as instance:
        for point in range(bench.grid.steps):
            found = read(instance, judged)
            for v in judged:
                allowed: tuple[int, ...] = (0, 1)
                if v.element == "Enumeration":
                    allowed = description.enumerations.get(v.attributes["declaredType"], ())
                if found[v.index] not in allowed:
                    yield f"{v.name} is {found[v.index]!r} at communication point {point}"
                    return
            bench.run(instance, first=point, last=point + 1, quiet=True)


@dynamic("FMI2-VALUE-11", "2.1.2, 2.1.7", Level.VIOLATION)
def strings_copied(bench: Bench) -> Iterator[str]:
    """fmi2SetString copies its strings: overwriting the caller's memory afterwards changes nothing.

    Standard: "All strings passed as arguments to fmi2SetString must be copied inside this
    function"

    Why: The host frees its string.

    Remedy: Copy the string

    Example: label = value[k];
    """
    strings = [
        v for v in bench.description.variables if v.base == "String" and v.settable_before_start
    ]
    require(strings, "no String can be set")
    instance = bench.fresh()
    for v in strings:
        text = str(v.start or "").encode()
        memory = ctypes.create_string_buffer(text, len(text) + 16)
        pointer = (ctypes.c_char_p * 1)(ctypes.cast(memory, ctypes.c_char_p))
        status = instance.call("SetString", (ctypes.c_uint * 1)(v.reference), 1, pointer)
        demand(status, f"fmi2SetString of {v.name}")
        memory.raw = b"overwritten".ljust(len(memory), b"!")
    demand(_initialized(bench, instance, excited=True), "initialization")
    for v in strings:
        found = read(instance, (v,))[v.index]
        if found != v.start:
            yield f"{v.name} was set to {v.start!r} and is {found!r}"
    instance.free()


@dynamic("FMI2-VALUE-12", "2.1.7", Level.ROBUSTNESS)
def reading_is_harmless(bench: Bench) -> Iterator[str]:
    """Reading variables, however often, does not change the simulation.

    Standard: nothing; a host that records more must not change the run.

    Why: Results would depend on what is plotted.

    Remedy: Compute in fmi2DoStep, not in fmi2GetXXX

    Example: A counter of calls that enters the model.
    """
    instance = bench.ready()
    found = bench.run(instance, quiet=True)
    instance.free()
    yield from bench.compare(found, "without reading in between")


@dynamic("FMI2-VALUE-13", "2.2.7", Level.ROBUSTNESS)
def inputs_held(bench: Bench) -> Iterator[str]:
    """An input keeps its value until it is set again.

    Standard: nothing; a host sets an input when it changes.

    Why: Results would depend on how often an input is set.

    Remedy: Keep inputs until they are set again

    Example: An input that is zeroed after each step.
    """
    require(inputs(bench.description), "there are no inputs")
    found = []
    for again in (True, False):
        with bench.held() as instance:
            excite(instance, bench.description, 0)
            for point in range(bench.grid.steps):
                if again:
                    excite(instance, bench.description, 0)
                demand(instance.step(bench.grid.time(point), bench.grid.step), "fmi2DoStep")
            found.append(read(instance, bench.description.variables))
    for v in bench.description.variables:
        if not same(found[0][v.index], found[1][v.index]):
            yield f"{v.name} differs if the same input values are not set again at every step"
            return
