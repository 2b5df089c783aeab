"""Rules about ModelStructure: the lists, their order, and dependencies against what is measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import pairwise

from congelation.conformance.bench import Bench
from congelation.conformance.description import Description, Unknown, Value
from congelation.conformance.probe import feedthrough, initial_sensitivity
from congelation.conformance.rule import Breach, Level, dynamic, require, static
from congelation.conformance.rules.variables import at
from congelation.conformance.subject import DESCRIPTION, Subject

__all__: list[str] = []

# Kinds that make no sense in Initialization Mode, where nothing is fixed yet (section 2.2.8).
_LATER_KINDS = {"fixed", "tunable", "discrete"}


def _names(description: Description, indices: set[int]) -> str:
    found = [description.variable(index) for index in sorted(indices)]
    return ", ".join(
        f"#{i}" if v is None else v.name for i, v in zip(sorted(indices), found, strict=True)
    )


def _set_breaches(
    description: Description, listed: tuple[Unknown, ...], wanted: set[int]
) -> Iterator[Breach]:
    indices = [unknown.index for unknown in listed]
    if missing := wanted - set(indices):
        yield at(
            description.variables[min(missing) - 1], f"missing: {_names(description, missing)}"
        )
    if extra := set(indices) - wanted:
        line = next(unknown.line for unknown in listed if unknown.index in extra)
        yield Breach(f"must not be there: {_names(description, extra)}", line, DESCRIPTION)
    for index, count in Counter(indices).items():
        if count > 1:
            line = [unknown.line for unknown in listed if unknown.index == index][-1]
            what = f"{_names(description, {index})} is listed {count} times"
            yield Breach(what, line, DESCRIPTION)


@static("FMI2-STRUCT-01", "2.2.8", Level.VIOLATION)
def outputs(subject: Subject) -> Iterator[Breach]:
    """Outputs lists every variable with causality "output", once, and no other.

    Standard: "every variable with causality=output must be listed here"

    Why: Masters order slaves by this list.

    Remedy: List every output once under Outputs

    Example: An output that is missing.
    """
    description = subject.description
    wanted = {v.index for v in description.variables if v.causality == "output"}
    yield from _set_breaches(description, description.outputs, wanted)


@static("FMI2-STRUCT-02", "2.2.8", Level.VIOLATION)
def initial_unknowns(subject: Subject) -> Iterator[Breach]:
    """InitialUnknowns lists, once, the approx or calculated outputs, states and derivatives, and
    the calculated parameters.

    Standard: "This list consists of all variables with causality = output and (initial = approx
    or calculated)", calculated parameters, states and derivatives

    Why: Masters solve loops at initialization by this list.

    Remedy: List exactly these variables under InitialUnknowns

    Example: No InitialUnknowns although there are outputs.
    """
    description = subject.description
    exposed = description.states | {unknown.index for unknown in description.derivatives}
    wanted = {
        v.index
        for v in description.variables
        if v.causality == "calculatedParameter"
        or (
            v.initial in ("approx", "calculated")
            and (v.causality == "output" or v.index in exposed)
        )
    }
    yield from _set_breaches(description, description.initial_unknowns, wanted)


@static("FMI2-STRUCT-03", "2.2.8", Level.VIOLATION)
def initial_unknowns_order(subject: Subject) -> Iterator[Breach]:
    """InitialUnknowns are ordered by ascending index.

    Standard: "The Unknowns in this list must be ordered according to their ScalarVariable index"

    Why: Importers read the list in order.

    Remedy: Sort InitialUnknowns by index

    Example: Index 15 before index 10.
    """
    description = subject.description
    for before, after in pairwise(description.initial_unknowns):
        if after.index < before.index:
            first, second = (_names(description, {unknown.index}) for unknown in (before, after))
            yield Breach(f"{second} comes after {first}", after.line, DESCRIPTION)


@static("FMI2-STRUCT-04", "2.2.8", Level.VIOLATION)
def state_derivatives(subject: Subject) -> Iterator[Breach]:
    """Derivatives lists continuous variables with the attribute derivative, their states local or
    output.

    Standard: "All ScalarVariables listed in this element must have attribute derivative"; "A
    continuous-time state must have causality = local or output"

    Why: States are found by their derivatives.

    Remedy: Add the attribute derivative, or remove the entry

    Example: An entry of Derivatives that is a plain local variable.
    """
    description = subject.description
    require(description.derivatives, "no Derivatives are listed")
    for unknown in description.derivatives:
        v = description.variable(unknown.index)
        if v is None or "derivative" not in v.attributes:
            what = f"{_names(description, {unknown.index})} is no state derivative"
            yield Breach(what, unknown.line, DESCRIPTION)
    for index in description.states:
        state = description.variable(index)
        if state is None or state.causality not in ("local", "output"):
            what = f"the state {_names(description, {index})} is neither local nor output"
            yield Breach(what, None if state is None else state.line, DESCRIPTION)
        elif state.variability != "continuous":
            yield at(state, f"the state {state.name} is {state.variability}")


def _knowns(description: Description, initialization: bool) -> set[int]:
    """Indices of what an Unknown may depend on."""
    knowns = {v.index for v in description.variables if v.causality in ("input", "independent")}
    if initialization:
        return knowns | {v.index for v in description.variables if v.is_exact}
    return knowns | description.states


def _lists(description: Description) -> Iterator[tuple[str, tuple[Unknown, ...], bool]]:
    yield "Outputs", description.outputs, False
    # Without directional derivatives the element is ignored for co-simulation.
    if description.flag("providesDirectionalDerivative"):
        yield "Derivatives", description.derivatives, False
    yield "InitialUnknowns", description.initial_unknowns, True


@static("FMI2-STRUCT-05", "2.2.8", Level.VIOLATION)
def dependencies(subject: Subject) -> Iterator[Breach]:
    """dependencies are indices of Knowns of the mode, ascending, each once.

    Standard: the Knowns are inputs, states, the independent variable, and at initialization those
    with "initial = exact"; "The indices are ordered according to magnitude"

    Why: Masters find algebraic loops by the dependencies.

    Remedy: List Knowns alone, by ascending index

    Example: An output that depends on another output.
    """
    description = subject.description
    for name, unknowns, initialization in _lists(description):
        knowns = _knowns(description, initialization)
        for unknown in unknowns:
            listed, label = unknown.dependencies or (), _names(description, {unknown.index})
            if strange := set(listed) - knowns:
                names = _names(description, strange)
                what = f"{name}: {label} depends on {names}, no Known there"
                yield Breach(what, unknown.line, DESCRIPTION)
            if list(listed) != sorted(set(listed)):
                what = f"{name}: the dependencies of {label} are not ascending"
                yield Breach(what, unknown.line, DESCRIPTION)


@static("FMI2-STRUCT-06", "2.2.8", Level.VIOLATION)
def dependency_kinds(subject: Subject) -> Iterator[Breach]:
    """dependenciesKind has one entry for each dependency, of a kind that fits mode and type.

    Standard: "dependencies must be present and must have the same number of list elements"; "Only
    for Real unknowns: constant", and fixed, tunable and discrete "not for InitialUnknowns"

    Why: Linear dependencies are solved in another way.

    Remedy: Write one kind for each dependency, "dependent" for unknowns that are not Real

    Example: dependenciesKind="constant" for an Integer output.
    """
    description = subject.description
    for name, unknowns, initialization in _lists(description):
        for unknown in unknowns:
            if unknown.kinds is None:
                continue
            v, label = description.variable(unknown.index), _names(description, {unknown.index})
            if unknown.dependencies is None or len(unknown.kinds) != len(unknown.dependencies):
                what = f"{name}: {label} has {len(unknown.kinds)} kinds for other dependencies"
                yield Breach(what, unknown.line, DESCRIPTION)
            if initialization and (late := _LATER_KINDS.intersection(unknown.kinds)):
                what = f"{name}: {label} has the kind {sorted(late)[0]!r}"
                yield Breach(what, unknown.line, DESCRIPTION)
            if v is not None and v.element != "Real" and set(unknown.kinds) - {"dependent"}:
                what = f"{name}: {label} is no Real and has factors for dependencies"
                yield Breach(what, unknown.line, DESCRIPTION)


def _compare(
    bench: Bench,
    name: str,
    unknowns: tuple[Unknown, ...],
    measured: Mapping[tuple[int, int], tuple[Value, Value]],
    varied: set[int],
) -> Iterator[str]:
    """Lines for effects that are not declared; notes for declared ones without any."""
    description = bench.description
    for unknown in unknowns:
        if unknown.dependencies is None:
            continue  # absent means: depends on everything
        found = {known for target, known in measured if target == unknown.index}
        label = _names(description, {unknown.index})
        for known in sorted(found - set(unknown.dependencies)):
            before, after = measured[unknown.index, known]
            yield (
                f"{name}: {label} depends on {_names(description, {known})} "
                f"({before!r} became {after!r}), which is not listed"
            )
        if idle := varied.intersection(unknown.dependencies) - found:
            bench.notes.append(
                f"{name}: no effect of {_names(description, idle)} on {label} was measured"
            )


@dynamic("FMI2-STRUCT-07", "2.2.8", Level.ROBUSTNESS, time_factor=3.0)
def measured_initial_dependencies(bench: Bench) -> Iterator[str]:
    """In Initialization Mode an Unknown reacts to no Known but those listed as its dependencies.

    Standard: a note allows an FMU to leave out dependencies over which it cannot be iterated; a
    host needs all to initialize in the right order.

    Why: A master that follows the list reads the unknown too early.

    Remedy: List the Known under dependencies, or leave dependencies out

    Example: y = g x with dependencies="".
    """
    unknowns = bench.description.initial_unknowns
    require(
        any(unknown.dependencies is not None for unknown in unknowns),
        "no InitialUnknown declares dependencies",
    )
    measured, varied = initial_sensitivity(bench)
    yield from _compare(bench, "InitialUnknowns", unknowns, measured, varied)


@dynamic("FMI2-STRUCT-08", "2.2.8", Level.ROBUSTNESS)
def measured_feedthrough(bench: Bench) -> Iterator[str]:
    """At a communication point an output reacts at once to no input but those listed as its
    dependencies.

    Standard: the dependencies are those at a communication point, where nothing may be read
    between fmi2SetXXX and fmi2DoStep, so that a step is all that can be measured.

    Why: A master that follows the list overlooks an algebraic loop.

    Remedy: List the input under dependencies, or leave dependencies out

    Example: w = x + u with dependencies="".
    """
    unknowns = bench.description.outputs
    require(
        any(unknown.dependencies is not None for unknown in unknowns),
        "no output declares dependencies",
    )
    measured, varied = feedthrough(bench)
    require(varied, "there is no Real input")
    yield from _compare(bench, "Outputs", unknowns, measured, varied)
