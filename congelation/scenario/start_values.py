"""Start values and theta(t) profiles of a component, as the scalar variables of its FMU."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import Description
from congelation.fmi.start import resolve_start
from congelation.signals import Profile, ProfileError, Slots
from congelation.toml import Section

__all__ = ["Scalar", "profile_values", "start_values"]

Scalar = float | int | bool | str

_TERM_SLOT = re.compile(r"(?P<kind>sine|square|chirp|telegraph)\[\d+\]\.amplitude")


def start_values(section: Section, description: Description) -> dict[str, Scalar]:
    """The start values of a table, one per scalar variable.

    Vectors and matrices may be given as arrays, and a value together with its unit,
    ``{value = 2.0, unit = "s"}``, which then has to be the one that the FMU declares.

    Raises
    ------
    InvalidInput
        An unknown variable, a value of the wrong type or shape, or another unit.
    """
    plain = {key: _without_unit(section, key, description) for key in section.data}
    place = f"{section.file}: {section.path}"
    return {s.variable.name: s.value for s in resolve_start(description, plain, place)}


def profile_values(section: Section, description: Description) -> dict[str, Scalar]:
    """The profiles theta[j](t) of a table, as the FMU's parameters ``profile[j].*``.

    Raises
    ------
    InvalidInput
        No such component of theta, a term that is not valid, or more terms than the FMU takes.
    """
    folder = str(Path(section.file).absolute().parent)
    values: dict[str, Scalar] = {}
    for key, spec in section.data.items():
        prefix = _profile_prefix(section, key, description)
        offered = [n.removeprefix(prefix) for n in description.variables if n.startswith(prefix)]
        try:
            profile = Profile.from_spec(spec, section.place(key), folder)
        except ProfileError as error:  # its text begins with the place
            raise InvalidInput(str(error)) from error
        flat = section.attempt(key, partial(profile.to_flat, _slots(offered)))
        values |= {prefix + name: value for name, value in flat.items()}
    return values


def _without_unit(section: Section, key: str, description: Description) -> object:
    """The value under `key`, after checking the unit if it states one."""
    if not isinstance(section.data[key], Mapping):
        return section.data[key]
    quantity = section.section(key).only(("value", "unit")).require("value", "unit")
    unit = quantity.text("unit")
    named = (v for n, v in description.variables.items() if n == key or n.startswith(f"{key}["))
    declared = {variable.unit or "1" for variable in named}
    if declared and declared != {unit}:
        units = " and ".join(f"'{u}'" for u in sorted(declared))
        raise quantity.error("unit", f"= '{unit}' is not the unit of '{key}'; give {units}")
    return quantity.data["value"]


def _profile_prefix(section: Section, key: str, description: Description) -> str:
    """What the FMU's names of the profile parameters of ``theta[j]`` begin with."""
    means = [n for n in description.variables if re.fullmatch(r"profile\[\d+\]\.mean", n)]
    components = {f"theta[{n[8 : n.index(']')]}]": n.removesuffix("mean") for n in means}
    if not components:
        raise section.error(key, f"has no place: {description.path.name} takes no profile")
    if key not in components:
        raise section.error(key, f"is no parameter with a profile; {nearest(key, components)}")
    return components[key]


def _slots(offered: Iterable[str]) -> Slots:
    """The room for terms that an FMU has, from the names of its profile parameters."""
    names = set(offered)
    matches = (_TERM_SLOT.fullmatch(name) for name in names)
    kinds = [match["kind"] for match in matches if match]
    return Slots(
        sines=kinds.count("sine"),
        squares=kinds.count("square"),
        chirps=kinds.count("chirp"),
        telegraphs=kinds.count("telegraph"),
        table="table.file" in names,
    )
