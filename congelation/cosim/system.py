"""A coupled system: components, start values and connections, by name.

Describing loads no binary: every name, type and causality is checked against the model
descriptions alone, so a mistake is found before anything runs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from congelation.arguments import check_fields
from congelation.errors import InvalidInput, counted, nearest
from congelation.fmi.description import Description, Variable, describe
from congelation.fmi.start_values import StartValue, resolve_start
from congelation.fmi.units import Conversion, conversion

__all__ = [
    "MAX_DERIVATIVE",
    "Component",
    "Connection",
    "Link",
    "Member",
    "Recorded",
    "ResolvedSystem",
    "System",
]

MAX_DERIVATIVE = 3
"""Highest derivative that an input takes: cubic polynomials."""


@dataclass(frozen=True)
class Component:
    """One FMU in a system.

    Parameters
    ----------
    name : str
        Name in the system; no dots or blanks.
    fmu : Path
        The .fmu file.
    start : mapping of str to object
        Start values: numbers, booleans and strings for scalar variables, nested lists or arrays
        for vectors and matrices (``x0 = [2, -1]`` sets x0[1] and x0[2]).

    Examples
    --------
    >>> cg.Component("plant", "fmus/ScalarPlant.fmu", {"x0": [2.0]}).name
    'plant'
    """

    name: str
    fmu: Path
    start: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Connection:
    """An output that drives an input, each written "component.variable".

    A vector's name stands for all of its elements: "plant.x" to "controller.x" connects x[1] to
    x[1], and so on.

    Examples
    --------
    >>> str(cg.Connection("plant.x", "controller.x"))
    'plant.x -> controller.x'
    """

    source: str
    target: str

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def parse(cls, text: str) -> Connection:
        """Read ``"plant.x -> controller.x"``."""
        parts = [part.strip() for part in text.split("->")]
        if len(parts) != 2 or not all(parts):
            raise InvalidInput(f"connection '{text}': write it as 'plant.x -> controller.x'")
        return cls(*parts)

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class Member:
    """A component with its description read and its start values checked."""

    name: str
    description: Description
    start: tuple[StartValue, ...]


@dataclass(frozen=True)
class Link:
    """One scalar connection between members, given by their places in the system.

    Parameters
    ----------
    source_derivatives, target_derivatives : tuple of (Variable or None), length MAX_DERIVATIVE
        The outputs der(source), der(source,2), .. and the inputs der(target), .. of order 1, 2, 3
        that exist.
    factor, offset : float
        The input is ``factor * output + offset`` where their units differ; of derivatives, the
        factor alone.
    doubt : str
        What is doubtful about their units, empty if nothing is.
    """

    source: int
    output: Variable
    target: int
    input: Variable
    name: str
    source_derivatives: tuple[Variable | None, ...]
    target_derivatives: tuple[Variable | None, ...]
    factor: float = 1.0
    offset: float = 0.0
    doubt: str = ""

    @property
    def converts(self) -> bool:
        """Whether the units of the two ends differ."""
        return (self.factor, self.offset) != (1.0, 0.0)


@dataclass(frozen=True)
class Recorded:
    """A variable to record: its member's place, and the column's name."""

    member: int
    variable: Variable
    name: str


@dataclass(frozen=True)
class ResolvedSystem:
    """A system whose every name has been found.

    Parameters
    ----------
    links : tuple of Link
        Connections from Real outputs that follow the time.
    discrete_links : tuple of Link
        Connections from Integer, Boolean and String outputs, and from Real ones that are constant
        between events (variability "discrete"); they are copied at communication points, whatever
        the coupling.
    """

    members: tuple[Member, ...]
    links: tuple[Link, ...]
    discrete_links: tuple[Link, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the members."""
        return tuple(member.name for member in self.members)

    def interpolates(self, link: Link) -> bool:
        """Whether derivatives reach the target by fmi2SetRealInputDerivatives, rather than by
        inputs der(v), der(v,2), der(v,3) of its own."""
        able = self.members[link.target].description.can_interpolate_inputs
        return able and link.target_derivatives[0] is None and not link.input.is_held

    def input_order(self, link: Link) -> int:
        """Highest derivative that a link's target takes, all lower ones included."""
        if self.interpolates(link):
            return MAX_DERIVATIVE
        return next((k for k, v in enumerate(link.target_derivatives) if v is None), MAX_DERIVATIVE)

    def knows_derivative(self, link: Link) -> bool:
        """Whether a link's source provides the first derivative of its output, by an output of
        its own or by fmi2GetRealOutputDerivatives."""
        able = self.members[link.source].description.max_output_derivative_order > 0
        return link.source_derivatives[0] is not None or (
            able and link.output.causality == "output"
        )

    def recorded(self, names: Sequence[str] | None) -> tuple[Recorded, ...]:
        """The variables to record; with None, every number among the outputs.

        Raises
        ------
        InvalidInput
            A name that does not exist, or a String.
        """
        if names is None:
            return tuple(
                Recorded(place, variable, f"{member.name}.{variable.name}")
                for place, member in enumerate(self.members)
                for variable in member.description.variables.values()
                if variable.causality == "output"
                and variable.type != "String"
                and not variable.name.startswith("der(")
                and variable.name != "next_event"
            )
        found = self.columns(names, "record")
        for column in found:
            if column.variable.type == "String":
                raise InvalidInput(f"record '{column.name}': a String cannot be recorded")
        return found

    def columns(self, names: Sequence[str], key: str) -> tuple[Recorded, ...]:
        """The scalar variables that names under a `key` stand for.

        Raises
        ------
        InvalidInput
            A name that does not exist.
        """
        found: dict[str, Recorded] = {}
        for name in names:
            what = f"{key} '{name}'"
            place, local = _split(name, [m.name for m in self.members], what)
            for variable in _elements(self.members[place].description, local, what):
                column = f"{self.members[place].name}.{variable.name}"
                found[column] = Recorded(place, variable, column)
        return tuple(found.values())


