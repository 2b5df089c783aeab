"""What callers of the Python interface give, held against the types that it states.

`check_fields` does so for a record when it is made, `checked` for the arguments of a function. Both
read the annotations, so that a type is stated once; lists become tuples where these are stated.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from congelation.errors import InvalidInput, shown

__all__ = ["check_fields", "checked"]

P = ParamSpec("P")
R = TypeVar("R")

_KINDS: Mapping[Any, tuple[tuple[type, ...], str]] = {
    bool: ((bool, np.bool_), "True or False"),
    int: ((Integral,), "an integer"),
    float: ((Real,), "a number"),
    str: ((str,), "a text"),
    Path: ((str, os.PathLike), "a path"),
    NoneType: ((NoneType,), "None"),
}
"""What stands for a type, and what it is called. Truth values are no numbers."""


def check_fields(record: Any, place: str | None = None) -> None:
    """Refuse a record of whose fields one has another type than is stated.

    Parameters
    ----------
    record : dataclass
    place : str, optional
        What the message begins with, by default the name of the class.

    Raises
    ------
    InvalidInput
        Naming the field, its value and what would be valid.
    """
    for name, admits, wanted, turns in _fields(type(record)):  # type: ignore[arg-type]  # classes are hashable
        value = getattr(record, name)
        if not admits(value):
            begin = f"{type(record).__name__}: " if place is None else place
            raise InvalidInput(f"{begin}{name} = {_given(value)} is not valid; give {wanted}")
        if turns and value is not None and type(value) is not tuple:
            object.__setattr__(record, name, tuple(value))


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that refuses arguments of other types than it states, as `check_fields` does."""
    signature = inspect.signature(function)

    @functools.cache
    def hints() -> Mapping[str, Any]:
        # What is returned may be of an extra that is not installed.
        given = {n: hint for n, hint in function.__annotations__.items() if n != "return"}
        return get_type_hints(SimpleNamespace(__annotations__=given), function.__globals__)

    @functools.wraps(function)
    def wrapped(*arguments: P.args, **named: P.kwargs) -> R:
        for name, given in signature.bind(*arguments, **named).arguments.items():
            several = signature.parameters[name].kind is inspect.Parameter.VAR_POSITIONAL
            for value in given if several else (given,):
                if name in hints() and not _admits(hints()[name], value):
                    raise InvalidInput(
                        f"{name} = {_given(value)} is not valid; give {_wanted(hints()[name])}"
                    )
        return function(*arguments, **named)

    return wrapped


@functools.cache
def _fields(kind: Any) -> tuple[tuple[str, Callable[[object], bool], str, bool], ...]:
    """The name of each field of a record, whether it admits a value, what to give, and whether it
    becomes a tuple."""
    hints = get_type_hints(kind)
    return tuple(
        (
            field.name,
            functools.partial(_admits, hints[field.name]),
            _wanted(hints[field.name]),
            any(get_origin(hint) is tuple for hint in _alternatives(hints[field.name])),
        )
        for field in fields(kind)
        if field.init
    )


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _admits(hint: Any, value: object) -> bool:
    if hint in (Any, object):
        return True
    if hint in _KINDS:
        kinds, _ = _KINDS[hint]
        return isinstance(value, kinds) and not (
            hint in (int, float) and isinstance(value, bool | np.bool_)
        )
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_admits(one, value) for one in inner)
    if origin is Callable:
        return callable(value)
    if origin is not None and issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(
            _admits(inner[0], key) and _admits(inner[1], each) for key, each in value.items()
        )
    if origin is tuple and inner[-1] is not Ellipsis:
        return (
            isinstance(value, list | tuple)
            and len(value) == len(inner)
            and all(map(_admits, inner, value))
        )
    if origin is not None:  # tuples of any length, sequences, collections
        return isinstance(value, Sequence | set | frozenset | np.ndarray) and not (
            isinstance(value, str) or not all(_admits(inner[0], each) for each in value)
        )
    return isinstance(value, hint)


def _wanted(hint: Any) -> str:
    """What to give, in words."""
    if hint in _KINDS:
        return _KINDS[hint][1]
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        # A path may be a text, which goes without saying.
        named = [one for one in inner if one is not NoneType and not (one is str and Path in inner)]
        return " or ".join(dict.fromkeys(map(_wanted, named)))
    if origin is Callable:
        return "a function"
    if origin is None:
        name = getattr(hint, "__name__", "value")
        return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
    if issubclass(origin, Mapping):
        return "a dictionary" + (" with names as keys" if inner[0] is str else "")
    each = _wanted(inner[0]).partition(" or ")[0].partition(" ")[2]
    plural = f"{each}s" if each.islower() else each
    return (
        f"a pair of {plural}"
        if origin is tuple and inner[-1] is not Ellipsis
        else (f"a list of {plural}")
    )


def _given(value: object) -> str:
    """A value as a message shows it: of an object, its class."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, str | Mapping | list | tuple | np.ndarray | Real | NoneType):
        return shown(value)
    return f"a {type(value).__name__}"
