"""Settings: what start values, profiles and variants say, as scalar variables of the FMUs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

from congelation import keys
from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import Description, Variable
from congelation.fmi.start_values import resolve_start
from congelation.fmi.units import Conversion, conversion
from congelation.scenario.parts import EXPERIMENT, Experiment, Scalar, agreed
from congelation.signals import Profile, ProfileError, Slots, sizes_of_flat
from congelation.toml import Section, folders_of

__all__ = ["SettingsReader", "component_values", "in_own_unit", "profile_prefixes"]

_PROFILE_OF = re.compile(r"Profile of (?P<name>[^:]+): ")
_PROFILE_MEAN = re.compile(r"profile\[(\d+)\]\.mean")

# The keys of the experiment that no variant may change.
_FIXED = ("record", "options")


@dataclass(frozen=True)
class SettingsReader:
    """Reads tables of settings ``owner.key``; owners are the components and `experiment`.

    Parameters
    ----------
    descriptions : mapping
        The FMUs of the components, by name.
    starts : mapping
        The start values of the components before any setting, by name.
    driven : mapping
        Inputs ``component.variable`` that connections drive, and the connection of each.
    experiment : Experiment
        The one that settings change.
    """

    descriptions: Mapping[str, Description]
    starts: Mapping[str, Mapping[str, object]]
    driven: Mapping[str, str]
    experiment: Experiment

    def read(self, section: Section) -> dict[str, Scalar]:
        """The settings of a table, one entry for each scalar variable.

        Raises
        ------
        InvalidInput
            An unknown name, a value that does not fit, an experiment whose keys do not agree.
        """
        owners = _by_owner(section)
        known = (*self.descriptions, EXPERIMENT)
        flat: dict[str, Scalar] = {}
        for owner in owners.data:
            if owner not in known:
                raise section.error(owner, f"is no component; {nearest(owner, known)}")
            changed = owners.section(owner)
            if owner == EXPERIMENT:
                values = self._experiment(changed)
            else:
                values = component_values(
                    changed.without("profile"),
                    changed.section("profile"),
                    self.descriptions[owner],
                    self.starts[owner],
                )
                self.check_free(changed, owner, values)
            flat |= {f"{owner}.{key}": value for key, value in values.items()}
        return flat

    def check_free(self, section: Section, name: str, values: Iterable[str]) -> None:
        """Raise InvalidInput where a start value of component `name` is of a connected input."""
        for variable in values:
            if link := self.driven.get(f"{name}.{variable}"):
                # Couplings set the inputs der(v), der(v,2), .. of a connected input v with it.
                along = not link.endswith(f"-> {name}.{variable}")
                how = "sets it along with the value, to 0 where inputs are held" if along else ""
                raise section.within(
                    f"'{variable}' has no effect, as '{link}' {how or 'drives it'}; leave one of "
                    "them out"
                )

    def _experiment(self, section: Section) -> dict[str, Scalar]:
        """The experiment's settings in a table, as plain numbers and names."""
        section.only(key for key in keys.EXPERIMENT.names if key not in _FIXED)
        values = {key: section.value(keys.EXPERIMENT[key]) for key in section.data}
        base = replace(section, path=EXPERIMENT)
        agreed(
            {f.name: getattr(self.experiment, f.name) for f in fields(self.experiment)} | values,
            lambda key: (section if key in section.data else base).place(key),
        )
        return values


def component_values(
    start: Section,
    profile: Section,
    description: Description,
    before: Mapping[str, object] | None = None,
) -> dict[str, Scalar]:
    """The start values and the profile of a component, one entry for each scalar variable.

    `before` are those that hold where the tables say nothing else.

    Raises
    ------
    InvalidInput
        An unknown variable, a value of the wrong type or shape, a variable given twice.
    """
    values = _start_values(start, description)
    terms = _profile_values(profile, description, before or {})
    for twice in sorted(values.keys() & terms.keys()):
        raise start.error(twice, "is given by the profile as well; leave one of them out")
    given = values | terms
    for name in description.variables:
        if _PROFILE_MEAN.fullmatch(name):
            prefix = name.removesuffix("mean")
            if any(key.startswith(prefix) for key in given):
                _check_profile(start, prefix, {**(before or {}), **given})
    return given


