"""The values that an SSP archive gives to its components, with the units that its files define."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from lxml import etree

from congelation.errors import InvalidInput
from congelation.fmi.description import Description
from congelation.fmi.units import BASE, Unit, conversion
from congelation.scenario.ssp.archive import NAMESPACES, PARAMETERS, Archive, parse

__all__ = ["Quantity", "bound_values", "defined_units", "in_own_unit"]

_PARAMETER_SET = "application/x-ssp-parameter-set"


@dataclass(frozen=True)
class Quantity:
    """A value that states its unit, and what the file that states it defines that to be."""

    value: Any
    unit: str
    defined: Unit | None


def in_own_unit(
    value: object,
    description: Description,
    name: str,
    what: str,
    archive: Archive,
    own: Unit | None = None,
) -> object:
    """A start value of the variable `name` in the variable's unit; `own` is that of a connector
    to it where the variable has none."""
    if not isinstance(value, Quantity):
        return value
    variable = description.variables[name]
    target = description.unit(variable.unit) or own
    if target is None or (value.defined is None and own is None):
        return {"value": value.value, "unit": value.unit}  # for the reader of scenarios
    source = value.defined or description.unit(value.unit)
    try:
        found = conversion(source, target, relative=variable.relative)
    except InvalidInput as error:
        raise archive.error(f"{what}: {error}") from None
    if found.doubt:
        raise archive.error(f"{what}: {found.doubt}; give it in '{target.name}'")
    return found.factor * value.value + found.offset


def defined_units(root: etree._Element, prefix: str) -> dict[str, Unit]:
    """The units that a file defines: those of an SSD, or of a parameter set, by `prefix`."""
    units: dict[str, Unit] = {}
    for unit in root.findall(f"{prefix}:Units/ssc:Unit", NAMESPACES):
        name, base = unit.get("name", ""), unit.find("ssc:BaseUnit", NAMESPACES)
        exponents = tuple(int(base.get(symbol, "0")) for symbol in BASE)
        factor, offset = (float(base.get(k, d)) for k, d in (("factor", "1"), ("offset", "0")))
        units[name] = Unit(name, exponents, factor, offset) if factor else Unit(name)
    return units


def bound_values(element: etree._Element, archive: Archive, what: str) -> dict[str, object]:
    """The values that the parameter bindings of a component or system give, by name.

    Later bindings replace earlier ones. A value that states its unit is a table of both.

    Raises
    ------
    InvalidInput
        If a parameter set is missing or not valid, or if a binding cannot be followed; `what`
        names its owner.
    """
    values: dict[str, object] = {}
    for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
        _check_binding(binding, archive, what)
        prefix = binding.get("prefix", "")
        for parameter_set in _parameter_sets(binding, archive, what):
            units = defined_units(parameter_set, "ssv")
            seen: set[str] = set()
            for parameter in parameter_set.findall("ssv:Parameters/ssv:Parameter", NAMESPACES):
                name = parameter.get("name", "")
                if name in seen:
                    raise archive.error(
                        f"{what}: parameter '{name}' is given twice in one set; leave one out"
                    )
                seen.add(name)
                values[prefix + name] = _value(parameter, archive, what, units)
    return values


def _check_binding(binding: etree._Element, archive: Archive, what: str) -> None:
    kind = binding.get("type", _PARAMETER_SET)
    if kind != _PARAMETER_SET:
        raise archive.error(f"{what}: parameters of type '{kind}'; give '{_PARAMETER_SET}'")
    if binding.find("ssd:ParameterMapping", NAMESPACES) is not None:
        raise archive.error(f"{what}: a parameter mapping; give the FMU's own names")
    if binding.get("sourceBase", "SSD") != "SSD":
        raise archive.error(f"{what}: parameters inside of an FMU; put them beside the SSD")


def _parameter_sets(
    binding: etree._Element, archive: Archive, what: str
) -> Iterator[etree._Element]:
    source = binding.get("source")
    if source is not None and binding.find("ssd:ParameterValues", NAMESPACES) is not None:
        raise archive.error(
            f"{what}: a binding with the source '{source}' and with values of its own; give one"
        )
    if source is not None:
        content = archive.find(source, what).read_bytes()
        yield parse(content, PARAMETERS, f"{archive.file}: {source}")
    for inline in binding.findall("ssd:ParameterValues/ssv:ParameterSet", NAMESPACES):
        yield parse(etree.tostring(inline), PARAMETERS, f"{archive.file}: parameters of {what}")


def _value(
    parameter: etree._Element, archive: Archive, what: str, units: Mapping[str, Unit]
) -> object:
    element = next(child for child in parameter if isinstance(child.tag, str))
    kind = etree.QName(element).localname
    if kind not in _READERS:
        name = parameter.get("name")
        known = ", ".join(_READERS)
        raise archive.error(f"{what}: parameter '{name}' is a value of type {kind}; give {known}")
    value = _READERS[kind](element.get("value", ""))
    if isinstance(value, str) and (held := archive.held(value)) is not None:
        value = str(held)  # an FMU looks for files from where its host runs
    unit = element.get("unit")
    return value if unit is None else Quantity(value, unit, units.get(unit))


def _boolean(text: str) -> bool:
    return text.strip() in ("true", "1")


# float and int read every form of xs:double and xs:int; the schema has refused all others.
_READERS: Mapping[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Boolean": _boolean,
    "String": str,
}
