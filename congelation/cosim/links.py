"""Connections between FMUs as users write them, and as links, pairs of scalar variables."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from congelation.arguments import check_fields
from congelation.errors import InvalidInput, counted, nearest
from congelation.fmi.description import EVENT, Description, Variable
from congelation.fmi.start_values import StartValue
from congelation.fmi.units import Conversion, conversion

__all__ = [
    "MAX_DERIVATIVE",
    "Connection",
    "Link",
    "Member",
    "elements_of",
    "links_of",
    "split_name",
]

MAX_DERIVATIVE = 3
"""Highest derivative that an input takes: cubic polynomials."""

MOST_ENDS = 12
"""Inputs or outputs that a message lists."""


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


def links_of(
    connections: Iterable[Connection], members: Sequence[Member], *, held: bool
) -> list[Link]:
    """The links that connections stand for, one per pair of scalar variables.

    Parameters
    ----------
    connections : iterable of Connection
    members : sequence of Member
    held : bool
        Whether inputs are held; see `congelation.cosim.system.System.resolve`.

    Raises
    ------
    InvalidInput
        An unknown name, a connection of the wrong causality, type or unit, an input driven twice.
    """
    names = [member.name for member in members]
    links = [link for c in connections for link in _links(c, members, names)]
    if not held:
        links = _without_implied(links)
    _check_single_source(links, held)
    return links


def split_name(name: str, components: Sequence[str], place: str) -> tuple[int, str]:
    """The component's place and the variable's name in "component.variable"."""
    component, dot, variable = name.partition(".")
    if not dot or not variable:
        raise InvalidInput(f"{place}: write it as 'component.variable'")
    if component not in components:
        raise InvalidInput(f"{place}: no component '{component}'; {nearest(component, components)}")
    return components.index(component), variable


def elements_of(description: Description, name: str, place: str) -> tuple[Variable, ...]:
    """The scalar variables that `name` stands for: itself, or all elements of a vector."""
    if name in description.variables:
        return (description.variables[name],)
    elements = tuple(
        variable
        for other, variable in description.variables.items()
        if other.startswith(f"{name}[") and other.endswith("]") and "]" not in other[len(name) : -1]
    )
    return elements or (description.variable(name, place),)


def _end(description: Description, name: str, causality: str, place: str) -> tuple[Variable, ...]:
    """As `elements_of` of an end of a connection; where no name is near, those of this causality
    are listed, vectors by their names alone."""
    try:
        return elements_of(description, name, place)
    except InvalidInput:
        bare = (
            other.partition("[")[0]
            for other, variable in description.variables.items()
            if variable.causality == causality
            and other not in description.open_inputs
            and not other.startswith(("der(", EVENT))
        )
        ends = list(dict.fromkeys(bare))
        near = difflib.get_close_matches(name, description.variables, n=1, cutoff=0.4)
        if near or not 0 < len(ends) <= MOST_ENDS:
            raise
        raise InvalidInput(
            f"{place}: {description.path.name} has no variable '{name}'; its {causality}s are: "
            + ", ".join(ends)
        ) from None


def _links(
    connection: Connection, members: Sequence[Member], names: Sequence[str]
) -> Iterable[Link]:
    place = f"connection '{connection}'"
    source, output_name = split_name(connection.source, names, place)
    target, input_name = split_name(connection.target, names, place)
    outputs = _end(members[source].description, output_name, "output", place)
    inputs = _end(members[target].description, input_name, "input", place)
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
    misfits = (description.misfit(variable, order) for order in range(1, most + 1))
    return next(filter(None, misfits), "")


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
