"""Unit names as products of SI base units, for the UnitDefinitions of modelDescription.xml."""

from __future__ import annotations

import math
import re
from collections import Counter

from congelation.errors import InvalidInput, nearest

__all__ = ["base_unit"]

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
# Exponents of the base units, and the factor to them.
_DERIVED: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Hz": (1.0, {"s": -1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "g": (1e-3, {"kg": 1}),
    **{name: (1.0, {name: 1}) for name in BASE},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d{1,2})?")


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's BaseUnit element for a unit such as ``N.m/rad`` or ``1/s2``.

    Names are joined by ``.``; an integer after a name is its exponent; every name after a ``/``
    is divided by.

    Raises
    ------
    InvalidInput
        If a name is not known.
    """
    factor = 1.0
    exponents: Counter[str] = Counter()
    for place, part in enumerate(unit.split("/")):
        sign = -1 if place else 1
        for name in part.split("."):
            match = _FACTOR.fullmatch(name)
            if match is None or match.group(1) not in _DERIVED:
                raise InvalidInput(f"unit '{unit}': '{name}' is no unit; {nearest(name, _DERIVED)}")
            power = sign * int(match.group(2) or 1)
            size, base = _DERIVED[match.group(1)]
            factor *= size**power
            for symbol, exponent in base.items():
                exponents[symbol] += power * exponent
    attributes = {name: str(exponents[name]) for name in BASE if exponents[name]}
    return attributes if factor == 1.0 else {**attributes, "factor": repr(factor)}
