"""Start values of one component: what the user wrote, as values of the FMU's variables and as
arrays of C."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from congelation.errors import InvalidInput, amount, nearest, shown
from congelation.fmi.description import Description, Variable

__all__ = ["C_TYPES", "Setting", "StartValue", "references_of", "resolve_start"]

LARGEST_INTEGER = 2**31 - 1
"""An fmi2Integer has 32 bits."""


KEPT_STARTS = 64
"""Components whose start values are kept."""


class StartValue(NamedTuple):
    """A variable and the value that it starts from, of the variable's own type."""

    variable: Variable
    value: float | int | bool | str


def resolve_start(
    description: Description, start: Mapping[str, object], place: str
) -> tuple[StartValue, ...]:
    """Find the variables that start values are meant for.

    Parameters
    ----------
    description : Description
        The component's FMU.
    start : mapping of str to object
        A scalar for a scalar variable; for a vector or matrix (variables ``v[1]``, ..,
        ``v[1,1]``, ..) nested lists or an array of exactly its shape.
    place : str
        Where the values stand, for messages.

    Raises
    ------
    InvalidInput
        An unknown name, a value of the wrong type or shape, a variable that cannot be set.
    """
    # A study resolves the same names run after run, and nearly all values are those of the run
    # before. What variable the name of a scalar stands for does not depend on its value.
    key = description.sha256, tuple(start)
    kept = _KEPT.get(key)
    if kept is not None and _SCALARS.issuperset(map(type, start.values())):
        return tuple(
            known
            if value is given
            else StartValue(
                known.variable,
                _typed(known.variable, value, f"{place}, start value '{name}'"),
            )
            for (name, value), (given, known) in zip(start.items(), kept, strict=True)
        )
    found: dict[str, StartValue] = {}
    by: dict[str, str] = {}
    for name, value in start.items():
        here = f"{place}, start value '{name}'"
        for variable, scalar in _scalars(description, name, value, here):
            if variable.name in found:
                raise InvalidInput(
                    f"{here}: '{variable.name}' is given by '{by[variable.name]}' as well; leave "
                    "one of them out"
                )
            by[variable.name] = name
            found[variable.name] = StartValue(variable, _typed(variable, scalar, here))
    if _SCALARS.issuperset(map(type, start.values())):
        while len(_KEPT) >= KEPT_STARTS:
            _KEPT.pop(next(iter(_KEPT)))
        _KEPT[key] = tuple(zip(start.values(), found.values(), strict=True))
    return tuple(found.values())


_SCALARS = {float, int, bool, str}

_KEPT: dict[tuple[str, tuple[str, ...]], tuple[tuple[object, StartValue], ...]] = {}
"""Scalar start values as they were given last, by FMU and names, and what became of them."""


def _scalars(
    description: Description, name: str, value: object, place: str
) -> Iterator[tuple[Variable, object]]:
    """Pairs of a scalar variable and its value."""
    if not isinstance(value, list | tuple | np.ndarray):
        yield _scalar_variable(description, name, value, place), value
        return
    array = _array(value, place)
    shape = _shape(description, name)
    if not shape:
        if array.size == 1 and name in description.variables:
            yield description.variables[name], array.ravel()[0]
            return
        raise InvalidInput(f"{place}: no vector '{name}'; {nearest(name, _groups(description))}")
    if array.shape != shape:
        raise InvalidInput(
            f"{place}: {amount(array.shape, 'value')} given, {amount(shape, 'value')} needed"
        )
    first = _first_index(description, name)
    for index in np.ndindex(shape):
        element = f"{name}[{','.join(str(i + first) for i in index)}]"
        yield description.variable(element, place), array[index]


def _scalar_variable(description: Description, name: str, value: object, place: str) -> Variable:
    if name in description.variables:
        return description.variables[name]
    shape = _shape(description, name)
    if shape and math.prod(shape) == 1:
        first = _first_index(description, name)
        return description.variables[f"{name}[{','.join(str(first) for _ in shape)}]"]
    if shape:
        raise InvalidInput(
            f"{place}: {shown(value)} given, a list of {amount(shape, 'value')} needed"
        )
    return description.variable(name, place)


def _array(value: object, place: str) -> np.ndarray:
    array = np.array(value, dtype=object)
    if any(isinstance(item, list | tuple | np.ndarray) for item in array.flat):
        raise InvalidInput(f"{place}: rows of different lengths")
    return array


def _indices(name: str) -> tuple[str, tuple[int, ...]]:
    """Split ``v[1,2]`` into ``v`` and (1, 2); no indices where `name` is no element."""
    stem, bracket, rest = name.rpartition("[")
    parts = rest[:-1].split(",")
    if not bracket or not rest.endswith("]") or not all(part.isdecimal() for part in parts):
        return name, ()
    return stem, tuple(int(part) for part in parts)


