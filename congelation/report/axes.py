"""The settings that vary in a study: which of them are axes, their short names and units."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

from congelation.results.labels import plain_unit
from congelation.results.record import RunRecord, Study

__all__ = ["FEW", "axes_of", "short_names", "unit_of"]

FEW = 12
"""Values of an axis up to which runs are counted at each of them; a random axis has more."""

_TERM = re.compile(r"(?<!profile)\[\d+\](?=\.\w+$)")
"""The number of a term of a profile: ``sine[1].omega``."""


def axes_of(study: Study) -> dict[str, list[Any]]:
    """The settings that vary within a variant, with their values in order.

    Of the settings that an axis of a sweep changes together, one that follows from another is
    left out.
    """
    variants: dict[str, list[RunRecord]] = {}
    for run in study.records:
        variants.setdefault(run.variant, []).append(run)
    columns = {
        name: [repr(run.settings.get(name)) for run in study.records]
        for name in study.about["varied"]
        if any(len({repr(r.settings.get(name)) for r in runs}) > 1 for runs in variants.values())
    }
    # A directory of an earlier version does not say which settings make an axis.
    groups = study.about.get("axes") or [list(columns)]
    axes: dict[str, list[Any]] = {}
    for group in groups:
        kept: list[str] = []
        for name in group:
            if name in columns and name not in axes:
                own = columns[name]
                known = (columns[other] for other in kept)
                if not any(len({*zip(c, own, strict=True)}) == len({*c}) for c in known):
                    kept.append(name)
        for name in kept:
            found = {
                repr(v): v for run in study.records if (v := run.settings.get(name)) is not None
            }
            axes[name] = sorted(found.values(), key=lambda v: (isinstance(v, str), v))
    return axes


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Settings by the shortest end that tells them apart.

    ``plant.profile[1].sine[1].omega`` is omega; beside ``..square[1].omega`` it is sine.omega, the
    number of the term left out as in a scenario where that is enough.
    """

    def ends(name: str) -> list[str]:
        parts = name.split(".")
        return [".".join(parts[k:]) for k in range(len(parts) - 1, -1, -1)]

    counts = Counter(end for name in {*names} for end in ends(name))
    found = {name: next((e for e in ends(name) if counts[e] == 1), name) for name in names}
    plain = {name: _TERM.sub("", end) for name, end in found.items()}
    times = Counter(plain.values())
    return {name: plain[name] if times[plain[name]] == 1 else end for name, end in found.items()}


def unit_of(study: Study, setting: str) -> str:
    """The unit of a setting, with a space before it; empty where there is none."""
    unit = plain_unit(study.about.get("units", {}).get(setting, ""))
    return f" {unit}" if unit else ""
