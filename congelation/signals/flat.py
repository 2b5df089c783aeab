"""A profile as flat parameters, the variables of an FMU."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, NamedTuple

from .checks import ProfileError, boolean, checked, nearest
from .kinds import BY_KIND, SLOTTED, body_of, parameters, scalar_term, table_of_file
from .table import Table
from .terms import Constant, Term

__all__ = [
    "DEFAULT_SLOTS",
    "FlatParameter",
    "Slots",
    "flat_of_terms",
    "flat_parameters",
    "sizes_of_flat",
    "terms_of_flat",
]


@dataclass(frozen=True)
class Slots:
    """How many terms of each kind the flat parameters have room for."""

    sines: int = 2
    squares: int = 2
    chirps: int = 1
    telegraphs: int = 1
    table: bool = True
    noises: int = 0

    def count(self, kind: str) -> int:
        """Number of slots for terms of a kind, one of `SLOTTED`."""
        return int(getattr(self, f"{kind}s"))

    @classmethod
    def of(cls, kinds: Iterable[str]) -> Slots:
        """Room for terms of just these kinds, one slot for each that is listed."""
        numbers = Counter(kinds)
        slots = {f"{kind}s": numbers[kind] for kind in SLOTTED}
        return cls(**slots, table=Table.kind in numbers)

    def __or__(self, other: Slots) -> Slots:
        """Room for the terms of either."""
        return Slots(
            **{f.name: max(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        )


class FlatParameter(NamedTuple):
    """One parameter of a profile, as an FMU shows it.

    `type` is one of ``"Real"``, ``"Integer"``, ``"Boolean"``, ``"String"``; with every parameter at
    its `default` the profile is 0.
    """

    name: str
    type: str
    default: float | int | bool | str
    unit: str
    description: str


_MEAN = "mean"
_TABLE_FILE = "table.file"
_TABLE_LINEAR = "table.linear"
_SLOT_NAME = re.compile(r"(\w+)\[([1-9]\d*)\]\.(\w+)")
DEFAULT_SLOTS = Slots()


def _default(f: Any) -> Any:
    return f.metadata["neutral"] if f.default is MISSING else f.default


def flat_parameters(slots: Slots = DEFAULT_SLOTS) -> list[FlatParameter]:
    """The flat parameters of a profile with these slots, in the order of their names in FMUs."""
    listed = [FlatParameter(_MEAN, "Real", 0.0, "", "mean value")]
    for kind in SLOTTED:
        for k in range(1, slots.count(kind) + 1):
            for name, f in parameters(BY_KIND[kind]).items():
                meta = f.metadata
                listed.append(
                    FlatParameter(
                        f"{kind}[{k}].{name}",
                        meta["type"],
                        _default(f),
                        meta["unit"],
                        meta["description"],
                    )
                )
    if slots.table:
        about_file = "CSV file of two columns time,value added to the profile; empty: none"
        about_linear = "true: straight lines between the rows; false: each value held"
        listed.append(FlatParameter(_TABLE_FILE, "String", "", "", about_file))
        listed.append(FlatParameter(_TABLE_LINEAR, "Boolean", False, "", about_linear))
    return listed


def sizes_of_flat(names: Iterable[str]) -> dict[str, str]:
    """Of the names of flat parameters those that turn a term on, such as ``sine[1].amplitude``.

    Each with the kind of its term; a table is turned on by its file.
    """
    found = {}
    for name in names:
        match = _SLOT_NAME.fullmatch(name)
        if name == _TABLE_FILE:
            found[name] = Table.kind
        elif match and match[1] in SLOTTED and match[3] == BY_KIND[match[1]].size:
            found[name] = match[1]
    return found


def terms_of_flat(values: Mapping[str, Any], base: str) -> tuple[Term, ...]:
    """The terms that flat parameters describe; cf. `Profile.from_flat`."""
    slots: dict[tuple[int, int], dict[str, Any]] = {}
    for name, value in values.items():
        if name in (_MEAN, _TABLE_FILE, _TABLE_LINEAR):
            continue
        match = _SLOT_NAME.fullmatch(name)
        kind, k, key = match.groups() if match else ("", "1", "")
        if kind not in SLOTTED or key not in parameters(BY_KIND[kind]):
            valid = [p.name.replace("[1]", f"[{k}]") for p in flat_parameters()]
            raise ProfileError(f"{name}: unknown parameter; {nearest(name, valid)}")
        slots.setdefault((SLOTTED.index(kind), int(k)), {})[key] = value
    mean = checked(values.get(_MEAN, 0.0), {"type": "Real", "positive": False}, _MEAN)
    terms: list[Term] = [Constant(mean)] if mean else []
    for (order, k), given in sorted(slots.items()):
        kind = SLOTTED[order]
        full = {name: _default(f) for name, f in parameters(BY_KIND[kind]).items()}
        full.update(given)
        term = scalar_term(kind, full, f"{kind}[{k}]")
        if full[BY_KIND[kind].size]:
            terms.append(term)
    linear = boolean(values.get(_TABLE_LINEAR, False), _TABLE_LINEAR)
    if values.get(_TABLE_FILE, ""):
        terms.append(table_of_file(values[_TABLE_FILE], linear, _TABLE_FILE, base))
    return tuple(terms)


def flat_of_terms(terms: Sequence[Term], slots: Slots) -> dict[str, Any]:
    """All flat parameters for `slots`; cf. `Profile.to_flat`."""
    flat: dict[str, Any] = {p.name: p.default for p in flat_parameters(slots)}
    flat[_MEAN] = math.fsum([t.value for t in terms if isinstance(t, Constant)])
    for kind in SLOTTED:
        alike = [term for term in terms if term.kind == kind]
        if len(alike) > slots.count(kind):
            raise ProfileError(f"terms {kind}: {len(alike)} given, at most {slots.count(kind)} fit")
        for k, term in enumerate(alike, 1):
            flat.update({f"{kind}[{k}].{key}": v for key, v in body_of(term).items()})
    tables = [term for term in terms if isinstance(term, Table)]
    if len(tables) > int(slots.table):
        raise ProfileError(f"terms table: {len(tables)} given, at most {int(slots.table)} fit")
    for table in tables:
        if not table.file:
            raise ProfileError("table.times: give the rows in a CSV file, as table.file")
        flat.update({_TABLE_FILE: table.file, _TABLE_LINEAR: table.linear})
    return flat
