"""Checks of numbers and keys, shared by the terms, specifications and flat parameters."""

from __future__ import annotations

import difflib
import math
import numbers
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, field
from typing import Any

__all__ = [
    "MAX_SEED",
    "ProfileError",
    "boolean",
    "check_keys",
    "checked",
    "finite",
    "nearest",
    "number_field",
    "shown",
]

# Seeds are FMI Integers: signed, 32 bits.
MAX_SEED = 2**31 - 1


class ProfileError(ValueError):
    """A profile that cannot be; one line: the place, the value and what would be valid."""


def nearest(name: str, valid: Sequence[str]) -> str:
    """The name among `valid` that may have been meant, or all of them, as the end of a message."""
    close = difflib.get_close_matches(name, valid, n=1, cutoff=0.4)
    return f"did you mean '{close[0]}'?" if close else "valid: " + ", ".join(valid)


def finite(value: Any) -> float:
    """`value` as a finite float, or NaN if it is not one."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return math.nan
    try:
        number = float(value)
    except OverflowError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def shown(value: Any) -> str:
    """A value as a specification spells it, shortened."""
    return str(value).lower() if isinstance(value, bool) else reprlib.repr(value)


def checked(value: Any, meta: Mapping[str, Any], where: str) -> Any:
    """`value` as the type that `meta` declares; `where` is its name in messages."""
    if meta["type"] == "Integer":
        if isinstance(value, numbers.Integral) and not isinstance(value, bool):
            number = int(value)
            if 0 <= number <= MAX_SEED:
                return number
        wanted = f"an integer from 0 to {MAX_SEED}"
    else:
        real = finite(value)
        if real > 0.0 or (real == real and not meta["positive"]):
            return real
        wanted = "a finite number" + (" above 0" if meta["positive"] else "")
    raise ProfileError(f"{where} = {shown(value)}: must be {wanted}")


def boolean(value: Any, where: str) -> bool:
    """`value` if it is true or false; `where` is its name in messages."""
    if not isinstance(value, bool):
        raise ProfileError(f"{where} = {shown(value)}: must be true or false")
    return value


def check_keys(given: Mapping[str, Any], valid: Sequence[str], where: str) -> None:
    """Refuse a key of `given` that is not among `valid`; `where` is its place in messages."""
    for key in given:
        if key not in valid:
            raise ProfileError(f"{where}.{key}: unknown key; {nearest(str(key), valid)}")


def number_field(
    description: str,
    unit: str = "",
    *,
    default: Any = MISSING,
    neutral: float = 0.0,
    positive: bool = False,
    integer: bool = False,
) -> Any:
    """A dataclass field that knows its unit, its domain and its neutral value as a parameter."""
    meta = {
        "type": "Integer" if integer else "Real",
        "unit": unit,
        "description": description,
        "neutral": neutral,
        "positive": positive,
    }
    return field(default=default, metadata=meta)
