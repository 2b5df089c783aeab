"""An SSP archive as a scenario: components, parameters, connections, experiment.

What is read is one system of FMUs. Whatever else an archive may state (systems within systems,
transformations, mappings) is refused, not passed over.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from lxml import etree

from congelation.errors import nearest
from congelation.fmi.description import describe
from congelation.scenario.load import read_scenario
from congelation.scenario.scenario import EXPERIMENT, Scenario
from congelation.scenario.ssp.archive import Archive, unpack
from congelation.scenario.ssp.parameters import bound_values
from congelation.scenario.ssp.schema import ANNOTATION, DESCRIPTION, NAMESPACES, SSD, parse
from congelation.toml import Section

__all__ = ["read_ssp"]

_FMU = "application/x-fmu-sharedlibrary"

# How an archive is run that does not say so, as those of other tools: to this tolerance if all
# its FMUs can take a step back, otherwise with held inputs in so many steps.
_TOLERANCE = 1e-6
_STEPS = 1000


def read_ssp(file: Path) -> Scenario:
    """Read a scenario from an SSP archive.

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
    components = _components(system, archive)
    document = {
        "title": root.get("description") or root.get("name"),
        **_annotated(root, archive),
        "components": components,
        "connections": list(_connections(system, archive)),
    }
    document[EXPERIMENT] = _experiment(root, document.get(EXPERIMENT), components, archive)
    text = content.decode(errors="replace")
    return read_scenario(file, text, Section(str(file), "", document))


def _components(system: etree._Element, archive: Archive) -> dict[str, dict[str, object]]:
    """By name: the FMU and the start values of each component."""
    components: dict[str, dict[str, object]] = {}
    # A system's parameters take precedence over its components'.
    overriding = bound_values(system, archive, "the system")
    for element in system.findall("ssd:Elements/*", NAMESPACES):
        name = element.get("name", "")
        what = f"component '{name}'"
        kind = element.get("type", _FMU)
        if etree.QName(element).localname != "Component" or kind != _FMU:
            raise archive.error(f"{what} is no FMU; only systems of FMUs can be run")
        if name in components:
            raise archive.error(f"{what} is given twice; names must differ")
        fmu = archive.find(element.get("source", ""), what)
        values = bound_values(element, archive, what)
        values |= {
            key.removeprefix(f"{name}."): value
            for key, value in overriding.items()
            if key.startswith(f"{name}.")
        }
        known = describe(fmu).variables
        # SSP 1.0: parameters for which there is no variable are ignored.
        start = {key: value for key, value in values.items() if key in known}
        components[name] = {"fmu": str(fmu), "start": start}
    return components


def _connections(system: etree._Element, archive: Archive) -> Iterator[str]:
    """The connections between components, each from an output to an input."""
    kinds = {
        (element.get("name"), connector.get("name")): connector.get("kind")
        for element in system.findall("ssd:Elements/ssd:Component", NAMESPACES)
        for connector in element.findall("ssd:Connectors/ssd:Connector", NAMESPACES)
    }
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        ends = [(connection.get(f"{e}Element"), connection.get(f"{e}Connector")) for e in _ENDS]
        if any(element is None for element, _ in ends):
            continue  # with the surroundings, of which there are none
        what = "connection '{}.{} -> {}.{}'".format(*ends[0], *ends[1])
        if any(child.tag in _TRANSFORMATIONS for child in connection):
            raise archive.error(f"{what}: a transformation; put it into an FMU")
        for end in ends:
            if end not in kinds:
                names = [".".join(known) for known in kinds]
                here = ".".join(end)
                raise archive.error(f"{what}: no connector '{here}'; {nearest(here, names)}")
        if [kinds[end] for end in ends] == ["input", "output"]:
            ends.reverse()  # start and end do not tell the direction, the kinds do
        if [kinds[end] for end in ends] != ["output", "input"]:
            raise archive.error(f"{what}: give an output and an input")
        yield "{}.{} -> {}.{}".format(*ends[0], *ends[1])


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
    archive: Archive,
) -> object:
    """The experiment table: the annotation's, with the times of the default experiment."""
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
    if "stop_time" not in table:
        raise archive.error(f"{SSD}: DefaultExperiment: stopTime is missing; give it in seconds")
    if "step" in table or "tolerance" in table:
        return table
    if all(describe(Path(str(c["fmu"]))).can_get_and_set_state for c in components.values()):
        return {**table, "tolerance": _TOLERANCE}
    step = (table["stop_time"] - table.get("start_time", 0.0)) / _STEPS
    return {**table, "coupling": "jacobi", "step": step}