def _groups(description: Description) -> dict[str, tuple[int, ...]]:
    """Names of the vectors and matrices, with their shapes."""
    groups: dict[str, tuple[int, ...]] = {}
    for name in description.variables:
        stem, index = _indices(name)
        if index:
            old = groups.get(stem, index)
            groups[stem] = tuple(max(a, b) for a, b in zip(old, index, strict=False))
    return groups


def _first_index(description: Description, name: str) -> int:
    """From which number the elements of a vector count: 0 as in C where there is such an element,
    else 1."""
    found = (_indices(other) for other in description.variables)
    return 0 if any(stem == name and 0 in index for stem, index in found) else 1


def _shape(description: Description, name: str) -> tuple[int, ...]:
    largest = _groups(description).get(name, ())
    return tuple(size + 1 - _first_index(description, name) for size in largest)


def _typed(variable: Variable, value: object, place: str) -> float | int | bool | str:
    """The value as the variable's own type."""
    if not variable.settable:
        raise InvalidInput(
            f"{place}: '{variable.name}' is {variable.variability}, of causality "
            f"{variable.causality}; only parameters, inputs and start values can be set"
        )
    if isinstance(value, np.generic):
        value = value.item()
    if variable.items and not isinstance(value, bool):
        for name, item in variable.items:
            if value in (name, item) and not isinstance(value, float):
                return item
        known = ", ".join(f"'{name}' ({item})" for name, item in variable.items)
        raise InvalidInput(f"{place}: {shown(value)} is no item of the enumeration; valid: {known}")
    if variable.type == "String" and isinstance(value, str):
        if "\0" in value:
            raise InvalidInput(f"{place}: {value!a} has a zero, at which a text ends in C")
        return value
    if variable.type == "Boolean" and (isinstance(value, bool) or value in (0, 1)):
        return bool(value)
    if variable.type == "Integer" and isinstance(value, int) and not isinstance(value, bool):
        if not -LARGEST_INTEGER - 1 <= value <= LARGEST_INTEGER:
            raise InvalidInput(f"{place}: {value} does not fit in 32 bits")
        return value
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if variable.type == "Real" and is_number:
        try:
            number = float(value)  # type: ignore[arg-type]  # narrowed by is_number
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise InvalidInput(f"{place}: {number} is no value; give a finite number")
        return number
    raise InvalidInput(f"{place}: {shown(value)} given, {_WANTED[variable.type]} needed")


_WANTED = {
    "Real": "a number",
    "Integer": "an integer",
    "Boolean": "true or false",
    "String": "a string",
}


C_TYPES: dict[str, Any] = {
    "Real": ctypes.c_double,
    "Integer": ctypes.c_int,
    "Boolean": ctypes.c_int,
    "String": ctypes.c_char_p,
}
"""What stands in C for the values of each type of variable."""


def references_of(references: Iterable[int]) -> ctypes.Array[ctypes.c_uint]:
    """Value references as an array of C."""
    items = list(references)
    return (ctypes.c_uint * len(items))(*items)


class Setting:
    """Start values as arrays of C, one call of an fmi2Set function per type.

    Attributes
    ----------
    calls : list of (type, references, values)
    """

    def __init__(self, values: tuple[StartValue, ...]) -> None:
        groups: dict[str, list[StartValue]] = {}
        for given in values:
            groups.setdefault(given.variable.type, []).append(given)
        self.calls: list[tuple[str, Any, Any]] = []
        places: dict[int, tuple[Any, int]] = {}
        for kind, group in groups.items():
            references = references_of(given.variable.reference for given in group)
            scalars = (C_TYPES[kind] * len(group))(*(_scalar(given) for given in group))
            self.calls.append((kind, references, scalars))
            places |= {id(given): (scalars, k) for k, given in enumerate(group)}
        self._values = values
        self._places = [places[id(given)] for given in values]

    def takes(self, values: tuple[StartValue, ...]) -> bool:
        """Whether these are values of the same variables, which it then takes over."""
        if len(values) != len(self._values):
            return False
        changed = [
            k for k, (a, b) in enumerate(zip(values, self._values, strict=True)) if a is not b
        ]
        if any(values[k].variable is not self._values[k].variable for k in changed):
            return False
        for k in changed:
            scalars, place = self._places[k]
            scalars[place] = _scalar(values[k])
        self._values = values
        return True


def _scalar(given: StartValue) -> Any:
    return given.value.encode() if isinstance(given.value, str) else given.value
