"""An SSP archive as a scenario: components, parameters, connections, experiment.

What is read is one system of FMUs. Whatever else an archive may state (systems within systems,
transformations, mappings) is refused, not passed over.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import Description, Variable, describe
from congelation.fmi.units import BASE, Unit, conversion
from congelation.scenario.parts import replaced
from congelation.scenario.scenario import EXPERIMENT, Scenario
from congelation.scenario.ssp.archive import (
    ANNOTATION,
    DESCRIPTION,
    NAMESPACES,
    PARAMETERS,
    SSD,
    Archive,
    parse,
    unpack,
)
from congelation.toml import Section

__all__ = ["read_ssp"]

_FMU = "application/x-fmu-sharedlibrary"
_PARAMETER_SET = "application/x-ssp-parameter-set"

# How an archive is run that does not say so, as those of other tools: to a tolerance if all its
# FMUs can take a step back, otherwise with held inputs in so many steps. The tolerance is the
# larger one where an input can only be held: the number of steps then grows with its root, to
# tens in a second for a slow linear system.
_TOLERANCE = 1e-6
_TOLERANCE_OF_HELD_INPUTS = 1e-4
_STEPS = 1000


def read_ssp(file: Path, experiment: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario from an SSP archive; `experiment` replaces keys of its experiment.

    Raises
    ------
    InvalidInput
        Naming the file, the place in it, and what is wrong: no archive, not valid by the schema
        of SSP 1.0, a name that does not exist, something that cannot be run.
    """
    archive = unpack(file)
    content = archive.find(SSD, "an SSP archive").read_bytes()
    root = parse(content, DESCRIPTION, f"{file}: {SSD}")
    system = root.find("ssd:System", NAMESPACES)
    units = _defined_units(root, "ssd")
    components, ignored = _components(system, archive)
    connectors = _connectors(system, archive, components, units)
    surroundings = _surroundings(system, archive, components, connectors, ignored, units)
    names = _plain_names(components)
    components = {names[name]: component for name, component in components.items()}
    connections = list(_connections(system, archive, names, connectors))
    document = {
        "title": root.get("description") or root.get("name"),
        **_annotated(root, archive),
        "components": components,
        "connections": connections,
        "open": [f"{names[name]}.{variable}" for name, variable in surroundings],
    }
    stated = document.get(EXPERIMENT)
    document[EXPERIMENT] = _experiment(
        root, stated, components, connections, archive, experiment or {}
    )
    text = content.decode(errors="replace")
    scenario = Scenario.from_document(Section(str(file), "", document), file, text)
    warnings = [f"{file}: there is no variable for the parameter '{name}'" for name in ignored]
    warnings += [
        f"{file}: there is no variable for the connector '{element}.{connector}'"
        for (element, connector), found in connectors.items()
        if found.variable is None
    ]
    warnings += [
        f"{file}: the element '{name}' is called '{plain}' here"
        for name, plain in names.items()
        if name != plain
    ]
    return scenario.changed(warnings=(*scenario.warnings, *warnings))


def _plain_names(elements: Iterable[str]) -> dict[str, str]:
    """Names of components by those of elements, which may have blanks and dots."""
    taken = set(elements)
    names: dict[str, str] = {}
    for element in elements:
        plain = name = re.sub(r"([.\s]|->)+", "_", element)
        for number in itertools.count(2):
            if name == element or name not in taken:
                break
            name = f"{plain}_{number}"
        taken.add(name)
        names[element] = name
    return names


