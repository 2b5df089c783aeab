"""The table ``[sweep]`` of a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from congelation import keys
from congelation.errors import counted, nearest
from congelation.scenario.axes import DISTRIBUTIONS, RandomAxis, Replicates, Sweep
from congelation.scenario.constraint import Constraint
from congelation.scenario.parts import EXPERIMENT, Settings
from congelation.scenario.settings import SettingsReader
from congelation.toml import Section

__all__ = ["read_sweep"]


def read_sweep(section: Section, reader: SettingsReader, variants: Mapping[str, Settings]) -> Sweep:
    """The sweep that a table describes, of a scenario with some variants and what they set.

    Raises
    ------
    InvalidInput
        Naming the key and what would be valid.
    """
    read = section.read(keys.SWEEP)
    lists: list[tuple[tuple[Settings, ...], tuple[str, ...]]] = []
    axes: list[tuple[RandomAxis, tuple[str, ...]]] = []
    taken: dict[str, dict[str, str]] = {}  # of a setting: the axis that sets it, by variant
    spelled: dict[str, str] = {}
    for axis in read["axes"]:
        found = _axis(axis, reader)
        only = _variants(axis, list(variants))
        names = [found.name] if isinstance(found, RandomAxis) else list(found[0])
        place = axis.spelled(axis.path)
        for name in names:
            for variant in only or variants:
                other = taken.setdefault(name, {}).setdefault(variant, place)
                if other != place:
                    raise axis.error("set", f"sets '{name}', which {other} sets already")
                if name in variants[variant]:
                    raise axis.error(
                        "set",
                        f"sets '{name}', which the variant '{variant}' sets already; leave it out "
                        "there, or name the variants that the axis is of: variants = [..]",
                    )
        given = axis.value(keys.AXIS["set"])
        if len(given) == len(names):
            spelled |= dict(zip(given, names, strict=True))
        if isinstance(found, RandomAxis):
            axes.append((found, only))
        else:
            lists.append((found, only))
    if not taken and read["replicates"] is None:
        raise section.error("axes", "is missing; give at least one [[sweep.axes]]")
    set_by = {name: next(iter(places.values())) for name, places in taken.items()}
    sweep = Sweep(
        lists=tuple(found for found, _ in lists),
        axes=tuple(found for found, _ in axes),
        sampling=read["sampling"],
        samples=_samples(section, read["samples"], bool(axes), read["sampling"]),
        seed=read["seed"],
        trajectories=read["trajectories"],
        constraints=tuple(_constraints(section, read["constraints"], set_by, spelled)),
        timeout=read["timeout"],
        replicates=_replicates(section, read["replicates"], read["reseed"], set_by, reader),
        variants=tuple(only for _, only in (*lists, *axes)),
    )
    parts = [sweep.of_variant(variant) for variant in variants]
    for constraint in sweep.constraints:
        if not any(constraint in part.constraints for part in parts):
            text = f"'{constraint.text}' is of settings that no variant has together"
            raise section.error("constraints", text)
    repeated = sweep.replicates.count if sweep.replicates is not None else 1
    if max(part.size for part in parts) * repeated > keys.MOST_RUNS:
        raise section.error(
            "",
            f"has more than {keys.MOST_RUNS} runs of each variant; split it over several scenarios",
        )
    return sweep


def _replicates(
    section: Section,
    count: int | None,
    names: Iterable[str],
    taken: Mapping[str, str],
    reader: SettingsReader,
) -> Replicates | None:
    """How often points are repeated, and what gets a fresh seed each time."""
    if count is None:
        if "reseed" in section.data:
            raise section.error("reseed", "has no meaning without replicates")
        return None
    if not names:
        raise section.error("reseed", "is missing; name the settings that replicates differ in")
    reseeded: dict[str, str] = {}
    for index, name in enumerate(names, start=1):
        key = f"reseed[{index}]"
        place = replace(section, path=section.at(key), data={name: 1})
        (setting, value), *others = reader.read(place).items()
        whole = isinstance(value, int) and not isinstance(value, bool)
        if others or not whole or setting.startswith(f"{EXPERIMENT}."):
            raise section.error(key, f"= '{name}' is no integer parameter of a component")
        if other := {**taken, **reseeded}.get(setting):
            raise section.error(key, f"= '{name}' is set by {other} already")
        reseeded[setting] = section.spelled(section.at(key))
    return Replicates(count, tuple(reseeded))


def _variants(axis: Section, known: Sequence[str]) -> tuple[str, ...]:
    """The variants that an axis is of; none where it is of all."""
    if "variants" not in axis.data:
        return ()
    names: tuple[str, ...] = axis.as_kind("variants", "texts")
    if not names:
        raise axis.error("variants", "is empty; name the variants that the axis is of")
    for name in names:
        if name not in known:
            raise axis.error("variants", f"= '{name}' is no variant; {nearest(name, known)}")
        if names.count(name) > 1:
            raise axis.error("variants", f"has '{name}' twice; leave one of them out")
    return names


def _constraints(
    section: Section, texts: Iterable[str], swept: Iterable[str], spelled: Mapping[str, str]
) -> Iterator[Constraint]:
    """The constraints, of the settings' full names; `spelled` are those that axes give."""
    for text in texts:
        constraint = section.attempt("constraints", partial(Constraint, text)).renamed(spelled)
        section.attempt("constraints", partial(constraint.check_names, swept))
        yield constraint


