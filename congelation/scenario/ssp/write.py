"""One variant of a scenario as an SSP archive.

    SystemStructure.ssd        components, connections, experiment
    resources/<component>.ssv  the start values of a component
    resources/<name>.fmu       the FMUs
    resources/..               files that start values name: tables of theta(t)

Equal scenarios and FMUs give byte-identical archives.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

from lxml import etree

from congelation.arguments import checked
from congelation.cosim.system import ResolvedSystem, System
from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import Variable
from congelation.fmi.start_values import StartValue
from congelation.places import replace_whole
from congelation.scenario.scenario import Experiment, Scenario, Variant
from congelation.scenario.ssp.archive import (
    ANNOTATION,
    DESCRIPTION,
    NAMESPACES,
    SSD,
    Contents,
    tag,
)

__all__ = ["write_ssp"]

_VERSION = "1.0"
# One name for the sets of all components: tools apply all sets of a name together.
_PARAMETER_SET = "initialValues"
# What the FMUs take where nobody gives a tolerance.
_SLAVE_TOLERANCE = 1e-8


@checked
def write_ssp(
    scenario: Scenario,
    file: Path | str,
    variant: str | None = None,
    *,
    derivatives: bool = False,
    step: float | None = None,
    native: bool = False,
) -> None:
    """Write one variant of a scenario as an SSP archive.

    The archive says what SSP 1.0 can say; the coupling, its step, the columns to record, metrics
    and figures are in an annotation, which other tools ignore.

    Parameters
    ----------
    scenario : Scenario
    file : Path
        Replaced if it exists.
    variant : str, optional
        The first one by default.
    derivatives : bool
        Whether to connect the outputs der(.) as well. Tools that hold their inputs then hold the
        derivatives with them, and the FMUs extrapolate: second order instead of first.
    step : float, optional
        Communication step for tools that have no other, in seconds; that of the experiment if it
        has one and no tolerance.
    native : bool
        Whether the archive takes the native twins of the FMUs: those of the same name in the
        folder ``native`` beside them.

    Raises
    ------
    InvalidInput
        Another ending than .ssp, no such variant, no such native FMU, or a connection from a
        variable that is no output, for which SSP has no connector.
    StoreError
        If the file cannot be written.

    Examples
    --------
    >>> scenario = cg.load_scenario("scenarios/scalar.toml")
    >>> cg.export_ssp(scenario, folder / "scalar.ssp", "Controller 2")
    """
    if step is not None and not 0.0 < step < math.inf:
        raise InvalidInput(f"step {step:g} is not valid; give a positive time in seconds")
    file = Path(file)
    if file.suffix != ".ssp":
        raise InvalidInput(f"{file}: the name of an SSP archive ends in .ssp")
    chosen = _variant(scenario, variant)
    for text in (scenario.title, *(component.name for component in scenario.system.components)):
        if not _XML_TEXT.fullmatch(text):
            raise InvalidInput(
                f"{scenario.place}: {text!a} has characters that XML, and so an SSP, cannot hold"
            )
    case = scenario.case(chosen.settings)
    resolved = (_native_twins(case.system) if native else case.system).resolve()
    contents = Contents()
    root = _root(scenario, file)
    system = _add(root, "ssd:System", name="system")
    ties = [*_ties(resolved), *(_derivative_ties(resolved) if derivatives else ())]
    connectors = _connectors(resolved, ties, case.experiment)
    elements = _add(system, "ssd:Elements")
    for place, member in enumerate(resolved.members):
        fmu = member.description.path
        source = contents.add(f"resources/{fmu.name}", fmu.read_bytes())
        component = _add(elements, "ssd:Component", name=member.name, source=source)
        component.set("implementation", "CoSimulation")
        _add_connectors(component, connectors[place])
        parameters = _parameter_set(member.start, contents)
        stem = re.sub(r"[^\w.-]", "_", member.name)  # some characters are none of a file's name
        bound = contents.add(f"resources/{stem}.ssv", parameters)
        _add(_add(component, "ssd:ParameterBindings"), "ssd:ParameterBinding", source=bound)
    _add_connections(system, resolved, ties)
    # The times; SSP has no place for the step.
    start, stop = repr(case.experiment.start_time), repr(case.experiment.stop_time)
    default = _add(root, "ssd:DefaultExperiment", startTime=start, stopTime=stop)
    if step is None and case.experiment.tolerance is None:
        step = case.experiment.step
    if step is not None:
        _annotate_step(system, default, step, case.experiment)
    # OMSimulator refuses annotations of the whole, so this one is the experiment's.
    beyond = etree.SubElement(_annotation(default, ANNOTATION), "Scenario")
    beyond.text = json.dumps(_beyond_ssp(scenario, chosen, case.experiment), indent=2)
    contents.add(SSD, _document(root))
    replace_whole(file, contents.write)


def _native_twins(system: System) -> System:
    """The system with the native twin of each FMU."""
    components = []
    for component in system.components:
        fmu = Path(component.fmu)
        twin = fmu if fmu.parent.name == "native" else fmu.parent / "native" / fmu.name
        if not twin.is_file():
            raise InvalidInput(
                f"component '{component.name}': no native FMU at {twin}; build it with: "
                "congelation build SPEC.toml --native"
            )
        components.append(replace(component, fmu=twin))
    return replace(system, components=tuple(components))


def _variant(scenario: Scenario, name: str | None) -> Variant:
    if name is None:
        return scenario.variants[0]
    for variant in scenario.variants:
        if variant.name == name:
            return variant
    names = [variant.name for variant in scenario.variants]
    raise InvalidInput(f"{scenario.place}: no variant '{name}'; {nearest(name, names)}")


def _root(scenario: Scenario, file: Path) -> etree._Element:
    root = etree.Element(tag(f"ssd:{DESCRIPTION}"), nsmap=NAMESPACES)
    root.set("version", _VERSION)
    root.set("name", file.stem)
    root.set("description", scenario.title)
    root.set("generationTool", f"congelation {version('congelation')}")
    return root


def _add(parent: etree._Element, element: str, **attributes: str) -> etree._Element:
    return etree.SubElement(parent, tag(element), attributes)


@dataclass(frozen=True)
class _Tie:
    """A connection of two variables, with the places of their components."""

    source: int
    output: Variable
    target: int
    input: Variable


def _ties(resolved: ResolvedSystem) -> Iterator[_Tie]:
    for link in (*resolved.links, *resolved.discrete_links):
        if link.output.causality != "output":
            raise InvalidInput(
                f"connection '{link.name}': '{link.output.name}' is of causality "
                f"{link.output.causality}; an SSP connects outputs to inputs"
            )
        yield _Tie(link.source, link.output, link.target, link.input)


def _derivative_ties(resolved: ResolvedSystem) -> Iterator[_Tie]:
    """From der(output) to der(input), for each order that both ends of a link have."""
    for link in resolved.links:
        for output, input_ in zip(link.source_derivatives, link.target_derivatives, strict=True):
            if output is not None and input_ is not None:
                yield _Tie(link.source, output, link.target, input_)


def _connectors(
    resolved: ResolvedSystem, ties: Iterable[_Tie], experiment: Experiment
) -> list[list[Variable]]:
    """By component: the variables with a connector, in the FMU's order.

    Those are the connected ones, and the outputs that the experiment records, for tools that show
    nothing but connectors.
    """
    wanted: list[set[str]] = [set() for _ in resolved.members]
    for tie in ties:
        wanted[tie.source].add(tie.output.name)
        wanted[tie.target].add(tie.input.name)
    for column in resolved.recorded(experiment.record):
        if column.variable.causality == "output":
            wanted[column.member].add(column.variable.name)
    return [
        [v for name, v in member.description.variables.items() if name in names]
        for member, names in zip(resolved.members, wanted, strict=True)
    ]


def _add_connectors(component: etree._Element, variables: Sequence[Variable]) -> None:
    if not variables:
        return
    connectors = _add(component, "ssd:Connectors")
    for variable in variables:
        connector = _add(connectors, "ssd:Connector", name=variable.name, kind=variable.causality)
        _add(connector, f"ssc:{variable.type}")


def _add_connections(
    system: etree._Element, resolved: ResolvedSystem, ties: Sequence[_Tie]
) -> None:
    if not ties:
        return
    connections = _add(system, "ssd:Connections")
    for tie in ties:
        _add(
            connections,
            "ssd:Connection",
            startElement=resolved.members[tie.source].name,
            startConnector=tie.output.name,
            endElement=resolved.members[tie.target].name,
            endConnector=tie.input.name,
        )


def _parameter_set(start: Iterable[StartValue], contents: Contents) -> bytes:
    root = etree.Element(
        tag("ssv:ParameterSet"), nsmap={"ssv": NAMESPACES["ssv"], "ssc": NAMESPACES["ssc"]}
    )
    root.set("version", _VERSION)
    root.set("name", _PARAMETER_SET)
    parameters = _add(root, "ssv:Parameters")
    for item in start:
        if item.value == "" == item.variable.default:
            continue  # OMSimulator complains of empty Strings, and this one says nothing
        parameter = _add(parameters, "ssv:Parameter", name=item.variable.name)
        value = _packed(item, contents)
        _add(parameter, f"ssv:{item.variable.type}", value=value)
    return _document(root)


def _packed(item: StartValue, contents: Contents) -> str:
    """A start value as text; the table of a profile goes into the archive."""
    value, name = item.value, item.variable.name
    if isinstance(value, str) and not _XML_TEXT.fullmatch(value):
        raise InvalidInput(
            f"start value '{name}' = {value!a} has characters that XML, and so an SSP, cannot hold"
        )
    if isinstance(value, str) and name.endswith(_TABLE) and value:
        table = Path(value)
        return contents.add(f"resources/{table.name}", table.read_bytes())
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isinf(value):
        return "INF" if value > 0.0 else "-INF"
    return str(value)


# The characters of XML 1.0, section 2.2.
_XML_TEXT = re.compile(r"[\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]*")
_TABLE = "table.file"
"""End of the names of parameters that name the table of a profile."""


def _annotate_step(
    system: etree._Element, default: etree._Element, size: float, experiment: Experiment
) -> None:
    """The step, where libcosim and OMSimulator look for it."""
    step = repr(size)
    libcosim = _annotation(default, "com.opensimulationplatform")
    _add(_add(libcosim, "osp:Algorithm"), "osp:FixedStepAlgorithm", baseStepSize=step)
    omsimulator = _add(_annotation(system, "org.openmodelica"), "oms:Annotations")
    tolerance = repr(experiment.slave_tolerance or _SLAVE_TOLERANCE)  # it hands it to the FMUs
    _add(
        _add(omsimulator, "oms:SimulationInformation"),
        "oms:FixedStepMaster",
        description="oms-ma",
        stepSize=step,
        absoluteTolerance=tolerance,
        relativeTolerance=tolerance,
    )


def _beyond_ssp(scenario: Scenario, variant: Variant, experiment: Experiment) -> dict[str, object]:
    """The tables of the scenario file that have no place in SSP 1.0."""
    alone = replace(scenario, experiment=experiment, variants=(Variant(variant.name),), sweep=None)
    said = alone.document()
    return {key: said[key] for key in ("title", "variants", "experiment", "metrics", "figures")}


def _annotation(parent: etree._Element, kind: str) -> etree._Element:
    """A new annotation of an element; they come last in it."""
    annotations = parent.find(tag("ssd:Annotations"))
    if annotations is None:
        annotations = _add(parent, "ssd:Annotations")
    return _add(annotations, "ssc:Annotation", type=kind)


def _document(root: etree._Element) -> bytes:
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text
