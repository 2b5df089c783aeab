"""What modelDescription.xml says, as plain data.

Reading is tolerant: whatever the rules judge (wrong combinations, missing starts, bad indices)
is carried along as written; only what cannot be represented at all raises `Unreadable`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

__all__ = [
    "BASE_TYPES",
    "Description",
    "Experiment",
    "Unknown",
    "Unreadable",
    "Value",
    "Variable",
    "default_initial",
    "read_description",
    "truth",
]

Value = float | int | bool | str

# Base types of the C interface; enumerations go through the Integer functions (section 2.2.7).
BASE_TYPES = ("Real", "Integer", "Boolean", "String")

_ELEMENTS = (*BASE_TYPES, "Enumeration")


class Unreadable(ValueError):
    """modelDescription.xml cannot be read as a model description at all."""


def truth(text: str) -> bool:
    """An xs:boolean literal."""
    return text.strip() in ("true", "1")


def default_initial(causality: str, variability: str) -> str:
    """The value of `initial` where none is given (table of section 2.2.7); "" for none."""
    if causality == "parameter" or variability == "constant":
        return "exact"
    if causality in ("input", "independent"):
        return ""
    return "calculated"


@dataclass(frozen=True)
class Variable:
    """One ScalarVariable, with the schema's defaults filled in.

    Attributes
    ----------
    index : int
        Position in ModelVariables, from 1.
    element : str
        "Real", "Integer", "Boolean", "String" or "Enumeration"; "" when there is none.
    given_initial : str or None
        `initial` as written; the attribute `initial` holds the effective value.
    attributes : Mapping[str, str]
        The attributes of the ScalarVariable and those of its type element.
    line : int or None
        Where it stands in modelDescription.xml, if the parser knows.
    still : bool
        Whether test runs leave it at its start value, because the FMU bears no other.
    """

    index: int
    name: str
    element: str
    reference: int
    causality: str
    variability: str
    given_initial: str | None
    attributes: Mapping[str, str]
    line: int | None = None
    still: bool = False

    @property
    def initial(self) -> str:
        """Effective `initial`: as given, or the default of the table."""
        return self.given_initial or default_initial(self.causality, self.variability)

    @property
    def base(self) -> str:
        """The base type whose get and set functions carry the variable."""
        return "Integer" if self.element == "Enumeration" else self.element

    @property
    def start_text(self) -> str | None:
        """The start attribute as written."""
        return self.attributes.get("start")

    @property
    def start(self) -> Value | None:
        """The start value, typed; None where there is none or it is no literal of its type."""
        text = self.start_text
        if text is None:
            return None
        try:
            return _typed(self.base, text)
        except ValueError:
            return None

    def bound(self, name: str) -> float | None:
        """`min` or `max` as a number, None where absent."""
        text = self.attributes.get(name)
        return None if text is None else float(text)

    @property
    def settable_before_start(self) -> bool:
        """Whether fmi2SetXXX is allowed in state "instantiated" (section 4.2.4, note 1)."""
        return self.variability != "constant" and self.initial in ("exact", "approx")

    @property
    def is_exact(self) -> bool:
        """Whether it is one of the Knowns of Initialization Mode besides the inputs."""
        return self.variability != "constant" and self.initial == "exact"


@dataclass(frozen=True)
class Unknown:
    """One Unknown of a list in ModelStructure; None stands for an attribute that is absent."""

    index: int
    dependencies: tuple[int, ...] | None
    kinds: tuple[str, ...] | None
    line: int | None = None


@dataclass(frozen=True)
class Experiment:
    """DefaultExperiment; None for what is not given."""

    start: float | None
    stop: float | None
    step: float | None
    tolerance: float | None


@dataclass(frozen=True)
class Description:
    """What the rules need to know of a modelDescription.xml."""

    model_name: str
    guid: str
    fmi_version: str
    naming: str
    identifiers: Mapping[str, str]
    flags: Mapping[str, str]
    exchange_flags: Mapping[str, str]
    indicators: int
    categories: tuple[str, ...]
    experiment: Experiment
    variables: tuple[Variable, ...]
    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]
    enumerations: Mapping[str, tuple[int, ...]]

    @property
    def identifier(self) -> str | None:
        """modelIdentifier for co-simulation, None where the FMU is not for it."""
        return self.identifiers.get("CoSimulation")

    def flag(self, name: str) -> bool:
        """A Boolean capability flag of the CoSimulation element; absent means false."""
        return truth(self.flags.get(name, "false"))

    def exchange_flag(self, name: str) -> bool:
        """The same of the ModelExchange element."""
        return truth(self.exchange_flags.get(name, "false"))

    @property
    def output_order(self) -> int:
        """maxOutputDerivativeOrder."""
        return int(self.flags.get("maxOutputDerivativeOrder", "0"))

    def variable(self, index: int) -> Variable | None:
        """The variable of a ModelStructure index (from 1), None outside the list."""
        return self.variables[index - 1] if 1 <= index <= len(self.variables) else None

    def at_rest(self) -> Description:
        """The same, with all inputs kept at their start values in test runs."""
        return replace(self, variables=tuple(replace(v, still=True) for v in self.variables))

    @cached_property
    def states(self) -> frozenset[int]:
        """Indices of the continuous-time states: what the listed Derivatives derive."""
        found = set()
        for unknown in self.derivatives:
            derivative = self.variable(unknown.index)
            target = derivative.attributes.get("derivative") if derivative else None
            if target is not None:
                found.add(int(target))
        return frozenset(found)

    @cached_property
    def state_vector(self) -> tuple[tuple[Variable, Variable], ...]:
        """The continuous-time states with their derivatives, in the order of the C functions."""
        found = []
        for unknown in self.derivatives:
            derivative = self.variable(unknown.index)
            target = derivative.attributes.get("derivative") if derivative else None
            state = None if target is None else self.variable(int(target))
            if derivative is not None and state is not None:
                found.append((state, derivative))
        return tuple(found)


def read_description(xml: bytes, parse: Any = ElementTree.fromstring) -> Description:
    """Read a modelDescription.xml.

    Parameters
    ----------
    parse : callable
        Makes an element tree of it; that of lxml knows line numbers.

    Raises
    ------
    Unreadable
        It is no XML, its root is another element, or a number in it is none.
    """
    try:
        root = parse(xml)
    except SyntaxError as error:  # the base of the parsers' errors
        raise Unreadable(f"modelDescription.xml is not well-formed: {error.msg}") from error
    if root.tag != "fmiModelDescription":
        raise Unreadable(f"the root element is <{root.tag}>, not <fmiModelDescription>")
    try:
        return _read(root)
    except ValueError as error:
        raise Unreadable(f"modelDescription.xml has a number that is none: {error}") from error


def _read(root: Any) -> Description:
    slave, exchange = root.find("CoSimulation"), root.find("ModelExchange")
    return Description(
        model_name=root.get("modelName", ""),
        guid=root.get("guid", ""),
        fmi_version=root.get("fmiVersion", ""),
        naming=root.get("variableNamingConvention", "flat"),
        identifiers={
            kind: element.get("modelIdentifier", "")
            for kind in ("CoSimulation", "ModelExchange")
            if (element := root.find(kind)) is not None
        },
        flags={} if slave is None else dict(slave.attrib),
        exchange_flags={} if exchange is None else dict(exchange.attrib),
        indicators=int(root.get("numberOfEventIndicators", "0")),
        categories=tuple(c.get("name", "") for c in root.iterfind("LogCategories/Category")),
        experiment=_experiment(root.find("DefaultExperiment")),
        variables=tuple(
            _variable(index, element)
            for index, element in enumerate(root.iterfind("ModelVariables/ScalarVariable"), 1)
        ),
        outputs=_unknowns(root, "Outputs"),
        derivatives=_unknowns(root, "Derivatives"),
        initial_unknowns=_unknowns(root, "InitialUnknowns"),
        enumerations={
            kind.get("name", ""): tuple(
                int(item.get("value", "")) for item in kind.iterfind("Enumeration/Item")
            )
            for kind in root.iterfind("TypeDefinitions/SimpleType")
            if kind.find("Enumeration") is not None
        },
    )


def _experiment(element: Any) -> Experiment:
    def number(name: str) -> float | None:
        text = None if element is None else element.get(name)
        return None if text is None else float(text)

    return Experiment(
        number("startTime"), number("stopTime"), number("stepSize"), number("tolerance")
    )


def _variable(index: int, element: Any) -> Variable:
    kind = next((child for child in element if child.tag in _ELEMENTS), None)
    return Variable(
        index=index,
        name=element.get("name", ""),
        element="" if kind is None else kind.tag,
        reference=int(element.get("valueReference", "")),
        causality=element.get("causality", "local"),
        variability=element.get("variability", "continuous"),
        given_initial=element.get("initial"),
        attributes={**element.attrib, **({} if kind is None else kind.attrib)},
        line=getattr(element, "sourceline", None),
    )


def _unknowns(root: Any, name: str) -> tuple[Unknown, ...]:
    def listed(element: Any, attribute: str) -> list[str] | None:
        text = element.get(attribute)
        return None if text is None else text.split()

    found = []
    for element in root.iterfind(f"ModelStructure/{name}/Unknown"):
        dependencies = listed(element, "dependencies")
        kinds = listed(element, "dependenciesKind")
        found.append(
            Unknown(
                index=int(element.get("index", "")),
                dependencies=None if dependencies is None else tuple(map(int, dependencies)),
                kinds=None if kinds is None else tuple(kinds),
                line=getattr(element, "sourceline", None),
            )
        )
    return tuple(found)


def _typed(base: str, text: str) -> Value:
    if base == "Real":
        return float(text)
    if base == "Integer":
        return int(text)
    if base == "Boolean":
        return truth(text)
    return text
