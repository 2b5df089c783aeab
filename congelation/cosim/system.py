"""A coupled system: components, start values and connections, by name.

Describing loads no binary: every name, type and causality is checked against the model
descriptions alone, so a mistake is found before anything runs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from congelation.arguments import check_fields
from congelation.cosim.links import (
    MAX_DERIVATIVE,
    Connection,
    Link,
    Member,
    elements_of,
    links_of,
    split_name,
)
from congelation.errors import InvalidInput
from congelation.fmi.description import Variable, describe
from congelation.fmi.start_values import resolve_start

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
            place, local = split_name(name, [m.name for m in self.members], what)
            for variable in elements_of(self.members[place].description, local, what):
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
            links = links_of(self.connections, members, held=held)
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
        if not name.isprintable() or not name or re.search(r"[.\s]", name):
            raise InvalidInput(f"component {name!r}: a name without dots and blanks is needed")
        if names.count(name) > 1:
            raise InvalidInput(f"component '{name}' is given twice; names must differ")


def _member(component: Component) -> Member:
    place = f"component '{component.name}'"
    try:
        description = describe(component.fmu)
    except InvalidInput as error:
        raise InvalidInput(f"{place}: {error}") from error
    return Member(component.name, description, resolve_start(description, component.start, place))
