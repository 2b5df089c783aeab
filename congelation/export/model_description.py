"""What pythonfmu leaves out of modelDescription.xml, filled in from the interface.

Units, dependencies, InitialUnknowns, a GUID that follows from the content, no date: FMI 2.0.4,
sections 2.2.2 (units), 2.2.8 (model structure), 4.3.1 (co-simulation).
"""

from __future__ import annotations

import copy
import uuid
from collections.abc import Iterable
from xml.etree import ElementTree

from congelation.export.interface import (
    Interface,
    ScalarVariable,
    StateVariable,
    delays,
    native_parameters,
)
from congelation.fmi.description import ANNOTATION
from congelation.fmi.units import base_unit
from congelation.theory.model import Model

__all__ = ["add_model_exchange", "complete"]

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
    root.insert(list(root).index(experiment) + 1, _annotations(interface.variables))
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


def _annotations(variables: Iterable[ScalarVariable]) -> ElementTree.Element:
    """The inputs that are meant to be left alone, for masters that name forgotten connections."""
    annotations = ElementTree.Element("VendorAnnotations")
    tool = ElementTree.SubElement(annotations, "Tool", {"name": ANNOTATION})
    inputs = ElementTree.SubElement(tool, "OpenInputs")  # a Tool holds one element
    for variable in variables:
        if variable.open:
            ElementTree.SubElement(inputs, "Input", {"name": variable.name})
    return annotations


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


def add_model_exchange(
    root: ElementTree.Element,
    model: Model,
    interface: Interface,
    states: tuple[StateVariable, ...],
) -> None:
    """Describe an FMU of co-simulation as a native one: for model exchange, too, and with its own
    parameters.

    A delay stays one for co-simulation: model exchange does not say what an input is between two
    times.

    Parameters
    ----------
    root : Element
        Of a modelDescription.xml that `complete` made; it is changed.
    model : Model
        What it is of.
    interface : Interface
        The variables in it.
    states : tuple of StateVariable
        The continuous states. Derivatives that are no variables yet come behind all others.
    """
    co_simulation = _child(root, "CoSimulation")
    kept = ("modelIdentifier", "needsExecutionTool", "canGetAndSetFMUstate", "canSerializeFMUstate")
    attributes = {name: str(co_simulation.get(name)) for name in kept}
    # The functions of the C library are used, not those that the importer offers.
    common = {"canNotUseMemoryManagementFunctions": "true", "providesDirectionalDerivative": "true"}
    co_simulation.attrib.update(common)
    if not delays(model):
        root.insert(
            list(root).index(co_simulation),
            ElementTree.Element(
                "ModelExchange",
                {**attributes, **common, "completedIntegratorStepNotNeeded": "true"},
            ),
        )
    root.set("numberOfEventIndicators", "0")
    # New variables, and units that only these have.
    parent = _child(root, "ModelVariables")
    variables = list(interface.variables)

    def add(v: ScalarVariable, attributes: dict[str, str]) -> None:
        element = ElementTree.SubElement(
            parent,
            "ScalarVariable",
            {
                "name": v.name,
                "valueReference": str(len(variables)),
                "description": v.description,
                "causality": v.causality,
                "variability": v.variability,
                "initial": str(v.initial),
            },
        )
        ElementTree.SubElement(element, v.type, attributes)
        variables.append(v)

    for state in states:
        if state.derivative_reference == len(variables):
            v = state.derivative
            add(v, {"unit": v.unit} if v.unit else {})
        derivative = _child(parent[state.derivative_reference], "Real")
        derivative.set("derivative", str(state.reference + 1))
    for v in native_parameters(model, interface):
        add(v, {"start": str(v.start).lower()})
    root[list(root).index(_child(root, "UnitDefinitions"))] = _units(variables)
    _replace_structure(_child(root, "ModelStructure"), tuple(variables), states)


def _replace_structure(
    structure: ElementTree.Element,
    variables: tuple[ScalarVariable, ...],
    states: tuple[StateVariable, ...] = (),
) -> None:
    """Outputs with their inputs, InitialUnknowns with all that they follow from.

    With states, outputs and derivatives depend on these, too; at initialisation the states follow
    from their start values.
    """
    structure.clear()
    index = {v.name: i for i, v in enumerate(variables, start=1)}
    inputs = {v.name for v in variables if v.causality == "input"}
    state_of = {state.start: variables[state.reference].name for state in states}
    started = {variables[s.reference].name: frozenset({s.start}) for s in states}
    derivatives = {s.derivative.name for s in states}

    def knowns(variable: ScalarVariable) -> frozenset[str]:
        direct = {state_of[name] for name in variable.depends & state_of.keys()}
        return (variable.depends & inputs) | direct

    outputs = ElementTree.SubElement(structure, "Outputs")
    for variable in variables:
        if variable.causality == "output":
            _unknown(outputs, variable, index, knowns(variable))
    if states:
        parent = ElementTree.SubElement(structure, "Derivatives")
        for state in states:
            _unknown(parent, state.derivative, index, knowns(state.derivative))
    initial = ElementTree.SubElement(structure, "InitialUnknowns")
    for variable in variables:
        shown = variable.causality in ("output", "calculatedParameter")
        if shown or variable.name in derivatives or variable.name in started:
            _unknown(initial, variable, index, started.get(variable.name, variable.depends))


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