def profile_prefixes(description: Description) -> dict[str, str]:
    """What the names of the FMU's profile parameters begin with, ``profile[1].``, by the component
    of theta or signal that scenarios name.

    The description of a profile's mean says what the profile is of.
    """
    prefixes = {}
    for name, variable in description.variables.items():
        if match := _PROFILE_MEAN.fullmatch(name):
            of = _PROFILE_OF.match(variable.description)
            prefixes[of["name"] if of else f"theta[{match[1]}]"] = name.removesuffix("mean")
    return prefixes


def _check_profile(section: Section, prefix: str, values: Mapping[str, object]) -> None:
    """Raise InvalidInput where the numbers of a profile, taken together, make none."""
    numbers = {
        key.removeprefix(prefix): value
        for key, value in values.items()
        if key.startswith(prefix) and not key.startswith(f"{prefix}table.")
    }
    try:
        Profile.from_flat(numbers)
    except ProfileError as error:
        raise section.within(f"{prefix}{error}") from error


def _start_values(section: Section, description: Description) -> dict[str, Scalar]:
    """The start values of a table, one per scalar variable.

    Vectors and matrices may be given as arrays, and a value together with its unit,
    ``{value = 2.0, unit = "s"}``, which then has to be the one that the FMU declares.

    Raises
    ------
    InvalidInput
        An unknown variable, a value of the wrong type or shape, or another unit.
    """
    plain = {
        key: in_own_unit(section, key, _named(description, key), description)
        for key in section.data
    }
    found = resolve_start(description, plain, section.place(""))
    return {s.variable.name: s.value for s in found}


def _profile_values(
    section: Section, description: Description, before: Mapping[str, object]
) -> dict[str, Scalar]:
    """The profiles theta[j](t) of a table, as the FMU's parameters ``profile[j].*``.

    A key is a component of theta, ``theta[1]``, with all its terms, or one number of a term:
    ``theta[1].sine[2].omega``. Where there is one sine, ``theta[1].sine.omega`` is of it.

    Raises
    ------
    InvalidInput
        No such component of theta, a term that is not valid, or more terms than the FMU takes.
    """
    folders = folders_of(section.file)
    values: dict[str, Scalar] = {}
    for key, spec in section.data.items():
        component, prefix = _profile_prefix(section, key, description)
        offered = [n.removeprefix(prefix) for n in description.variables if n.startswith(prefix)]
        sizes = sizes_of_flat(offered)
        if key == component:
            profile = _profile(section, key, folders)
            flat = section.attempt(key, partial(profile.to_flat, Slots.of(sizes.values())))
            found = {prefix + name: value for name, value in flat.items()}
        else:
            terms = [name.partition(".")[0] for name in sizes if before.get(prefix + name)]
            variable = prefix + _term_parameter(section, key, component, offered, terms)
            at = {variable: section.at(key)}
            named = replace(section, path=section.at(key), data={variable: spec}, elsewhere=at)
            found = _start_values(named, description)
        for twice in sorted(values.keys() & found.keys()):
            raise section.error(key, f"gives '{twice}' a second time; leave one of them out")
        values |= found
    return values


def _profile(section: Section, key: str, folders: Sequence[Path]) -> Profile:
    """The profile under `key`, its tables in the first of some folders that has them."""
    spec, place = section.data[key], section.place(key)
    for folder in folders[:-1]:
        with suppress(ValueError):  # the last one says what is wrong
            return Profile.from_spec(spec, place, str(folder))
    try:
        return Profile.from_spec(spec, place, str(folders[-1]))
    except ProfileError as error:  # its text begins with the place
        raise InvalidInput(str(error)) from error
    except ValueError as error:  # a zero in the name of a file
        raise section.error(key, f"cannot be read: {error}") from error


def _named(description: Description, name: str) -> list[Variable]:
    """The variables that the name of a scalar, vector or matrix stands for."""
    return [v for n, v in description.variables.items() if n == name or n.startswith(f"{name}[")]