def _components(
    system: etree._Element, archive: Archive
) -> tuple[dict[str, dict[str, Any]], dict[str, object]]:
    """The FMU and the start values of each component, and the parameters that fit none.

    Those of the system that fit none may be meant for its connectors.
    """
    components: dict[str, dict[str, Any]] = {}
    ignored: dict[str, object] = {}
    # A system's parameters take precedence over its components'.
    overriding = _bound_values(system, archive, "the system")
    elements = [e.get("name", "") for e in system.findall("ssd:Elements/*", NAMESPACES)]
    for element in system.findall("ssd:Elements/*", NAMESPACES):
        name = element.get("name", "")
        what = f"component '{name}'"
        kind = element.get("type", _FMU)
        if etree.QName(element).localname != "Component" or kind != _FMU:
            raise archive.error(f"{what} is no FMU; only systems of FMUs can be run")
        if name in components:
            raise archive.error(f"{what} is given twice; names must differ")
        if element.get("implementation") == "ModelExchange":
            raise archive.error(
                f"{what} is to be run by model exchange; FMUs of archives are run by co-simulation"
            )
        fmu = archive.find(element.get("source", ""), what)
        values = _bound_values(element, archive, what)
        # Of elements "a" and "a.b", "a.b.c" is of the longer name.
        longer = tuple(f"{other}." for other in elements if other.startswith(f"{name}."))
        for key in [k for k in overriding if k.startswith(f"{name}.") and not k.startswith(longer)]:
            values[key.removeprefix(f"{name}.")] = overriding.pop(key)
        description = describe(fmu)
        # SSP 1.0: parameters for which there is no variable are ignored.
        ignored |= {f"{name}.{k}": v for k, v in values.items() if k not in description.variables}
        start = {
            key: _in_own_unit(value, description, key, f"{what}: parameter '{key}'", archive)
            for key, value in values.items()
            if key in description.variables
        }
        components[name] = {"fmu": str(fmu), "start": start}
    return components, ignored | overriding


@dataclass(frozen=True)
class _Quantity:
    """A value that states its unit, and what the file that states it defines that to be."""

    value: Any
    unit: str
    defined: Unit | None


def _in_own_unit(
    value: object,
    description: Description,
    name: str,
    what: str,
    archive: Archive,
    own: Unit | None = None,
) -> object:
    """A start value of the variable `name` in the variable's unit; `own` is that of a connector
    to it where the variable has none."""
    if not isinstance(value, _Quantity):
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


def _defined_units(root: etree._Element, prefix: str) -> dict[str, Unit]:
    """The units that a file defines: those of an SSD, or of a parameter set, by `prefix`."""
    units: dict[str, Unit] = {}
    for unit in root.findall(f"{prefix}:Units/ssc:Unit", NAMESPACES):
        name, base = unit.get("name", ""), unit.find("ssc:BaseUnit", NAMESPACES)
        exponents = tuple(int(base.get(symbol, "0")) for symbol in BASE)
        factor, offset = (float(base.get(k, d)) for k, d in (("factor", "1"), ("offset", "0")))
        units[name] = Unit(name, exponents, factor, offset) if factor else Unit(name)
    return units


@dataclass(frozen=True)
class _Connector:
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


def _connectors(
    system: etree._Element,
    archive: Archive,
    components: Mapping[str, Mapping[str, Any]],
    units: Mapping[str, Unit],
) -> dict[tuple[str, str], _Connector]:
    """The connectors of all components, by element and name.

    Raises
    ------
    InvalidInput
        One whose type, unit or direction is not that of the FMU's variable.
    """
    found: dict[tuple[str, str], _Connector] = {}
    for element in system.findall("ssd:Elements/ssd:Component", NAMESPACES):
        owner = element.get("name", "")
        description = describe(Path(components[owner]["fmu"]))
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES):
            name, direction = connector.get("name", ""), connector.get("kind", "")
            what = f"component '{owner}': the connector '{name}'"
            variable = description.variables.get(name)
            kind, unit = _type_of(connector)
            if variable is None:
                found[owner, name] = _Connector(direction, None, None, False)
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
            found[owner, name] = _Connector(direction, variable, own, stated)
    return found


def _type_of(connector: etree._Element) -> tuple[str, str]:
    """The type that a connector states, and its unit; empty where it states none."""
    for child in connector:
        if isinstance(child.tag, str) and NAMESPACES["ssc"] in child.tag:
            return etree.QName(child).localname, child.get("unit", "")
    return "", ""


