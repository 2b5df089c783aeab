"""A coupled loop as plain data: what every engine is given.

Engines run in processes of their own, some in environments without `congelation`, so this module
imports the standard library only.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

__all__ = ["Component", "Loop", "Variable", "variables"]


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU: value reference, type, causality, and start value if it has one."""

    reference: int
    type: str
    causality: str
    start: float | bool | str | None


@dataclass(frozen=True)
class Component:
    """An FMU in a loop.

    Parameters
    ----------
    name : str
    fmu : str
        Path of the file.
    start : dict
        Start values by the variable's name.
    """

    name: str
    fmu: str
    start: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Loop:
    """Two or more FMUs, connected.

    Parameters
    ----------
    name : str
    components : tuple of Component
    connections : tuple of (str, str, str, str)
        Source component and output, target component and input; all Real.
    record : tuple of (str, str)
        Component and variable; the columns of a trajectory.
    """

    name: str
    components: tuple[Component, ...]
    connections: tuple[tuple[str, str, str, str], ...]
    record: tuple[tuple[str, str], ...]

    def to_json(self) -> str:
        """As text, for `from_json`."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Loop:
        """What `to_json` wrote."""
        data = json.loads(text)
        return cls(
            data["name"],
            tuple(Component(**component) for component in data["components"]),
            tuple(tuple(connection) for connection in data["connections"]),
            tuple(tuple(column) for column in data["record"]),
        )

    def inputs(self, component: str) -> list[str]:
        """The connected inputs of a component."""
        return [name for _, _, target, name in self.connections if target == component]

    def outputs(self, component: str) -> list[str]:
        """The outputs of a component that are connected or recorded, without repetition."""
        connected = [name for source, name, _, _ in self.connections if source == component]
        recorded = [name for owner, name in self.record if owner == component]
        return list(dict.fromkeys([*connected, *recorded]))


def variables(fmu: str | Path) -> dict[str, Variable]:
    """The variables of an FMU by name, from its modelDescription.xml."""
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    found = {}
    for element in root.iter("ScalarVariable"):
        kind = next(child for child in element if child.tag != "Annotations")
        start = _value(kind.tag, kind.attrib.get("start"))
        reference = int(element.attrib["valueReference"])
        found[element.attrib["name"]] = Variable(
            reference, kind.tag, element.attrib.get("causality", "local"), start
        )
    return found


def _value(kind: str, text: str | None) -> float | bool | str | None:
    if text is None or kind == "String":
        return text
    return text in ("true", "1") if kind == "Boolean" else float(text)
