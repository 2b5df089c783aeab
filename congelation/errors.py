"""The errors of congelation.

    CongelationError
    ├── InvalidInput (also a ValueError)   something the user wrote is wrong
    │   └── InfeasibleDesign               the gains asked for do not exist
    └── SlaveError                         an FMU refused a call

Numerical outcomes (a diverging run, a step that cannot be made accurate) are statuses of a
result, not exceptions.
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

__all__ = [
    "CongelationError",
    "DesignWarning",
    "InfeasibleDesign",
    "InvalidInput",
    "SlaveError",
    "amount",
    "counted",
    "nearest",
    "one_line",
    "require_count",
    "shown",
]

LONGEST_VALUE = 60
"""Characters of a value that a message quotes."""

DEEPEST = 6
"""Levels of lists and tables of such a value that are spelled out."""

LARGEST_BITS = 10_000
"""Of a whole number that is spelled out; Python prints up to 4,300 digits."""


class CongelationError(Exception):
    """Base of every error that congelation raises on purpose.

    Examples
    --------
    >>> try:
    ...     cg.info("none.fmu")
    ... except cg.CongelationError as error:
    ...     print(error)
    no FMU at none.fmu; build it with: congelation build SPEC.toml; or correct the path
    """


class InvalidInput(CongelationError, ValueError):
    """Something the user wrote is wrong; the text says what, where, and what would be valid.

    It is one line: what it quotes of a file may hold any characters, and those that cannot be
    printed are escaped.

    Examples
    --------
    >>> cg.new("2nd try", folder)
    Traceback (most recent call last):
    ...
    congelation.errors.InvalidInput: NAME '2nd try' is not valid; give letters, digits and _, ...
    """

    def __init__(self, text: str) -> None:
        line = " ".join(text.splitlines()) if "\n" in text else text
        if not line.isprintable():
            line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        super().__init__(line)


class InfeasibleDesign(InvalidInput):
    """The gains asked for do not exist; the text names the nearest ones that do."""


class DesignWarning(UserWarning):
    """A design may be built and run, but the theorem does not cover it; the text says why."""


class SlaveError(CongelationError):
    """An FMU refused a call.

    Parameters
    ----------
    component : str
        Name of the component in the system.
    time : float
        Communication point at which it happened, in seconds.
    message : str
        The FMU's own logged message, or the call and the status it returned.
    call : str
        The fmi2 function that was refused; empty where an FMU only logged an error.

    Examples
    --------
    >>> issubclass(cg.SlaveError, cg.CongelationError)
    True
    """

    def __reduce__(self) -> tuple[type[SlaveError], tuple[str, float, str, str]]:
        """What makes it anew in another process: what it was made from, not its text."""
        return type(self), (self.component, self.time, self.message, self.call)

    def __init__(self, component: str, time: float, message: str, call: str = "") -> None:
        # An FMU may begin with its own name, for tools that do not say whose message it is.
        own = message.removeprefix(f"{component}: ")
        super().__init__(f"{component} at t = {time:.9g}: {own}")
        self.component = component
        self.time = time
        self.message = message
        self.call = call


def nearest(name: str, valid: Iterable[str]) -> str:
    """A clause naming the valid spelling nearest to `name`, or all of them where few exist."""
    names = list(valid)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    if close:
        return f"did you mean '{close[0]}'?"
    if 0 < len(names) <= 12:
        return "valid: " + ", ".join(names)
    return f"none of the {len(names)} valid names is near"


def require_count(value: int, name: str) -> None:
    """Refuse a number below 1.

    Raises
    ------
    InvalidInput
    """
    if value < 1:
        raise InvalidInput(f"{name} = {value} is not valid; give a whole number of at least 1")


def counted(count: int, noun: str, plural: str = "") -> str:
    """A number of things in words: ``1 run``, ``2 runs``."""
    return f"{count} {noun if count == 1 else plural or f'{noun}s'}"


def amount(shape: Sequence[int], noun: str = "number") -> str:
    """A shape in words: ``1 number``, ``2 numbers``, ``2 rows of 3 numbers``."""
    if not shape:
        return f"a single {noun}"
    if len(shape) == 1:
        return counted(shape[0], noun)
    if len(shape) == 2:
        return f"{counted(shape[0], 'row')} of {counted(shape[1], noun)}"
    return f"{' x '.join(map(str, shape))} {noun}s"


def one_line(text: str) -> str:
    """A text without line breaks, what a terminal would obey in it escaped."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def shown(value: object) -> str:
    """A value as a scenario or spec spells it, cut where it is long.

    Columns are lists, and arrays of one element are numbers, as they are in files.
    """
    text = _spelled(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def _spelled(value: object, depth: int = 0) -> str:
    if isinstance(value, np.ndarray):
        column = value.ndim == 2 and value.shape[1] == 1
        value = value.item() if value.size == 1 else (value.ravel() if column else value).tolist()
    elif isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"'{value}'"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, int) and value.bit_length() > LARGEST_BITS:
        return f"a number of {value.bit_length()} bits"
    if not isinstance(value, Mapping | list | tuple):
        return str(value)
    # What is deeper, or comes after so many, would be cut anyway.
    if depth == DEEPEST:
        return "..."
    if isinstance(value, Mapping):
        some = itertools.islice(value.items(), LONGEST_VALUE)
        return f"{{{', '.join(f'{key} = {_spelled(v, depth + 1)}' for key, v in some)}}}"
    return f"[{', '.join(_spelled(v, depth + 1) for v in value[:LONGEST_VALUE])}]"
