"""An SSP archive as a scenario: components, parameters, connections, experiment.

What is read is one system of FMUs. Whatever else an archive may state (systems within systems,
transformations, mappings) is refused, not passed over.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lxml import etree

from congelation.errors import InvalidInput
from congelation.fmi.description import describe
from congelation.scenario.scenario import EXPERIMENT, Scenario
from congelation.scenario.ssp.archive import (
    DESCRIPTION,
    NAMESPACES,
    SSD,
    Archive,
    parse,
    unpack,
)
from congelation.scenario.ssp.connectors import (
    connections_between,
    connectors_of,
    driven_from_outside,
)
from congelation.scenario.ssp.experiment import annotated_tables, experiment_table
from congelation.scenario.ssp.parameters import bound_values, defined_units, in_own_unit
from congelation.toml import Section

__all__ = ["read_ssp"]

_FMU = "application/x-fmu-sharedlibrary"


def read_ssp(file: Path, experiment: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario from an SSP archive; `experiment` replaces keys of its experiment.

    Raises
    ------
    InvalidInput
        Naming the file, the place in it, and what is wrong: no archive, not valid by the schema
        of SSP 1.0, a name that does not exist, something that cannot be run.
    """
    archive = unpack(file)
    try:
        return _scenario(archive, experiment or {})
    except InvalidInput as error:
        raise archive.named(error) from error


def _scenario(archive: Archive, experiment: Mapping[str, object]) -> Scenario:
    file = archive.file
    content = archive.find(SSD, "an SSP archive").read_bytes()
    root = parse(content, DESCRIPTION, f"{file}: {SSD}")
    system = root.find("ssd:System", NAMESPACES)
    units = defined_units(root, "ssd")
    components, ignored = _components(system, archive)
    connectors = connectors_of(system, archive, components, units)
    free = driven_from_outside(system, archive, components, connectors, ignored, units)
    names = _plain_names(components)
    components = {names[name]: component for name, component in components.items()}
    connections = list(connections_between(system, archive, names, connectors))
    document = {
        "title": " ".join((root.get("description") or root.get("name")).split()),
        **annotated_tables(root, archive),
        "components": components,
        "connections": connections,
        "open": [f"{names[name]}.{variable}" for name, variable in free],
    }
    stated = document.get(EXPERIMENT)
    document[EXPERIMENT] = experiment_table(
        root, stated, components, connections, archive, experiment
    )
    text = content.decode(errors="replace")
    scenario = Scenario.from_document(Section(str(file), "", document), file, text)
    unknown = [".".join(end) for end, found in connectors.items() if found.variable is None]
    warnings = [
        *_few([f"there is no variable for the parameter '{name}'" for name in ignored]),
        *_few([f"there is no variable for the connector '{name}'" for name in unknown]),
        *(f"the element '{a}' is called '{b}' here" for a, b in names.items() if a != b),
    ]
    named = (f"{file}: {warning}" for warning in warnings)
    return scenario.changed(warnings=(*scenario.warnings, *named))


MOST_WARNINGS = 20
"""Of one kind that are shown; of thousands nobody reads any."""


def _few(lines: list[str]) -> list[str]:
    """The first lines, and how many more there are."""
    rest = len(lines) - MOST_WARNINGS
    more = [f"{lines[0]}; {rest} more such are not shown"] if rest > 0 else []
    return [*lines[:MOST_WARNINGS], *more]


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
    overriding = bound_values(system, archive, "the system")
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
        values = bound_values(element, archive, what)
        # Of elements "a" and "a.b", "a.b.c" is of the longer name.
        longer = tuple(f"{other}." for other in elements if other.startswith(f"{name}."))
        for key in [k for k in overriding if k.startswith(f"{name}.") and not k.startswith(longer)]:
            values[key.removeprefix(f"{name}.")] = overriding.pop(key)
        description = describe(fmu)
        # SSP 1.0: parameters for which there is no variable are ignored.
        ignored |= {f"{name}.{k}": v for k, v in values.items() if k not in description.variables}
        start = {
            key: in_own_unit(value, description, key, f"{what}: parameter '{key}'", archive)
            for key, value in values.items()
            if key in description.variables
        }
        components[name] = {"fmu": str(fmu), "start": start}
    return components, ignored | overriding
