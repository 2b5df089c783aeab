"""An SSP archive as a scenario: components, parameters, connections, experiment.

What is read is one system of FMUs. Whatever else an archive may state (systems within systems,
transformations, mappings) is refused, not passed over.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from lxml import etree

from congelation.errors import nearest
from congelation.fmi.description import Variable, describe
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
    components, ignored = _components(system, archive)
    surroundings = _surroundings(system, archive, components, ignored)
    names = _plain_names(components)
    components = {names[name]: component for name, component in components.items()}
    connections = list(_connections(system, archive, names))
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
        plain = name = re.sub(r"[.\s]+", "_", element)
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
        fmu = archive.find(element.get("source", ""), what)
        values = _bound_values(element, archive, what)
        # Of elements "a" and "a.b", "a.b.c" is of the longer name.
        longer = tuple(f"{other}." for other in elements if other.startswith(f"{name}."))
        for key in [k for k in overriding if k.startswith(f"{name}.") and not k.startswith(longer)]:
            values[key.removeprefix(f"{name}.")] = overriding.pop(key)
        known = describe(fmu).variables
        # SSP 1.0: parameters for which there is no variable are ignored.
        start = {key: value for key, value in values.items() if key in known}
        ignored |= {f"{name}.{key}": v for key, v in values.items() if key not in known}
        _check_connectors(element, known, archive, what)
        components[name] = {"fmu": str(fmu), "start": start}
    return components, ignored | overriding


def _check_connectors(
    element: etree._Element, known: Mapping[str, Variable], archive: Archive, what: str
) -> None:
    """Refuse connectors whose type or unit is not that of the FMU's variable."""
    for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES):
        variable = known.get(connector.get("name", ""))
        typed = [e for e in connector if isinstance(e.tag, str) and NAMESPACES["ssc"] in e.tag]
        if variable is None or not typed:
            continue
        kind = etree.QName(typed[0]).localname
        if {"Enumeration": "Integer"}.get(kind, kind) != variable.type:
            raise archive.error(
                f"{what}: the connector '{variable.name}' is of type {kind}, the variable of the "
                f"FMU of type {variable.type}; give the FMU's"
            )
        unit = typed[0].get("unit", "")
        if unit and variable.unit and unit != variable.unit:
            raise archive.error(
                f"{what}: the connector '{variable.name}' is in '{unit}', the variable of the FMU "
                f"in '{variable.unit}'; give the FMU's"
            )


def _surroundings(
    system: etree._Element,
    archive: Archive,
    components: Mapping[str, Mapping[str, Any]],
    parameters: dict[str, object],
) -> list[tuple[str, str]]:
    """The inputs, (element, variable), that connectors of the system would drive.

    A parameter of the name of such a connector is the value of what is connected to it, and is
    taken out of `parameters`; it takes precedence over those of the component.
    """
    kinds = {
        connector.get("name"): connector.get("kind")
        for connector in system.findall("ssd:Connectors/ssd:Connector", NAMESPACES)
    }
    inputs: list[tuple[str, str]] = []
    used: set[str] = set()
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = [(connection.get(f"{e}Element"), connection.get(f"{e}Connector")) for e in _ENDS]
        outer = [connector for element, connector in ends if element is None]
        inner = [end for end in ends if end[0] is not None]
        if not outer:
            continue
        what = f"connection with the connector '{outer[0]}' of the system"
        if outer[0] not in kinds:
            raise archive.error(f"{what}: it has none; {nearest(outer[0], map(str, kinds))}")
        if any(child.tag in _TRANSFORMATIONS for child in connection):
            raise archive.error(f"{what}: a transformation; put it into an FMU")
        if not inner or kinds[outer[0]] == "output":
            continue
        (name, variable), *_ = inner
        if name not in components:
            raise archive.error(f"{what}: no component '{name}'; {nearest(name, components)}")
        if outer[0] in parameters:
            components[name]["start"][variable] = parameters[outer[0]]
            used.add(outer[0])
        elif kinds[outer[0]] == "input":
            inputs.append((name, variable))
    for name in used:
        del parameters[name]
    return inputs


def _connections(
    system: etree._Element, archive: Archive, names: Mapping[str, str]
) -> Iterator[str]:
    """The connections between components, each from an output to an input."""
    kinds = {
        (element.get("name"), connector.get("name")): connector.get("kind")
        for element in system.findall("ssd:Elements/ssd:Component", NAMESPACES)
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES)
    }
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
        source, target = (f"{names[element]}.{connector}" for element, connector in ends)
        yield f"{source} -> {target}"


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
    except json.JSONDecodeError as error:
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': no JSON: {error}") from error
    if not isinstance(tables, dict):
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': give a JSON object")
    return tables


def _experiment(
    root: etree._Element,
    annotated: object,
    components: Mapping[str, Mapping[str, object]],
    connections: Iterable[str],
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
        if all(description.can_get_and_set_state for description in found):
            # Steps made again in halves know their error best where inputs are held.
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
            for parameter in parameter_set.findall("ssv:Parameters/ssv:Parameter", NAMESPACES):
                values[prefix + parameter.get("name", "")] = _value(parameter, archive, what)
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
    if source is not None:
        content = archive.find(source, what).read_bytes()
        yield parse(content, PARAMETERS, f"{archive.file}: {source}")
    for inline in binding.findall("ssd:ParameterValues/ssv:ParameterSet", NAMESPACES):
        yield parse(etree.tostring(inline), PARAMETERS, f"{archive.file}: parameters of {what}")


def _value(parameter: etree._Element, archive: Archive, what: str) -> object:
    element = next(child for child in parameter if isinstance(child.tag, str))
    kind = etree.QName(element).localname
    if kind not in _READERS:
        name = parameter.get("name")
        known = ", ".join(_READERS)
        raise archive.error(f"{what}: parameter '{name}' is a value of type {kind}; give {known}")
    value = _READERS[kind](element.get("value", ""))
    if isinstance(value, str) and value and (archive.folder / value).is_file():
        value = str(archive.find(value, what))  # an FMU looks for files from where its host runs
    unit = element.get("unit")
    return value if unit is None else {"value": value, "unit": unit}


def _boolean(text: str) -> bool:
    return text.strip() in ("true", "1")


# float and int read every form of xs:double and xs:int; the schema has refused all others.
_READERS: Mapping[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Boolean": _boolean,
    "String": str,
}
