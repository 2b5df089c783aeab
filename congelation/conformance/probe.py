"""Measuring what reacts to what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Description, Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.trajectory import by_base, demand, excitation, excite, inputs, same

__all__ = ["feedthrough", "initial_sensitivity", "read", "shifted"]

# A tenth of the value (or of 1): visible, and seldom out of the range that a model accepts.
_SHIFT = 0.1
# Step for telling a direct reaction from one through a state: the latter shrinks with the step.
_TINY_STEP = 1e-4
# Halving the step halves a reaction through a state; a direct one keeps its size.
_DIRECT = 0.9
# Below this a difference may be rounding.
_NOISE = 1e-9

Effects = dict[tuple[int, int], tuple[Value, Value]]


def shifted(variable: Variable, value: Value, description: Description) -> Value | None:
    """A value near `value` that the variable may take, None if there is none at hand."""
    low, high = variable.bound("min"), variable.bound("max")
    if variable.element == "Boolean":
        return not value
    if variable.element == "Enumeration":
        items = description.enumerations.get(variable.attributes.get("declaredType", ""), ())
        return next((item for item in items if item != value), None)
    if variable.element not in ("Real", "Integer"):
        return None
    step: float = 1 if variable.element == "Integer" else _SHIFT * (1.0 + abs(float(value)))
    for candidate in (value + step, value - step):  # type: ignore[operator]  # numbers by now
        if (low is None or candidate >= low) and (high is None or candidate <= high):
            return candidate
    return None


def read(instance: Instance, variables: tuple[Variable, ...]) -> dict[int, Value]:
    """Values by index of the variable."""
    found: dict[int, Value] = {}
    for base, group in by_base(variables):
        status, values = instance.get(base, [v.reference for v in group])
        demand(status, f"fmi2Get{base} of {', '.join(v.name for v in group[:5])}")
        found |= {v.index: value for v, value in zip(group, values, strict=True)}
    return found


def _changed(base: Mapping[int, Value], other: Mapping[int, Value]) -> Iterator[int]:
    return (index for index, value in other.items() if not same(value, base[index]))


def initial_sensitivity(bench: Bench) -> tuple[Effects, set[int]]:
    """Shift one Known after the other and see which InitialUnknowns change.

    Returns
    -------
    effects : dict
        (unknown, known) -> values of the unknown before and after.
    varied : set of int
        Indices of the Knowns that could be shifted.
    """
    description = bench.description
    unknowns = tuple(
        v for u in description.initial_unknowns if (v := description.variable(u.index)) is not None
    )
    instance = bench.fresh()
    bench.begin(instance)
    base = read(instance, unknowns)
    effects: Effects = {}
    varied: set[int] = set()
    for known in description.variables:
        demand(instance.reset(), "fmi2Reset")
        if not _begin_with_shifted(bench, instance, known):
            continue
        varied.add(known.index)
        other = read(instance, unknowns)
        for index in _changed(base, other):
            if index != known.index:
                effects[index, known.index] = (base[index], other[index])
    instance.free()
    return effects, varied


def _begin_with_shifted(bench: Bench, instance: Instance, known: Variable) -> bool:
    """Enter Initialization Mode with one Known shifted; False if it is none or is refused."""
    description, start = bench.description, bench.grid.start
    if known.causality == "independent":
        demand(instance.setup(start + _SHIFT), "fmi2SetupExperiment")
        demand(instance.enter(), "fmi2EnterInitializationMode")
        excite(instance, description, 0)
        return True
    if known.causality == "input":
        value = shifted(known, excitation(known, 0), description)
        if value is not None:
            bench.begin(instance, instead={known.index: value})
        return value is not None
    if not known.is_exact or known.start is None:
        return False
    value = shifted(known, known.start, description)
    if value is None or instance.set(known.base, [known.reference], [value]) != Status.OK:
        return False
    # A parameter that does not fit the others may be refused at initialization.
    if instance.setup(start) != Status.OK or instance.enter() != Status.OK:
        return False
    excite(instance, description, 0)
    return True


def feedthrough(bench: Bench) -> tuple[Effects, set[int]]:
    """Shift one Real input after the other over a tiny step and over half of it.

    An output that keeps its difference when the step is halved reacts directly.

    Returns
    -------
    effects, varied
        As in `initial_sensitivity`, for the Real outputs and Real inputs.
    """
    description = bench.description
    outputs = tuple(
        v for v in description.variables if v.causality == "output" and v.element == "Real"
    )
    knowns = tuple(v for v in inputs(description) if v.element == "Real")
    instance = bench.fresh()
    base = {size: _after(bench, instance, size, None, outputs) for size in _sizes()}
    effects: Effects = {}
    varied: set[int] = set()
    for known in knowns:
        moved = {size: _after(bench, instance, size, known, outputs) for size in _sizes()}
        varied.add(known.index)
        for v in outputs:
            whole, half = (
                abs(float(moved[size][v.index]) - float(base[size][v.index])) for size in _sizes()
            )
            before = base[_TINY_STEP][v.index]
            if whole > _NOISE * (1.0 + abs(float(before))) and half > _DIRECT * whole:
                effects[v.index, known.index] = (before, moved[_TINY_STEP][v.index])
    instance.free()
    return effects, varied


def _sizes() -> tuple[float, float]:
    return _TINY_STEP, _TINY_STEP / 2.0


def _after(
    bench: Bench,
    instance: Instance,
    size: float,
    known: Variable | None,
    outputs: tuple[Variable, ...],
) -> dict[int, Value]:
    """The outputs after one first step of a given size, one input shifted."""
    instead: dict[int, Value] = {}
    if known is not None:
        value = shifted(known, excitation(known, 0), bench.description)
        instead = {} if value is None else {known.index: value}
    demand(instance.reset(), "fmi2Reset")
    bench.initialize(instance)
    excite(instance, bench.description, 0, instead=instead)
    demand(instance.step(bench.grid.start, size), f"fmi2DoStep with h = {size:g}")
    return read(instance, outputs)