def _samples(section: Section, samples: int | None, needed: bool, sampling: str) -> int:
    if not needed:
        if samples is not None:
            raise section.error("samples", "has no meaning without a random axis")
        if "sampling" in section.data:
            raise section.error("sampling", "has no meaning without a random axis")
        return 0
    if samples is None:
        raise section.error("samples", f"is missing; give {keys.SWEEP['samples'].valid}")
    if sampling == "sobol" and samples.bit_count() != 1:
        power = 2 ** (samples.bit_length() - 1)
        raise section.wrong("samples", f"a power of two for Sobol: {power} or {2 * power}")
    return samples


def _axis(section: Section, reader: SettingsReader) -> RandomAxis | tuple[Settings, ...]:
    read = section.read(keys.AXIS)
    others = ("set", "variants")
    kinds = [key for key in section.data if key not in others]
    if len(kinds) != 1:
        known = ", ".join(key for key in keys.AXIS.names if key not in others)
        raise section.error("set", f"needs one of: {known}")
    if kinds == ["values"]:
        return _list(section, read["set"], read["values"], reader)
    if kinds[0] in ("linspace", "logspace"):
        names = read["set"]
        rows = [[value] * len(names) for value in _spaced(section, kinds[0], read[kinds[0]])]
        listed = replace(section, data={"set": list(names), "values": rows})
        return _list(listed, names, tuple(rows), reader)
    return _random(section, read["set"], kinds[0], read[kinds[0]], reader)


def _list(
    section: Section, names: tuple[str, ...], values: tuple[object, ...], reader: SettingsReader
) -> tuple[Settings, ...]:
    """One entry per value; with several names, each value holds one for each of them."""
    together = isinstance(section.data["set"], list)
    if not names:
        raise section.error("set", "is empty; name the settings of the axis")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise section.error("set", f"sets '{twice}' twice; leave one of them out")
    entries = []
    for index, value in enumerate(values, start=1):
        row = value if together else [value]
        if not isinstance(row, list) or len(row) != len(names):
            raise section.error(
                f"values[{index}]", f"is not valid; give {counted(len(names), 'value')}"
            )
        at = f"{section.path}.values[{index}]"
        entries.append(
            reader.read(replace(section, path=at, data=dict(zip(names, row, strict=True))))
        )
    if any(len(entry) < len(names) for entry in entries):
        raise section.error("set", "names one variable in two ways; leave one of them out")
    if any(entry.keys() != entries[0].keys() for entry in entries):
        raise section.error("values", "do not all set the same variables")
    for index, entry in enumerate(entries, start=1):
        if (first := entries.index(entry) + 1) < index:
            raise section.error(
                f"values[{index}]", f"is that of values[{first}]; leave one of them out"
            )
    return tuple(entries)


def _spaced(section: Section, kind: str, numbers: tuple[float, ...]) -> list[float]:
    """The values of `linspace` or `logspace`; both ends are exact."""
    valid = (
        len(numbers) == 3 and numbers[2] == int(numbers[2]) and 2 <= numbers[2] <= keys.MOST_RUNS
    )
    if not valid or numbers[0] == numbers[1]:
        counts = f"a count from 2 to {keys.MOST_RUNS}"
        raise section.wrong(kind, f"[first, last, count] with two ends and {counts}")
    first, last, count = numbers[0], numbers[1], int(numbers[2])
    if kind == "logspace":
        if not (first > 0.0 and last > 0.0):
            raise section.wrong(kind, "[first, last, count] with positive ends")
        inner = np.geomspace(first, last, count)[1:-1]
    else:
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
            inner = np.linspace(first, last, count)[1:-1]
    return [first, *inner.tolist(), last]


def _random(
    section: Section,
    names: tuple[str, ...],
    kind: str,
    numbers: tuple[float, ...],
    reader: SettingsReader,
) -> RandomAxis:
    if len(names) != 1:
        raise section.wrong("set", "one setting; those that change together have values")
    distribution = DISTRIBUTIONS[kind]
    if len(numbers) != 2 or not distribution.valid(numbers[0], numbers[1]):
        raise section.wrong(kind, distribution.parameters)
    place = section.spelled(section.path)
    axis = RandomAxis(names[0], kind, (numbers[0], numbers[1]), place)
    ends = (axis.value(0.0), axis.value(1.0))
    if not all(math.isfinite(float(end)) for end in ends):
        raise section.wrong(kind, f"{distribution.parameters}, that no draw is infinite with")
    for value in ends if distribution.bounded else ():
        reader.read(replace(section, data={axis.name: value}))
    flat = reader.read(replace(section, data={axis.name: axis.value(0.5)}))
    if len(flat) != 1:
        raise section.error("set", f"= '{axis.name}' is no single variable")
    return replace(axis, name=next(iter(flat)))
