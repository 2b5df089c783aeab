"""The kinds of terms by name, and a term from its name and fields."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from .checks import ProfileError, check_keys, checked, shown
from .noise import Noise
from .table import Table
from .telegraph import Telegraph
from .terms import Chirp, Constant, ScalarTerm, Sine, Square, Term

__all__ = ["BY_KIND", "KINDS", "SLOTTED", "body_of", "parameters", "scalar_term", "table_of_file"]

_SCALAR_TERMS: tuple[type[ScalarTerm], ...] = (Constant, Sine, Square, Chirp, Telegraph, Noise)
BY_KIND = {cls.kind: cls for cls in _SCALAR_TERMS}
KINDS = (*BY_KIND, Table.kind)
SLOTTED = tuple(kind for kind in BY_KIND if kind != Constant.kind)
"""Kinds of which a profile of an FMU has room for a fixed number, in the order of its variables."""


def parameters(cls: type[ScalarTerm]) -> dict[str, Any]:
    """The fields that a user gives, by name."""
    return {f.name: f for f in fields(cls) if f.init}


def scalar_term(kind: str, given: Mapping[str, Any], where: str) -> Term:
    """The term of `kind` with these fields, which are called ``where.field`` in messages."""
    cls = BY_KIND[kind]
    known = parameters(cls)
    check_keys(given, list(known), where)
    for name, f in known.items():
        if name in given:
            checked(given[name], f.metadata, f"{where}.{name}")
        elif f.default is MISSING:
            raise ProfileError(f"{where}.{name}: missing; {f.metadata['description']}")
    return cls(**given)


def table_of_file(file: Any, linear: bool, where: str, base: str) -> Table:
    """The table in a CSV file relative to `base`, which is called `where` in messages."""
    if not isinstance(file, str):
        raise ProfileError(f"{where} = {shown(file)}: must be the name of a CSV file")
    try:
        return Table.from_csv(os.path.join(base, file), linear)
    except ProfileError as error:
        raise ProfileError(f"{where}: {error}") from None


def body_of(term: Term) -> Any:
    """What stands behind the term's kind in a specification."""
    if isinstance(term, Constant):
        return term.value
    if isinstance(term, Table):
        if term.file:
            return {"file": term.file, "linear": term.linear}
        return {"times": list(term.times), "values": list(term.values), "linear": term.linear}
    if isinstance(term, ScalarTerm):
        return {name: getattr(term, name) for name in parameters(type(term))}
    raise ProfileError(f"{reprlib.repr(term)}: must be one of " + ", ".join(KINDS))
