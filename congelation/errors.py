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
from collections.abc import Iterable

__all__ = [
    "CongelationError",
    "DesignWarning",
    "InfeasibleDesign",
    "InvalidInput",
    "SlaveError",
    "nearest",
]


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
