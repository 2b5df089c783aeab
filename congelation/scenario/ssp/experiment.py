"""How an SSP archive is run: what it states, and what is taken where it states nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path

from lxml import etree

from congelation.fmi.description import describe
from congelation.scenario.parts import replaced
from congelation.scenario.ssp.archive import ANNOTATION, NAMESPACES, SSD, Archive

__all__ = ["annotated_tables", "experiment_table"]

# How an archive is run that does not say so, as those of other tools: to a tolerance if all its
# FMUs can take a step back, otherwise with held inputs in so many steps. The tolerance is the
# larger one where an input can only be held: the number of steps then grows with its root, to
# tens in a second for a slow linear system.
_TOLERANCE = 1e-6
_TOLERANCE_OF_HELD_INPUTS = 1e-4
_STEPS = 1000


def annotated_tables(root: etree._Element, archive: Archive) -> dict[str, object]:
    """What an archive of congelation says beyond SSP 1.0; nothing for others."""
    path = f"ssd:DefaultExperiment/ssd:Annotations/ssc:Annotation[@type='{ANNOTATION}']/*"
    element = root.find(path, NAMESPACES)
    if element is None:
        return {}
    try:
        tables = json.loads(element.text or "", object_pairs_hook=_without_twins)
    # Besides errors of JSON, those of a number of thousands of digits and of deep nesting.
    except (ValueError, RecursionError) as error:
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': no JSON: {error}") from error
    if not isinstance(tables, dict):
        raise archive.error(f"{SSD}: annotation '{ANNOTATION}': give a JSON object")
    for key in ("components", "connections", "open"):
        if key in tables:
            raise archive.error(
                f"{SSD}: annotation '{ANNOTATION}': {key} are those of the archive; leave them out"
            )
    return tables


def _without_twins(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """A JSON object, none of whose keys is given twice: the last one would count in silence."""
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"'{twice}' is given twice")
    return table


def experiment_table(
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