def _surroundings(
    system: etree._Element,
    archive: Archive,
    components: Mapping[str, Mapping[str, Any]],
    connectors: Mapping[tuple[str, str], _Connector],
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
    used: set[str] = set()
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = [(connection.get(f"{e}Element"), connection.get(f"{e}Connector")) for e in _ENDS]
        outer = [connector for element, connector in ends if element is None]
        inner = [end for end in ends if end[0] is not None]
        if not outer:
            continue
        what = f"connection with the connector '{outer[0]}' of the system"
        for connector in outer:
            if connector not in outside:
                raise archive.error(f"{what}: it has none; {nearest(connector, map(str, outside))}")
        if any(child.tag in _TRANSFORMATIONS for child in connection):
            raise archive.error(f"{what}: a transformation; put it into an FMU")
        if not inner:
            continue
        (end,) = inner
        if end not in connectors:
            known = [".".join(connector) for connector in connectors]
            here = ".".join(end)
            raise archive.error(f"{what}: no connector '{here}'; {nearest(here, known)}")
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
        (name, variable) = end
        if outer[0] in parameters:
            value = parameters[outer[0]]
            if unit and not isinstance(value, _Quantity) and found.unit is not None:
                value = _Quantity(value, unit, units.get(unit))
            components[name]["start"][variable] = _in_own_unit(
                value,
                describe(Path(components[name]["fmu"])),
                variable,
                what,
                archive,
                found.unit if found.stated else None,
            )
            used.add(outer[0])
        elif kind == "input":
            inputs.append((name, variable))
    for name in used:
        del parameters[name]
    return inputs


def _connections(
    system: etree._Element,
    archive: Archive,
    names: Mapping[str, str],
    connectors: Mapping[tuple[str, str], _Connector],
) -> Iterator[str]:
    """The connections between components, each from an output to an input."""
    kinds = {end: connector.kind for end, connector in connectors.items()}
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = [(connection.get(f"{e}Element"), connection.get(f"{e}Connector")) for e in _ENDS]
        if any(element is None for element, _ in ends):
            continue  # with the surroundings; see _surroundings
        what = "connection '{}.{} -> {}.{}'".format(*ends[0], *ends[1])
        if any(child.tag in _TRANSFORMATIONS for child in connection):
            raise archive.error(f"{what}: a transformation; put it into an FMU")
        if connection.get("suppressUnitConversion", "false") in ("true", "1"):
            raise archive.error(f"{what}: suppressUnitConversion; units are always converted here")
        for end in ends:
            if end not in kinds:
                known = [".".join(connector) for connector in kinds]
                here = ".".join(end)
                raise archive.error(f"{what}: no connector '{here}'; {nearest(here, known)}")
        if [kinds[end] for end in ends] == ["input", "output"]:
            ends.reverse()  # start and end do not tell the direction, the kinds do
        if [kinds[end] for end in ends] != ["output", "input"]:
            raise archive.error(f"{what}: give an output and an input")
        _check_units(connectors[ends[0]], connectors[ends[1]], what, archive)
        source, target = (f"{names[element]}.{connector}" for element, connector in ends)
        yield f"{source} -> {target}"


def _check_units(source: _Connector, target: _Connector, what: str, archive: Archive) -> None:
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


_ENDS = ("start", "end")
_TRANSFORMATIONS = tuple(
    f"{{{NAMESPACES['ssc']}}}{kind}Transformation"
    for kind in ("Linear", "BooleanMapping", "IntegerMapping", "EnumerationMapping")
)


def _annotated(root: etree._Element, archive: Archive) -> dict[str, object]:
    """What an archive of congelation says beyond SSP 1.0; nothing for others."""
    path = f"ssd:DefaultExperiment/ssd:Annotations/ssc:Annotation[@type='{ANNOTATION}']/*"
    element = root.find(path, NAMESPACES)
    if element is None:
        return {}
    try:
        tables = json.loads(element.text or "")
    # Besides errors of JSON, those of a number of thousands of digits and of deep nesting.
    except (ValueError, RecursionError) as error:
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': no JSON: {error}") from error
    if not isinstance(tables, dict):
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': give a JSON object")
    return tables


def _experiment(
    root: etree._Element,
    annotated: object,
    components: Mapping[str, Mapping[str, object]],
    connections: Collection[str],
    archive: Archive,
    given: Mapping[str, object],
) -> object:
    """The experiment table: the annotation's, with the times of the default experiment, and what
    the caller gives in place of them."""
    if annotated is None:
        annotated = {}
    if not isinstance(annotated, dict):
        return annotated  # refused with its place, as in a scenario file
    table = dict(annotated)
    default = root.find("ssd:DefaultExperiment", NAMESPACES)
    times = {} if default is None else default.attrib
    for attribute, key in (("startTime", "start_time"), ("stopTime", "stop_time")):
        if attribute in times:
            table[key] = float(times[attribute])
    table = replaced(table, given)
    if "stop_time" not in table:
        raise archive.error(
            f"{SSD}: DefaultExperiment: stopTime is missing; give it there in seconds, or run with "
            "--stop-time"
        )
    if "step" in table or "tolerance" in table:
        return table
    if (annotated_step := _step_of_other_tools(root, archive)) is not None:
        return {"coupling": "jacobi", **table, "step": annotated_step}
    found = [describe(Path(str(component["fmu"]))) for component in components.values()]
    if all(description.can_vary_step for description in found):
        if all(_carries_polynomials(connection, components) for connection in connections):
            return {**table, "tolerance": _TOLERANCE}
        table = {**table, "tolerance": _TOLERANCE_OF_HELD_INPUTS}
        # Steps made again in halves know their error best where inputs are held, but only that of
        # outputs which lead on: what nobody listens to could be wrong unseen.
        able = all(description.can_get_and_set_state for description in found)
        ends = [connection.split(" -> ") for connection in connections]
        sources, targets = ({end.partition(".")[0] for end in e} for e in zip(*ends, strict=True))
        if able and targets <= sources:
            return {"coupling": "derivative", **table}
        return table
    step = (table["stop_time"] - table.get("start_time", 0.0)) / _STEPS
    return {**table, "step": step}


def _carries_polynomials(connection: str, components: Mapping[str, Mapping[str, object]]) -> bool:
    """Whether the output of a connection has a derivative and its input takes one."""
    names = (end.partition(".") for end in connection.split(" -> "))
    (source, output), (target, driven) = (
        (describe(Path(str(components[component]["fmu"]))), variable)
        for component, _, variable in names
    )
    found = source.variables.get(output)
    if found is not None and found.type != "Real":
        return True  # Integer, Boolean and String values have none
    has = source.max_output_derivative_order > 0 or f"der({output})" in source.variables
    return has and (target.can_interpolate_inputs or f"der({driven})" in target.variables)


def _step_of_other_tools(root: etree._Element, archive: Archive) -> float | None:
    """The fixed step that an archive states for libcosim or OMSimulator, which hold inputs."""
    for path, attribute in (
        (".//osp:Algorithm/osp:FixedStepAlgorithm", "baseStepSize"),
        (".//oms:SimulationInformation/oms:FixedStepMaster", "stepSize"),
    ):
        element = root.find(path, NAMESPACES)
        text = None if element is None else element.get(attribute)
        if text is None:
            continue
        try:
            step = float(text)
        except ValueError:
            step = math.nan
        if not 0.0 < step < math.inf:
            raise archive.error(f"{SSD}: {attribute} = '{text}' is not a positive time")
        return step
    return None


def _bound_values(element: etree._Element, archive: Archive, what: str) -> dict[str, object]:
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
            units = _defined_units(parameter_set, "ssv")
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
    return value if unit is None else _Quantity(value, unit, units.get(unit))


def _boolean(text: str) -> bool:
    return text.strip() in ("true", "1")


# float and int read every form of xs:double and xs:int; the schema has refused all others.
_READERS: Mapping[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Boolean": _boolean,
    "String": str,
}