@dataclass(frozen=True)
class System:
    """Components and the connections between them.

    Parameters
    ----------
    components : tuple of Component
    connections : tuple of Connection
        Or texts such as ``"plant.x -> controller.x"``.

    Examples
    --------
    >>> system = cg.System(
    ...     components=(
    ...         cg.Component("plant", "fmus/ScalarPlant.fmu"),
    ...         cg.Component("controller", "fmus/ScalarController.fmu"),
    ...     ),
    ...     connections=(
    ...         cg.Connection("plant.x", "controller.x"),
    ...         cg.Connection("controller.u", "plant.u"),
    ...     ),
    ... )
    >>> cg.simulate(system, stop_time=1.0, step=0.01).status.name
    'COMPLETED'
    """

    components: tuple[Component, ...]
    connections: tuple[Connection, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.connections, list | tuple):  # each of which may be a text
            parsed = (Connection.parse(c) if isinstance(c, str) else c for c in self.connections)
            object.__setattr__(self, "connections", tuple(parsed))
        check_fields(self)

    def resolve(self, *, held: bool = False) -> ResolvedSystem:
        """Find every name.

        Parameters
        ----------
        held : bool
            Whether inputs are held between communication points, so that no derivatives follow
            from a connection: those that are connected explicitly then count.

        Raises
        ------
        InvalidInput
            A missing FMU, an unknown name (the nearest valid one is named), a connection of the
            wrong causality or type, an input driven twice, a start value that does not fit.
        """
        names = [component.name for component in self.components]
        _check_names(names)
        members = tuple(_member(component) for component in self.components)
        once = [m for m in members if m.description.once_per_process]
        for member in once:
            if sum(m.description.sha256 == member.description.sha256 for m in once) > 1:
                raise InvalidInput(
                    f"component '{member.name}': {member.description.path.name} "
                    "can be instantiated only once per process"
                )
        # The runs of a study have connections in common, whose names are found once.
        key = (
            tuple((m.name, m.description.sha256) for m in members),
            tuple(self.connections),
            held,
        )
        if key not in _LINKS:
            links = [
                link
                for connection in self.connections
                for link in _links(connection, members, names)
            ]
            links = list(links) if held else _without_implied(links)
            _check_single_source(links, held)
            while len(_LINKS) >= KEPT_SYSTEMS:
                _LINKS.pop(next(iter(_LINKS)))
            _LINKS[key] = (
                tuple(link for link in links if not link.output.is_held),
                tuple(link for link in links if link.output.is_held),
            )
        return ResolvedSystem(members, *_LINKS[key])


KEPT_SYSTEMS = 64
"""Whose links are kept."""

_LINKS: dict[object, tuple[tuple[Link, ...], tuple[Link, ...]]] = {}


def _check_names(names: Sequence[str]) -> None:
    if not names:
        raise InvalidInput("a system needs at least one component")
    for name in names:
        if not name or re.search(r"[.\s]", name):
            raise InvalidInput(f"component '{name}': a name without dots and blanks is needed")
        if names.count(name) > 1:
            raise InvalidInput(f"component '{name}' is given twice; names must differ")


def _member(component: Component) -> Member:
    place = f"component '{component.name}'"
    try:
        description = describe(component.fmu)
    except InvalidInput as error:
        raise InvalidInput(f"{place}: {error}") from error
    return Member(component.name, description, resolve_start(description, component.start, place))


def _split(name: str, components: Sequence[str], place: str) -> tuple[int, str]:
    """The component's place and the variable's name in "component.variable"."""
    component, dot, variable = name.partition(".")
    if not dot or not variable:
        raise InvalidInput(f"{place}: write it as 'component.variable'")
    if component not in components:
        raise InvalidInput(f"{place}: no component '{component}'; {nearest(component, components)}")
    return components.index(component), variable


def _elements(description: Description, name: str, place: str) -> tuple[Variable, ...]:
    """The scalar variables that `name` stands for: itself, or all elements of a vector."""
    if name in description.variables:
        return (description.variables[name],)
    elements = tuple(
        variable
        for other, variable in description.variables.items()
        if other.startswith(f"{name}[") and other.endswith("]") and "]" not in other[len(name) : -1]
    )
    return elements or (description.variable(name, place),)


