"""The connectors of an SSP archive and the connections between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import Variable, describe
from congelation.fmi.units import Unit, conversion
from congelation.scenario.ssp.archive import NAMESPACES, Archive
from congelation.scenario.ssp.parameters import Quantity, in_own_unit

__all__ = ["Connector", "connections_between", "connectors_of", "driven_from_outside"]

_TRANSFORMATIONS = tuple(
    f"{{{NAMESPACES['ssc']}}}{kind}Transformation"
    for kind in ("Linear", "BooleanMapping", "IntegerMapping", "EnumerationMapping")
)


@dataclass(frozen=True)
class Connector:
    """A connector of a component.

    Parameters
    ----------
    kind : str
    variable : Variable or None
        Of the FMU; None where it has none of that name.
    unit : Unit or None
        That of the variable, else the connector's own, which `stated` says.
    """

    kind: str
    variable: Variable | None
    unit: Unit | None
    stated: bool


def connectors_of(
    system: etree._Element,
    archive: Archive,
    components: Mapping[str, Mapping[str, Any]],
    units: Mapping[str, Unit],
) -> dict[tuple[str, str], Connector]:
    """The connectors of all components, by element and name.

    Raises
    ------
    InvalidInput
        One whose type, unit or direction is not that of the FMU's variable.
    """
    found: dict[tuple[str, str], Connector] = {}
    for element in system.findall("ssd:Elements/ssd:Component", NAMESPACES):
        owner = element.get("name", "")
        description = describe(Path(components[owner]["fmu"]))
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES):
            name, direction = connector.get("name", ""), connector.get("kind", "")
            what = f"component '{owner}': the connector '{name}'"
            variable = description.variables.get(name)
            kind, unit = _type_of(connector)
            if variable is None:
                found[owner, name] = Connector(direction, None, None, False)
                continue
            if kind and {"Enumeration": "Integer"}.get(kind, kind) != variable.type:
                raise archive.error(
                    f"{what} is of type {kind}, the variable of the FMU of type {variable.type}; "
                    "give the FMU's"
                )
            if {direction, variable.causality} == {"input", "output"}:
                raise archive.error(
                    f"{what} is an {direction}, the variable of the FMU an {variable.causality}; "
                    "give the FMU's"
                )
            if unit and variable.unit and unit != variable.unit:
                raise archive.error(
                    f"{what} is in '{unit}', the variable of the FMU in '{variable.unit}'; give "
                    "the FMU's"
                )
            own = description.unit(variable.unit)
            stated = own is None and bool(unit)
            if stated:
                own = units.get(unit) or description.unit(unit)
            found[owner, name] = Connector(direction, variable, own, stated)
    return found


def _type_of(connector: etree._Element) -> tuple[str, str]:
    """The type that a connector states, and its unit; empty where it states none."""
    for child in connector:
        if isinstance(child.tag, str) and NAMESPACES["ssc"] in child.tag:
            return etree.QName(child).localname, child.get("unit", "")
    return "", ""


def driven_from_outside(
    system: etree._Element,
    archive: Archive,
    components: Mapping[str, Mapping[str, Any]],
    connectors: Mapping[tuple[str, str], Connector],
    parameters: dict[str, object],
    units: Mapping[str, Unit],
) -> list[tuple[str, str]]:
    """The inputs, (element, variable), that connectors of the system would drive.

    A parameter of the name of such a connector is the value of what is connected to it, and is
    taken out of `parameters`; it takes precedence over those of the component.
    """
    outside = {
        connector.get("name"): (connector.get("kind"), *_type_of(connector))
        for connector in system.findall("ssd:Connectors/ssd:Connector", NAMESPACES)
    }
    inputs: list[tuple[str, str]] = []
    driven: dict[tuple[str, str], str] = {}
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = _ends(connection)
        outer = [connector for element, connector in ends if not element]
        inner = [end for end in ends if end[0]]
        if not outer:
            continue  # see connections_between
        what = f"connection with the connector '{outer[0]}' of the system"
        for connector in outer:
            if connector not in outside:
                raise archive.error(f"{what}: it has none; {nearest(connector, map(str, outside))}")
        _check_connection(connection, inner, connectors, what, archive)
        if not inner:
            continue
        (end,) = inner
        found, (kind, _, unit) = connectors[end], outside[outer[0]]
        if (kind == "output") != (found.kind == "output"):
            raise archive.error(
                f"{what}: it is an {kind}, and '{'.'.join(end)}' an {found.kind}; an input of the "
                "system leads to inputs, and outputs lead to its outputs"
            )
        if kind == "output" or found.variable is None:
            continue
        if end in driven:
            raise archive.error(
                f"{what}: '{'.'.join(end)}' is driven by '{driven[end]}' already; an input takes "
                "one source"
            )
        driven[end] = outer[0]
        name, variable = end
        if outer[0] in parameters:
            value = parameters[outer[0]]
            if unit and not isinstance(value, Quantity) and found.unit is not None:
                value = Quantity(value, unit, units.get(unit))
            own = found.unit if found.stated else None
            description = describe(Path(components[name]["fmu"]))
            components[name]["start"][variable] = in_own_unit(
                value, description, variable, what, archive, own
            )
        elif kind == "input":
            inputs.append(end)
    for connector in driven.values():
        parameters.pop(connector, None)
    return inputs


def connections_between(
    system: etree._Element,
    archive: Archive,
    names: Mapping[str, str],
    connectors: Mapping[tuple[str, str], Connector],
) -> Iterator[str]:
    """The connections between components, each from an output to an input."""
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = _ends(connection)
        if not all(element for element, _ in ends):
            continue  # see driven_from_outside
        what = "connection '{}.{} -> {}.{}'".format(*ends[0], *ends[1])
        _check_connection(connection, ends, connectors, what, archive)
        if [connectors[end].kind for end in ends] == ["input", "output"]:
            ends.reverse()  # start and end do not tell the direction, the kinds do
        if [connectors[end].kind for end in ends] != ["output", "input"]:
            raise archive.error(f"{what}: give an output and an input")
        _check_units(connectors[ends[0]], connectors[ends[1]], what, archive)
        source, target = (f"{names[element]}.{connector}" for element, connector in ends)
        yield f"{source} -> {target}"


def _ends(connection: etree._Element) -> list[tuple[str, str]]:
    """Element and connector of both ends; the element is empty where it is the system."""
    ends = ("start", "end")
    return [(connection.get(f"{e}Element", ""), connection.get(f"{e}Connector")) for e in ends]


def _check_connection(
    connection: etree._Element,
    ends: Sequence[tuple[str, str]],
    connectors: Mapping[tuple[str, str], Connector],
    what: str,
    archive: Archive,
) -> None:
    """Refuse what would change values on their way, and connectors that no element has."""
    if any(child.tag in _TRANSFORMATIONS for child in connection):
        raise archive.error(f"{what}: a transformation; put it into an FMU")
    if connection.get("suppressUnitConversion", "false") in ("true", "1"):
        raise archive.error(f"{what}: suppressUnitConversion; units are always converted here")
    for end in ends:
        if end not in connectors:
            known = [".".join(connector) for connector in connectors]
            here = ".".join(end)
            raise archive.error(f"{what}: no connector '{here}'; {nearest(here, known)}")


def _check_units(source: Connector, target: Connector, what: str, archive: Archive) -> None:
    """Refuse a conversion that connectors ask for and the FMUs' own units do not make."""
    if source.unit is None or target.unit is None or not (source.stated or target.stated):
        return
    try:
        found = conversion(source.unit, target.unit)
    except InvalidInput as error:
        raise archive.error(f"{what}: {error}") from None
    if (found.factor, found.offset) != (1.0, 0.0):
        raise archive.error(
            f"{what}: from '{source.unit.name}' to '{target.unit.name}', where an FMU states no "
            "unit to convert by; give both connectors one unit"
        )
