"""Units as FMI's UnitDefinitions hold them: products of SI base units, with a factor and an offset.

FMI 2.0.4, section 2.2.2: a value v in a unit is factor * v + offset in SI base units.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from congelation.errors import InvalidInput, nearest

__all__ = [
    "BASE",
    "Conversion",
    "Unit",
    "base_unit",
    "conversion",
    "factors",
    "is_rate",
    "known_units",
    "unit_named",
    "unit_of_factors",
]

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
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "C": (1.0, {"A": 1, "s": 1}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "rev": (2.0 * math.pi, {"rad": 1}),
    "rpm": (math.pi / 30.0, {"rad": 1, "s": -1}),
    "g": (1e-3, {"kg": 1}),
    "t": (1e3, {"kg": 1}),
    "mm": (1e-3, {"m": 1}),
    "cm": (1e-2, {"m": 1}),
    "km": (1e3, {"m": 1}),
    "ms": (1e-3, {"s": 1}),
    "us": (1e-6, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "kN": (1e3, {"kg": 1, "m": 1, "s": -2}),
    "kW": (1e3, {"kg": 1, "m": 2, "s": -3}),
    "kPa": (1e3, {"kg": 1, "m": -1, "s": -2}),
    "mA": (1e-3, {"A": 1}),
    "mV": (1e-3, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    **{name: (1.0, {name: 1}) for name in BASE},
}
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d{1,2})?")


_SPELLED_OUT = {
    "kelvin": "K",
    "celsius": "degC",
    "fahrenheit": "degF",
    "°c": "degC",
    "°f": "degF",
    "second": "s",
    "sec": "s",
    "hour": "h",
    "metre": "m",
    "meter": "m",
    "gram": "g",
    "ampere": "A",
    "amp": "A",
    "radian": "rad",
    "degree": "deg",
    "newton": "N",
    "joule": "J",
    "watt": "W",
    "volt": "V",
    "hertz": "Hz",
    "pascal": "Pa",
}
"""Words for units, with their symbols, for messages."""

_WITH_OFFSET = {"degC": (1.0, 273.15), "degF": (5.0 / 9.0, 459.67 * 5.0 / 9.0)}
"""Factor and offset of temperatures to kelvin; they form no products."""


@dataclass(frozen=True)
class Unit:
    """A unit with its definition.

    Parameters
    ----------
    name : str
    exponents : tuple of int, or None
        Of the base units in the order of `BASE`; None where nothing defines the unit.
    factor, offset : float
        A value v in this unit is ``factor * v + offset`` in base units.
    """

    name: str
    exponents: tuple[int, ...] | None = None
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Conversion:
    """From one unit to another: ``factor * v + offset``; of a derivative, ``factor * v``.

    `doubt` is a warning where the units cannot be compared, or are equal up to radians; empty if
    there is none.
    """

    factor: float = 1.0
    offset: float = 0.0
    doubt: str = ""


def known_units() -> dict[str, Unit]:
    """Every name that may stand in a unit, with what it means."""
    return {name: unit_named(name) for name in (*_DERIVED, *_WITH_OFFSET)}


def unit_named(name: str) -> Unit:
    """The unit of a name that nothing defines: one that `base_unit` knows, or a temperature."""
    if name in _WITH_OFFSET:
        kelvin = tuple(int(symbol == "K") for symbol in BASE)
        return Unit(name, kelvin, *_WITH_OFFSET[name])
    try:
        found = base_unit(name)
    except InvalidInput:
        return Unit(name)
    exponents = tuple(int(found.get(symbol, 0)) for symbol in BASE)
    return Unit(name, exponents, float(found.get("factor", 1.0)))


def conversion(source: Unit | None, target: Unit | None, *, relative: bool = False) -> Conversion:
    """How values in one unit become values in another.

    Parameters
    ----------
    source, target : Unit or None
        None where a variable states no unit.
    relative : bool
        Whether the values are differences, to which no offset applies.

    Raises
    ------
    InvalidInput
        If the units measure different things.
    """
    if source is None or target is None:
        if source is target or {source, target} <= {None, Unit("1", (0,) * len(BASE))}:
            return Conversion()
        stated, side = (source, "input") if target is None else (target, "output")
        return Conversion(doubt=f"the {side} states no unit, the other end '{_name(stated)}'")
    if source.exponents is None or target.exponents is None:
        if source.name == target.name:
            return Conversion()
        return Conversion(doubt=f"'{source.name}' and '{target.name}' cannot be compared")
    differ = [
        symbol
        for symbol, a, b in zip(BASE, source.exponents, target.exponents, strict=True)
        if a != b
    ]
    if any(symbol != "rad" for symbol in differ):
        raise InvalidInput(
            f"'{source.name}' cannot become '{target.name}': {_product(source.exponents)} "
            f"against {_product(target.exponents)} in SI units"
        )
    factor = source.factor / target.factor
    offset = 0.0 if relative else (source.offset - target.offset) / target.factor
    doubt = f"'{source.name}' and '{target.name}' differ by radians" if differ else ""
    return Conversion(factor, offset, doubt)


def is_rate(rate: Unit | None, unit: Unit | None, order: int = 1) -> bool:
    """Whether a unit is that of a derivative: `unit` per second to the power `order`.

    True where one of them is not stated or not defined; radians do not count.
    """
    if rate is None or unit is None or rate.exponents is None or unit.exponents is None:
        return True
    time = BASE.index("s")
    expected = [power - order * (place == time) for place, power in enumerate(unit.exponents)]
    same = all(
        symbol == "rad" or a == b
        for symbol, a, b in zip(BASE, rate.exponents, expected, strict=True)
    )
    return same and math.isclose(rate.factor, unit.factor, rel_tol=1e-12)


def _name(unit: Unit | None) -> str:
    return "" if unit is None else unit.name


def _product(exponents: tuple[int, ...]) -> str:
    """Base units as a product: kg.m.s-2."""
    parts = (
        symbol + (str(power) if power != 1 else "")
        for symbol, power in zip(BASE, exponents, strict=True)
        if power
    )
    return ".".join(parts) or "1"


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
    for name, power in factors(unit).items():
        size, base = _DERIVED[name]
        factor *= size**power
        for symbol, exponent in base.items():
            exponents[symbol] += power * exponent
    attributes = {name: str(exponents[name]) for name in BASE if exponents[name]}
    return attributes if factor == 1.0 else {**attributes, "factor": repr(factor)}


def factors(unit: str) -> dict[str, int]:
    """The names in a unit such as ``N.m/rad``, each with its power.

    Raises
    ------
    InvalidInput
        If a name is not known.
    """
    powers: Counter[str] = Counter()
    for place, part in enumerate(unit.split("/")):
        for name in part.split("."):
            match = _FACTOR.fullmatch(name)
            if match is None or match.group(1) not in _DERIVED:
                symbol = match.group(1) if match is not None else name
                word = symbol.casefold()
                symbol = _SPELLED_OUT.get(word, _SPELLED_OUT.get(word.removesuffix("s"), symbol))
                if symbol in _WITH_OFFSET:
                    raise InvalidInput(
                        f"unit '{unit}': '{symbol}' has an offset and cannot stand in a linear "
                        "equation or a product; give 'K'"
                    )
                remedy = f"give '{symbol}'" if symbol in _DERIVED else nearest(name, _DERIVED)
                raise InvalidInput(f"unit '{unit}': '{name}' is no unit; {remedy}")
            powers[match.group(1)] += (-1 if place else 1) * int(match.group(2) or 1)
    return {name: power for name, power in powers.items() if power and name != "1"}


def unit_of_factors(powers: Mapping[str, int]) -> str:
    """The unit that `factors` is of: ``m/s2``."""
    up = [name + (str(p) if p > 1 else "") for name, p in powers.items() if p > 0]
    down = [f"/{name}" + (str(-p) if p < -1 else "") for name, p in powers.items() if p < 0]
    return (".".join(up) or "1") + "".join(down)
