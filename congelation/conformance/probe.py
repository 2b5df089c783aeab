"""Measuring what reacts to what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Description, Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Violated
from congelation.conformance.trajectory import by_base, demand, excitation, excite, inputs, same

__all__ = [
    "QUOTIENT_STEP",
    "feedthrough",
    "initial_sensitivity",
    "is_derivative",
    "read",
    "shifted",
]

# A tenth of the value (or of 1): visible, and seldom out of the range that a model accepts.
_SHIFT = 0.1
# A time at which no periodic signal of a round period stands where it stood.
_DELAY = 0.37
# Steps for telling a direct reaction from one through a state: the latter shrinks with the step.
_TINY_STEP = 1e-4
_SIZES = (_TINY_STEP, _TINY_STEP / 2.0)
# Halving the step halves a reaction through a state; a direct one keeps its size.
_DIRECT = 0.9
# Below this a difference may be rounding.
_NOISE = 1e-9

# Difference quotients over such a step are good to a few digits; the bound on their error only has
# to tell a derivative from something else.
QUOTIENT_STEP = 1e-5
_QUOTIENT_ERROR = 1e-2

_Effects = dict[tuple[int, int], tuple[Value, Value]]


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


def is_derivative(value: float, quotient: float) -> bool:
    """Whether a number is the derivative that a difference quotient was measured for."""
    return abs(value - quotient) <= _QUOTIENT_ERROR * (1.0 + abs(quotient))


def read(instance: Instance, variables: tuple[Variable, ...]) -> dict[int, Value]:
    """Values by index of the variable."""
    found: dict[int, Value] = {}
    for base, group in by_base(variables):
        status, values = instance.get(base, [v.reference for v in group])
        demand(status, f"fmi2Get{base} of {', '.join(v.name for v in group[:5])}")
        found |= {v.index: value for v, value in zip(group, values, strict=True)}
    return found


@dataclass(frozen=True)
class _Point:
    """Where sensitivities are measured: a start time, and start values other than the default."""

    start: float
    values: Mapping[int, Value]


def _points(bench: Bench) -> Iterator[_Point]:
    """The defaults; all Real start values shifted, later in time; the Boolean ones toggled, too.

    At the defaults much is zero or switched off and hides what depends on it.
    """
    yield _Point(bench.grid.start, {})
    moved: dict[int, Value] = {}
    for element in ("Real", "Boolean"):
        for v in bench.description.variables:
            if v.is_exact and v.element == element and v.start is not None:
                value = shifted(v, v.start, bench.description)
                moved |= {} if value is None else {v.index: value}
        yield _Point(bench.grid.start + _DELAY, dict(moved))


def initial_sensitivity(bench: Bench) -> tuple[_Effects, set[int]]:
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
    effects: _Effects = {}
    varied: set[int] = set()
    for point in _points(bench):
        base = _readings(bench, instance, point, None, unknowns)
        if base is None:
            continue
        for known in description.variables:
            other = _readings(bench, instance, point, known, unknowns)
            if other is None:
                continue
            varied.add(known.index)
            for index, value in other.items():
                if index != known.index and not same(value, base[index]):
                    effects[index, known.index] = (base[index], value)
    instance.free()
    return effects, varied


def _readings(
    bench: Bench,
    instance: Instance,
    point: _Point,
    known: Variable | None,
    unknowns: tuple[Variable, ...],
) -> dict[int, Value] | None:
    """The unknowns in Initialization Mode at a point, one Known shifted.

    None if that cannot be done: it is no Known, there is no other value for it, or the FMU does
    not accept the values (which it may find out when an unknown is read, or at the first step).
    """
    description = bench.description
    shift = _shift_of(known, point, description)
    demand(instance.reset(), "fmi2Reset")
    if shift is None:
        return None
    start, values = shift
    for v in description.variables:
        if v.causality == "input" or v.index not in values:
            continue
        if instance.set(v.base, [v.reference], [values[v.index]]) != Status.OK:
            return None
    if instance.setup(start) != Status.OK or instance.enter() != Status.OK:
        return None
    excite(instance, description, 0, instead=values)
    try:
        found = read(instance, unknowns)
    except Violated:
        if known is None and not point.values:
            raise  # at the start values of the XML there is nothing to refuse
        return None
    accepted = instance.leave() == Status.OK and instance.step(start, bench.grid.step) == Status.OK
    return found if accepted else None


def _shift_of(
    known: Variable | None, point: _Point, description: Description
) -> tuple[float, dict[int, Value]] | None:
    """Start time and values with one Known shifted; None if it is none or has no other value."""
    if known is None:
        return point.start, dict(point.values)
    if known.causality == "independent":
        return point.start + _SHIFT, dict(point.values)
    if known.causality == "input":
        before: Value | None = excitation(known, 0)
    else:
        before = point.values.get(known.index, known.start) if known.is_exact else None
    value = None if before is None else shifted(known, before, description)
    return None if value is None else (point.start, {**point.values, known.index: value})


def feedthrough(bench: Bench) -> tuple[_Effects, set[int]]:
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
    base = {size: _after(bench, instance, size, None, outputs) for size in _SIZES}
    effects: _Effects = {}
    varied: set[int] = set()
    for known in knowns:
        moved = {size: _after(bench, instance, size, known, outputs) for size in _SIZES}
        varied.add(known.index)
        for v in outputs:
            whole, half = (
                abs(float(moved[size][v.index]) - float(base[size][v.index])) for size in _SIZES
            )
            before = base[_TINY_STEP][v.index]
            if whole > _NOISE * (1.0 + abs(float(before))) and half > _DIRECT * whole:
                effects[v.index, known.index] = (before, moved[_TINY_STEP][v.index])
    instance.free()
    return effects, varied


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
