"""What goes into an FMU during a test run, what comes out, and where two runs differ.

After a plain run with the start values inputs are excited, because an FMU at rest hides most
mistakes; the excitation is a function of the communication point alone, so that any run can be
repeated from anywhere, in any process.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from congelation.conformance.binding import Status
from congelation.conformance.description import BASE_TYPES, Description, Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Violated

__all__ = [
    "Grid",
    "Trajectory",
    "by_base",
    "demand",
    "excitation",
    "excite",
    "first_difference",
    "inputs",
    "observe",
    "same",
]

# Communication steps of a test run: enough for the states to move, few enough to repeat often.
_STEPS = 12

# A tenth of the start value (or of 1) moves a state visibly and stays near the operating point.
_AMPLITUDE = 0.1


@dataclass(frozen=True)
class Grid:
    """The communication points start + k step of a test run."""

    start: float
    step: float
    steps: int = _STEPS

    def time(self, point: int) -> float:
        """Communication point number `point`, without accumulated rounding."""
        return self.start + point * self.step


@dataclass(frozen=True)
class Trajectory:
    """All variables at consecutive communication points.

    Attributes
    ----------
    names : tuple of str
        Variable names, the columns.
    rows : tuple of tuple
        Values, one row for each communication point.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]

    def after(self, point: int) -> Trajectory:
        """The rows from communication point `point` on."""
        return Trajectory(self.names, self.rows[point:])


def demand(status: Status, what: str) -> None:
    """Insist on the success of a call that the standard allows here.

    Raises
    ------
    Violated
        The status is neither fmi2OK nor fmi2Warning.
    """
    if status not in (Status.OK, Status.WARNING):
        raise Violated(f"{what} returned {status}")


def by_base(variables: Sequence[Variable]) -> Iterator[tuple[str, tuple[Variable, ...]]]:
    """The variables grouped by the base type whose functions carry them."""
    for base in BASE_TYPES:
        group = tuple(variable for variable in variables if variable.base == base)
        if group:
            yield base, group


def inputs(description: Description) -> tuple[Variable, ...]:
    """The variables with causality "input"."""
    return tuple(v for v in description.variables if v.causality == "input")


def excitation(variable: Variable, point: int, phase: float = 0.0) -> Value:
    """The value of an input at a communication point.

    Real inputs swing about their start value, within min and max; Boolean ones are toggled
    every fourth point; the others keep their start value, and so do all where the model does not
    bear another one (`Variable.still`).
    """
    start = variable.start
    if variable.still and start is not None:
        return start
    if variable.base == "Real":
        centre = float(start or 0.0)
        swing = _AMPLITUDE * (1.0 + abs(centre))
        value = centre + swing * math.sin(0.9 * point + 0.3 * variable.index + phase)
        low, high = variable.bound("min"), variable.bound("max")
        value = value if low is None else max(value, low)
        return value if high is None else min(value, high)
    if variable.base == "Boolean":
        return bool(start) != bool(point // 4 % 2)
    if start is None:
        return "" if variable.base == "String" else 0
    return start


def excite(
    instance: Instance,
    description: Description,
    point: int,
    phase: float = 0.0,
    instead: Mapping[int, Value] | None = None,
) -> None:
    """Set all inputs to their excitation at a communication point.

    Parameters
    ----------
    instead : Mapping[int, Value], optional
        Values to be used in place of the excitation, by index of the variable.
    """
    other = instead or {}
    for base, group in by_base(inputs(description)):
        values = [other.get(v.index, excitation(v, point, phase)) for v in group]
        status = instance.set(base, [v.reference for v in group], values)
        demand(status, f"fmi2Set{base} on the inputs")


def observe(instance: Instance, description: Description) -> tuple[Value, ...]:
    """The values of all variables, grouped by base type."""
    row: list[Value] = []
    for base, group in by_base(description.variables):
        status, values = instance.get(base, [v.reference for v in group])
        demand(status, f"fmi2Get{base} of all variables")
        row.extend(values)
    return tuple(row)


def same(one: Value, other: Value) -> bool:
    """Equality of values (a NaN equals any NaN, and 0.0 equals -0.0)."""
    return one == other or (one != one and other != other)


def first_difference(one: Trajectory, other: Trajectory) -> str | None:
    """The first place where two trajectories differ in any value, in words; None if nowhere."""
    if len(one.rows) != len(other.rows):
        return f"{len(one.rows)} communication points instead of {len(other.rows)}"
    for point, (row, expected) in enumerate(zip(one.rows, other.rows, strict=True)):
        for name, value, wanted in zip(one.names, row, expected, strict=True):
            if not same(value, wanted):
                return f"{name} is {value!r} instead of {wanted!r} at row {point}"
    return None
