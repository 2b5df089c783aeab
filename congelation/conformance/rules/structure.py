"""Rules about ModelStructure: the lists, their order, and dependencies against what is measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import pairwise

from congelation.conformance.bench import Bench
from congelation.conformance.description import Description, Unknown, Value
from congelation.conformance.probe import feedthrough, initial_sensitivity
from congelation.conformance.rule import NotApplicable, Rule, dynamic, static
from congelation.conformance.subject import Subject

__all__ = ["RULES"]

# Kinds that make no sense in Initialization Mode, where nothing is fixed yet (section 2.2.8).
_LATER_KINDS = {"fixed", "tunable", "discrete"}


def _names(description: Description, indices: set[int]) -> str:
    found = [description.variable(index) for index in sorted(indices)]
    return ", ".join(
        f"#{i}" if v is None else v.name for i, v in zip(sorted(indices), found, strict=True)
    )


def _set_breaches(
    description: Description, listed: tuple[Unknown, ...], wanted: set[int]
) -> Iterator[str]:
    indices = [unknown.index for unknown in listed]
    if missing := wanted - set(indices):
        yield f"missing: {_names(description, missing)}"
    if extra := set(indices) - wanted:
        yield f"must not be there: {_names(description, extra)}"
    for index, count in Counter(indices).items():
        if count > 1:
            yield f"{_names(description, {index})} is listed {count} times"


@static("FMI2-STRUCT-01", "2.2.8")
def outputs(subject: Subject) -> Iterator[str]:
    """Outputs lists every variable with causality "output", once, and no other."""
    description = subject.description
    wanted = {v.index for v in description.variables if v.causality == "output"}
    yield from _set_breaches(description, description.outputs, wanted)


@static("FMI2-STRUCT-02", "2.2.8")
def initial_unknowns(subject: Subject) -> Iterator[str]:
    """InitialUnknowns lists, once, the approx or calculated outputs, states and derivatives, and
    the calculated parameters."""
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


@static("FMI2-STRUCT-03", "2.2.8")
def initial_unknowns_order(subject: Subject) -> Iterator[str]:
    """InitialUnknowns are ordered by ascending index."""
    description = subject.description
    indices = [unknown.index for unknown in description.initial_unknowns]
    for before, after in pairwise(indices):
        if after < before:
            yield f"{_names(description, {after})} comes after {_names(description, {before})}"


@static("FMI2-STRUCT-04", "2.2.8")
def state_derivatives(subject: Subject) -> Iterator[str]:
    """Derivatives lists continuous variables with the attribute derivative, their states local or
    output."""
    description = subject.description
    if not description.derivatives:
        raise NotApplicable("no Derivatives are listed")
    for unknown in description.derivatives:
        v = description.variable(unknown.index)
        if v is None or "derivative" not in v.attributes:
            yield f"{_names(description, {unknown.index})} is no state derivative"
    for index in description.states:
        state = description.variable(index)
        if state is None or state.causality not in ("local", "output"):
            yield f"the state {_names(description, {index})} is neither local nor output"
        elif state.variability != "continuous":
            yield f"the state {state.name} is {state.variability}"


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


@static("FMI2-STRUCT-05", "2.2.8")
def dependencies(subject: Subject) -> Iterator[str]:
    """dependencies are indices of Knowns of the mode, ascending, each once."""
    description = subject.description
    for name, unknowns, initialization in _lists(description):
        knowns = _knowns(description, initialization)
        for unknown in unknowns:
            listed, label = unknown.dependencies or (), _names(description, {unknown.index})
            if strange := set(listed) - knowns:
                yield f"{name}: {label} depends on {_names(description, strange)}, no Known there"
            if list(listed) != sorted(set(listed)):
                yield f"{name}: the dependencies of {label} are not ascending"


@static("FMI2-STRUCT-06", "2.2.8")
def dependency_kinds(subject: Subject) -> Iterator[str]:
    """dependenciesKind has one entry for each dependency, of a kind that fits mode and type."""
    description = subject.description
    for name, unknowns, initialization in _lists(description):
        for unknown in unknowns:
            if unknown.kinds is None:
                continue
            v, label = description.variable(unknown.index), _names(description, {unknown.index})
            if unknown.dependencies is None or len(unknown.kinds) != len(unknown.dependencies):
                yield f"{name}: {label} has {len(unknown.kinds)} kinds for other dependencies"
            if initialization and (late := _LATER_KINDS.intersection(unknown.kinds)):
                yield f"{name}: {label} has the kind {sorted(late)[0]!r}"
            if v is not None and v.element != "Real" and set(unknown.kinds) - {"dependent"}:
                yield f"{name}: {label} is no Real and has factors for dependencies"


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


@dynamic("FMI2-STRUCT-07", "2.2.8", patience=3.0)
def measured_initial_dependencies(bench: Bench) -> Iterator[str]:
    """In Initialization Mode an Unknown reacts to no Known but those listed as its dependencies."""
    unknowns = bench.description.initial_unknowns
    if not any(unknown.dependencies is not None for unknown in unknowns):
        raise NotApplicable("no InitialUnknown declares dependencies")
    measured, varied = initial_sensitivity(bench)
    yield from _compare(bench, "InitialUnknowns", unknowns, measured, varied)


@dynamic("FMI2-STRUCT-08", "2.2.8")
def measured_feedthrough(bench: Bench) -> Iterator[str]:
    """At a communication point an output reacts at once to no input but those listed as its
    dependencies."""
    unknowns = bench.description.outputs
    if not any(unknown.dependencies is not None for unknown in unknowns):
        raise NotApplicable("no output declares dependencies")
    measured, varied = feedthrough(bench)
    if not varied:
        raise NotApplicable("there is no Real input")
    yield from _compare(bench, "Outputs", unknowns, measured, varied)


RULES: tuple[Rule, ...] = (
    outputs,
    initial_unknowns,
    initial_unknowns_order,
    state_derivatives,
    dependencies,
    dependency_kinds,
    measured_initial_dependencies,
    measured_feedthrough,
)
