"""The table ``[sweep]`` of a scenario file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from congelation.errors import InvalidInput, nearest
from congelation.scenario.axes import (
    DISTRIBUTIONS,
    MOST_RUNS,
    SAMPLINGS,
    RandomAxis,
    Replicates,
    Settings,
    Sweep,
)
from congelation.scenario.constraint import Constraint
from congelation.scenario.scenario import EXPERIMENT
from congelation.scenario.start_values import Scalar
from congelation.toml import Section

__all__ = ["Flatten", "read_sweep"]

Flatten = Callable[[Section], dict[str, Scalar]]
"""Checks a table of settings against the scenario; one entry per scalar variable."""

_KEYS = (
    "axes",
    "constraints",
    "replicates",
    "reseed",
    "samples",
    "sampling",
    "seed",
    "timeout",
    "trajectories",
)


def read_sweep(section: Section, flatten: Flatten) -> Sweep:
    """The sweep that a table describes.

    Raises
    ------
    InvalidInput
        Naming the key and what would be valid.
    """
    section.only(_KEYS)
    lists: list[tuple[Settings, ...]] = []
    axes: list[RandomAxis] = []
    taken: dict[str, str] = {}
    for axis in section.sections("axes"):
        found = _axis(axis, flatten)
        names = [found.name] if isinstance(found, RandomAxis) else list(found[0])
        for name in names:
            if name in taken:
                raise axis.error("set", f"sets '{name}', which {taken[name]} sets already")
            taken[name] = axis.path
        if isinstance(found, RandomAxis):
            axes.append(found)
        else:
            lists.append(found)
    if not taken and "replicates" not in section.data:
        raise section.error("axes", "is missing; give at least one [[sweep.axes]]")
    sampling = section.text("sampling", "random")
    if sampling not in SAMPLINGS:
        raise section.wrong("sampling", f"a known sampling; {nearest(sampling, SAMPLINGS)}")
    seed = section.integer("seed", 0)
    if seed < 0:
        raise section.wrong("seed", "a whole number of at least 0")
    sweep = Sweep(
        lists=tuple(lists),
        axes=tuple(axes),
        sampling=sampling,
        samples=_samples(section, bool(axes), sampling),
        seed=seed,
        trajectories=section.boolean("trajectories", False),
        constraints=tuple(_constraints(section, taken)),
        timeout=section.duration("timeout") if "timeout" in section.data else None,
        replicates=_replicates(section, taken, flatten),
    )
    if sweep.size * (sweep.replicates.count if sweep.replicates is not None else 1) > MOST_RUNS:
        raise InvalidInput(
            f"{section.file}: {section.path} has more than {MOST_RUNS} runs of each variant; "
            "split it over several scenarios"
        )
    return sweep


def _replicates(section: Section, taken: Mapping[str, str], flatten: Flatten) -> Replicates | None:
    """How often points are repeated, and what gets a fresh seed each time."""
    if "replicates" not in section.data:
        if "reseed" in section.data:
            raise section.error("reseed", "has no meaning without replicates")
        return None
    count = section.integer("replicates")
    if not 1 <= count <= MOST_RUNS:
        raise section.wrong("replicates", f"a whole number from 1 to {MOST_RUNS}")
    names = section.texts("reseed")
    if not names:
        raise section.error("reseed", "is missing; name the settings that replicates differ in")
    reseeded: dict[str, str] = {}
    for index, name in enumerate(names, start=1):
        key = f"reseed[{index}]"
        place = replace(section, path=section.at(key), data={name: 1})
        (setting, value), *others = flatten(place).items()
        whole = isinstance(value, int) and not isinstance(value, bool)
        if others or not whole or setting.startswith(f"{EXPERIMENT}."):
            raise section.error(key, f"= '{name}' is no integer parameter of a component")
        if other := {**taken, **reseeded}.get(setting):
            raise section.error(key, f"= '{name}' is set by {other} already")
        reseeded[setting] = section.at(key)
    return Replicates(count, tuple(reseeded))


def _constraints(section: Section, swept: Iterable[str]) -> Iterator[Constraint]:
    for text in section.texts("constraints"):
        constraint = section.attempt("constraints", partial(Constraint, text))
        section.attempt("constraints", partial(constraint.check_names, swept))
        yield constraint


def _samples(section: Section, needed: bool, sampling: str) -> int:
    if not needed:
        if "samples" in section.data:
            raise section.error("samples", "has no meaning without a random axis")
        return 0
    samples = section.integer("samples")
    if not 1 <= samples <= MOST_RUNS:
        raise section.wrong("samples", f"a whole number from 1 to {MOST_RUNS}")
    if sampling == "sobol" and samples.bit_count() != 1:
        power = 2 ** (samples.bit_length() - 1)
        raise section.wrong("samples", f"a power of two for Sobol: {power} or {2 * power}")
    return samples


def _axis(section: Section, flatten: Flatten) -> RandomAxis | tuple[Settings, ...]:
    section.only(("set", "values", *DISTRIBUTIONS)).require("set")
    kinds = [key for key in section.data if key != "set"]
    if len(kinds) != 1:
        kinds_text = ", ".join(("values", *DISTRIBUTIONS))
        raise section.error("set", f"needs one of: {kinds_text}")
    return _list(section, flatten) if kinds == ["values"] else _random(section, kinds[0], flatten)


def _list(section: Section, flatten: Flatten) -> tuple[Settings, ...]:
    """One entry per value; with several names, each value holds one for each of them."""
    together = isinstance(section.data["set"], list)
    names = section.texts("set") if together else (section.text("set"),)
    values = section.data["values"]
    if not isinstance(values, list) or not values:
        raise section.wrong("values", "an array with at least one value")
    entries = []
    for index, value in enumerate(values, start=1):
        row = value if together else [value]
        if not isinstance(row, list) or len(row) != len(names):
            raise section.error(f"values[{index}]", f"is not valid; give {len(names)} values")
        at = f"{section.path}.values[{index}]"
        entries.append(flatten(replace(section, path=at, data=dict(zip(names, row, strict=True)))))
    if any(entry.keys() != entries[0].keys() for entry in entries):
        raise section.error("values", "do not all set the same variables")
    return tuple(entries)


def _random(section: Section, kind: str, flatten: Flatten) -> RandomAxis:
    name = section.text("set")
    distribution = DISTRIBUTIONS[kind]
    numbers = section.numbers(kind)
    if len(numbers) != 2 or not distribution.valid(numbers[0], numbers[1]):
        raise section.wrong(kind, distribution.parameters)
    axis = RandomAxis(name, kind, (numbers[0], numbers[1]), section.path)
    ends = (axis.value(0.0), axis.value(1.0))
    if not all(math.isfinite(float(end)) for end in ends):
        raise section.wrong(kind, f"{distribution.parameters}, that no draw is infinite with")
    for value in ends if distribution.bounded else ():
        flatten(replace(section, data={name: value}))
    flat = flatten(replace(section, data={name: axis.value(0.5)}))
    if len(flat) != 1:
        raise section.error("set", f"= '{name}' is no single variable")
    return replace(axis, name=next(iter(flat)))