def in_own_unit(
    section: Section, key: str, named: Iterable[Variable], description: Description
) -> object:
    """The value under `key`, in the unit of the variables that it is of if it states its own.

    Parameters
    ----------
    section : Section
    key : str
    named : iterable of Variable
    description : Description
        Of their FMU.

    Raises
    ------
    InvalidInput
        A unit that measures something else, or that cannot be compared.
    """
    given = section.data[key]
    if isinstance(given, list) and any(isinstance(element, Mapping) for element in given):
        one = f'"{key}[1]" = {{value = .., unit = ".."}}'
        raise section.error(
            key,
            f"has an element with a unit of its own; give each element by name, {one}, or one unit "
            f'for all, {key} = {{value = [..], unit = ".."}}',
        )
    if not isinstance(given, Mapping):
        return given
    quantity = section.section(key).only(("value", "unit")).require("value", "unit")
    unit = quantity.as_kind("unit", "text")
    named = list(named)
    declared = sorted({variable.unit or "1" for variable in named})
    if not declared or declared == [unit]:
        return quantity.data["value"]
    units = " and ".join(f"'{name}'" for name in declared)
    if len(declared) > 1:
        raise quantity.error("unit", f"= '{unit}' is not the unit of '{key}'; give {units}")
    own, relative = description.unit(declared[0]), any(variable.relative for variable in named)
    try:
        found = conversion(description.unit(unit), own, relative=relative)
    except InvalidInput as error:
        text = f"= '{unit}' is not the unit of '{key}': {error}; give one such as {units}"
        raise quantity.error("unit", text) from None
    if found.doubt:
        raise quantity.error("unit", f"= '{unit}' is not the unit of '{key}'; give {units}")
    return _converted(quantity, found)


def _converted(quantity: Section, to: Conversion) -> object:
    """The value of a quantity, a number or rows of numbers, converted."""

    def convert(value: object) -> object:
        if isinstance(value, list):
            return [convert(entry) for entry in value]
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise quantity.wrong("value", "a number, or an array of numbers, as it has a unit")
        try:
            return to.factor * value + to.offset
        except OverflowError:
            raise quantity.wrong("value", "a number that a float can hold") from None

    return convert(quantity.data["value"])


def _profile_prefix(section: Section, key: str, description: Description) -> tuple[str, str]:
    """The component of theta, or the signal, that a key is of, and what the names of its
    profile parameters begin with.
    """
    components = profile_prefixes(description)
    if not components:
        raise section.error(key, f"has no place: {description.path.name} takes no profile")
    for component, prefix in components.items():
        if key == component or key.startswith(f"{component}."):
            return component, prefix
    raise section.error(key, f"is no parameter with a profile; {nearest(key, components)}")


def _term_parameter(
    section: Section, key: str, component: str, offered: Iterable[str], terms: Iterable[str]
) -> str:
    """The profile parameter, such as ``sine[1].omega``, that ``theta[1].sine.omega`` means.

    `terms` are those that the profile has, such as ``sine[1]``.
    """
    asked = key.removeprefix(f"{component}.")
    kind, _, rest = asked.partition(".")
    names = [*offered]
    for name in ("mean" if asked == "constant" else asked, f"{kind}[1].{rest}"):
        if name in names:
            alike = [f"{term}.{rest}" for term in terms if term.startswith(f"{kind}[")]
            if name != asked and len(alike) > 1:
                raise section.error(key, f"is one of {len(alike)}; give {' or '.join(alike)}")
            return name
    known = ["constant", *names, *(name.replace("[1].", ".") for name in names)]
    raise section.error(key, f"is no part of this profile; {nearest(asked, known)}")


def _by_owner(section: Section) -> Section:
    """`section` with its keys ``owner.key`` and ``owner.profile.theta[j]..`` as nested tables."""
    grouped: dict[str, dict[str, object]] = {}
    profiles: dict[str, dict[str, object]] = {}
    for name, value in section.data.items():
        owner, dot, key = name.partition(".")
        settings = {key: value} if dot else value
        if not isinstance(settings, Mapping):
            raise section.error(name, "is no setting; write it as 'component.variable'")
        for inner, setting in settings.items():
            of = profiles if inner.startswith("profile.") else grouped
            table = of.setdefault(owner, {})
            if inner.removeprefix("profile.") in table:
                raise section.error(f"{owner}.{inner}", "is given twice; leave one of them out")
            table[inner.removeprefix("profile.")] = setting
    for owner, profile in profiles.items():
        if "profile" in grouped.setdefault(owner, {}):
            raise section.error(f"{owner}.profile", "is given twice; leave one of them out")
        grouped[owner]["profile"] = profile
    return replace(section, data=grouped)