def _links(
    connection: Connection, members: Sequence[Member], names: Sequence[str]
) -> Iterable[Link]:
    place = f"connection '{connection}'"
    source, output_name = _split(connection.source, names, place)
    target, input_name = _split(connection.target, names, place)
    outputs = _elements(members[source].description, output_name, place)
    inputs = _elements(members[target].description, input_name, place)
    for output, input_ in _pairs(outputs, output_name, inputs, input_name, place):
        _check_pair(output, input_, place)
        converted = _conversion(members[source], output, members[target], input_, place)
        yield Link(
            source,
            output,
            target,
            input_,
            f"{names[source]}.{output.name} -> {names[target]}.{input_.name}",
            _derivatives(members[source].description, output, "output"),
            _derivatives(members[target].description, input_, "input"),
            converted.factor,
            converted.offset,
            converted.doubt
            or _misfit(members[source].description, output, 1)
            or _misfit(members[target].description, input_, MAX_DERIVATIVE),
        )


def _pairs(
    outputs: Sequence[Variable],
    output_name: str,
    inputs: Sequence[Variable],
    input_name: str,
    place: str,
) -> Iterable[tuple[Variable, Variable]]:
    """Match the elements of two vectors by their indices."""
    if len(outputs) == len(inputs) == 1:
        return [(outputs[0], inputs[0])]
    by_index = {variable.name[len(input_name) :]: variable for variable in inputs}
    if sorted(by_index) != sorted(variable.name[len(output_name) :] for variable in outputs):
        given, wanted = counted(len(outputs), "output"), counted(len(inputs), "input")
        remedy = "the indices must agree"
        if input_name == "yr":
            remedy += "; a law of order n takes the reference and its derivatives up to the n-th: "
            remedy += "build a reference of that n (docs/theory.md, 'Tracking')"
        raise InvalidInput(f"{place}: {given} for {wanted}; {remedy}")
    return [(variable, by_index[variable.name[len(output_name) :]]) for variable in outputs]


def _check_pair(output: Variable, input_: Variable, place: str) -> None:
    if output.causality not in ("output", "local"):
        raise InvalidInput(
            f"{place}: '{output.name}' is of causality {output.causality}; "
            "the source must be an output"
        )
    if input_.causality != "input":
        raise InvalidInput(
            f"{place}: '{input_.name}' is of causality {input_.causality}; "
            "the target must be an input"
        )
    if output.type != input_.type:
        raise InvalidInput(
            f"{place}: '{output.name}' is {output.type} and '{input_.name}' is "
            f"{input_.type}; the types must agree"
        )
    if output.items and input_.items and {*output.items} != {*input_.items}:
        raise InvalidInput(
            f"{place}: '{output.name}' and '{input_.name}' are enumerations of different items: "
            f"{_items(output)} and {_items(input_)}"
        )


def _items(variable: Variable) -> str:
    return ", ".join(f"'{name}' ({value})" for name, value in variable.items)


def _conversion(
    source: Member, output: Variable, target: Member, input_: Variable, place: str
) -> Conversion:
    """How values of the output become values of the input; only Reals have units."""
    if output.type != "Real":
        if input_.items and not output.items:
            return Conversion(
                doubt=f"'{output.name}' is an Integer, which may be no item of the enumeration "
                f"'{input_.name}'"
            )
        return Conversion()
    units = source.description.unit(output.unit), target.description.unit(input_.unit)
    try:
        return conversion(*units, relative=output.relative or input_.relative)
    except InvalidInput as error:
        raise InvalidInput(f"{place}: {error}") from error


def _derivatives(
    description: Description, variable: Variable, causality: str
) -> tuple[Variable | None, ...]:
    orders = range(1, MAX_DERIVATIVE + 1)
    return tuple(description.derivative(variable, causality, order) for order in orders)


def _misfit(description: Description, variable: Variable, most: int) -> str:
    """Which of the derivatives up to an order is in a wrong unit; empty if none is."""
    told = (description.misfit(variable, order) for order in range(1, most + 1))
    return next(filter(None, told), "")


def _without_implied(links: Sequence[Link]) -> list[Link]:
    """Leave out connections of derivatives that follow from those of the values anyway."""
    implied = {
        (link.source, output, link.target, input_)
        for link in links
        for output, input_ in zip(link.source_derivatives, link.target_derivatives, strict=True)
        if output is not None and input_ is not None
    }
    return [
        link for link in links if (link.source, link.output, link.target, link.input) not in implied
    ]


def _check_single_source(links: Sequence[Link], held: bool) -> None:
    seen: dict[tuple[int, str], Link] = {}
    for link in links:
        key = (link.target, link.input.name)
        if key in seen:
            raise InvalidInput(
                f"connection '{link.name}': the input is driven already by "
                f"'{seen[key].name}'; an input takes one source"
            )
        seen[key] = link
    for link in () if held else links:
        for variable in link.target_derivatives:
            if variable is not None and (link.target, variable.name) in seen:
                other = seen[link.target, variable.name]
                raise InvalidInput(
                    f"connection '{other.name}': the coupling drives this input "
                    f"along with '{link.name}'; leave the connection out"
                )
