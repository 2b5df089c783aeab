"""What pythonfmu leaves out of modelDescription.xml, filled in from the interface.

Units, dependencies, InitialUnknowns, a GUID that follows from the content, no date: FMI 2.0.4,
sections 2.2.2 (units), 2.2.8 (model structure), 4.3.1 (co-simulation).
"""

from __future__ import annotations

import copy
import uuid
from collections.abc import Iterable
from xml.etree import ElementTree

from congelation.export.interface import Interface, ScalarVariable
from congelation.fmi.units import base_unit

__all__ = ["complete"]

# The start of all GUIDs made here; its value means nothing, it only has to stay the same.
_NAMESPACE = uuid.UUID("2f1de3ac-6a7e-5d6b-9b57-5a1f6f0f5c1e")
_EXPERIMENT = {"startTime": "0", "stopTime": "10", "stepSize": "0.001", "tolerance": "1e-08"}


def complete(xml: bytes, interface: Interface, digest: str, tool: str) -> bytes:
    """The completed modelDescription.xml.

    Parameters
    ----------
    xml : bytes
        As pythonfmu wrote it.
    interface : Interface
        The variables, in the order of the XML.
    digest : str
        Hash of the FMU's sources, from which the GUID is made.
    tool : str
        generationTool.
    """
    root = copy.deepcopy(ElementTree.fromstring(xml))
    root.attrib.pop("generationDateAndTime", None)
    root.set("guid", f"{{{uuid.uuid5(_NAMESPACE, digest)}}}")
    root.set("generationTool", tool)
    root.set("license", "MIT")
    co_simulation = _child(root, "CoSimulation")
    # The order of elements is fixed by the schema: units follow CoSimulation, the default
    # experiment follows the log categories.
    root.insert(list(root).index(co_simulation) + 1, _units(interface.variables))
    categories = _child(root, "LogCategories")
    experiment = ElementTree.Element("DefaultExperiment", _EXPERIMENT)
    root.insert(list(root).index(categories) + 1, experiment)
    _complete_variables(_child(root, "ModelVariables"), interface.variables)
    _replace_structure(_child(root, "ModelStructure"), interface.variables)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _child(root: ElementTree.Element, tag: str) -> ElementTree.Element:
    child = root.find(tag)
    if child is None:
        raise ValueError(f"modelDescription.xml has no {tag}")
    return child


def _units(variables: Iterable[ScalarVariable]) -> ElementTree.Element:
    definitions = ElementTree.Element("UnitDefinitions")
    for unit in sorted({v.unit for v in variables if v.unit}):
        element = ElementTree.SubElement(definitions, "Unit", {"name": unit})
        ElementTree.SubElement(element, "BaseUnit", base_unit(unit))
    return definitions


def _complete_variables(parent: ElementTree.Element, variables: Iterable[ScalarVariable]) -> None:
    """Units, and start values in as many digits as they need: pythonfmu writes 16, one too few."""
    for element, variable in zip(parent, variables, strict=True):
        if variable.type != "Real":
            continue
        real = _child(element, "Real")
        if variable.unit:
            real.set("unit", variable.unit)
        if variable.start is not None:
            real.set("start", repr(float(variable.start)))


def _replace_structure(
    structure: ElementTree.Element, variables: tuple[ScalarVariable, ...]
) -> None:
    """Outputs with their inputs, InitialUnknowns with all that they follow from."""
    structure.clear()
    index = {v.name: i for i, v in enumerate(variables, start=1)}
    inputs = {v.name for v in variables if v.causality == "input"}
    outputs = ElementTree.SubElement(structure, "Outputs")
    initial = ElementTree.SubElement(structure, "InitialUnknowns")
    for variable in variables:
        if variable.causality == "output":
            _unknown(outputs, variable, index, variable.depends & inputs)
        if variable.causality in ("output", "calculatedParameter"):
            _unknown(initial, variable, index, variable.depends)


def _unknown(
    parent: ElementTree.Element,
    variable: ScalarVariable,
    index: dict[str, int],
    depends: Iterable[str],
) -> None:
    knowns = sorted(index[name] for name in depends)
    attributes = {
        "index": str(index[variable.name]),
        "dependencies": " ".join(map(str, knowns)),
    }
    ElementTree.SubElement(parent, "Unknown", attributes)
