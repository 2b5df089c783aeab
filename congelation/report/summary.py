"""The summary of a study as text: one line per quantity, one column per run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from congelation.errors import InvalidInput, nearest
from congelation.results.labels import plain_unit
from congelation.results.record import GROUPS, RunRecord, Study

__all__ = [
    "NOT_SETTLED",
    "Summary",
    "label_of",
    "metric_definitions",
    "metric_value",
    "number",
    "short",
    "summarise",
    "summarise_groups",
    "without_effect",
]


_NUMBER = re.compile(r"(?<!profile\.theta)\[\d+\](?=\.\w+$)")
"""The number of a term of a profile."""

_COLUMNS = ("variant", "status", "replicate")

_QUANTILES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}


NOT_SETTLED = "not settled"
"""In place of an infinite settling time: the run ended before; it might settle later."""


@dataclass(frozen=True)
class Summary:
    """A table: `columns` names the runs, each line has a label and one cell per run."""

    columns: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]


def summarise_groups(study: Study, by: Sequence[str]) -> Summary:
    """A line per group of runs with equal values of some columns; quantiles of every metric.

    Parameters
    ----------
    study : Study
    by : sequence of str
        Columns: `variant`, `status`, `replicate` where there are any, or varied settings, as the
        FMU or the scenario spells them; a vector or profile stands for all that varies of it.

    Raises
    ------
    InvalidInput
        If there is no such column.
    """
    names = [name for asked in by for name in _columns(study, asked)]

    def key(run: RunRecord) -> tuple[object, ...]:
        return tuple(getattr(run, n) if n in _COLUMNS else run.settings.get(n) for n in names)

    groups: dict[tuple[str, ...], list[RunRecord]] = {}
    for run in sorted(study.records, key=lambda run: [_order(value) for value in key(run)]):
        groups.setdefault(tuple(number(value) for value in key(run)), []).append(run)
    metrics = study.about["metrics"]
    columns = ["runs", "completed", *(label_of(name, about) for name, about in metrics.items())]
    lines = []
    for label, runs in groups.items():
        completed = sum(run.status == "COMPLETED" for run in runs)
        cells = [str(len(runs)), str(completed)]
        cells += [_spread([run.metrics.get(n) for run in runs], metrics[n]) for n in metrics]
        lines.append((", ".join(label), tuple(cells)))
    return Summary(tuple(columns), tuple(lines))


def _columns(study: Study, asked: str) -> list[str]:
    """The columns that a name stands for."""
    name = asked.removeprefix(GROUPS["settings"])
    if name in _COLUMNS:
        return [name]
    # By each spelling of a column its names. The first term of a kind goes without its number,
    # as in a scenario, where that is the only one.
    spelled: dict[str, list[str]] = {}
    for column in study.about["varied"]:
        spelling = study.about.get("spelled", {}).get(column, column)
        for each in dict.fromkeys((column, spelling, _NUMBER.sub("", spelling))):
            spelled.setdefault(each, []).append(column)
    found = spelled.get(name, [])
    if len(found) > 1:
        raise InvalidInput(f"'{name}' is one of {len(found)}; give {' or '.join(found)}")
    if found:
        return found
    inside = re.compile(re.escape(name) + r"[.\[]")
    found = [
        column for each, columns in spelled.items() if inside.match(each) for column in columns
    ]
    if found:
        return list(dict.fromkeys(found))
    raise InvalidInput(f"'{name}' is no column to group by; {nearest(name, [*_COLUMNS, *spelled])}")


def _order(value: object) -> tuple[int, float, str]:
    """A key that sorts numbers before texts, and missing values last."""
    if isinstance(value, int | float):
        return 0, float(value), ""
    return (2, 0.0, "") if value is None else (1, 0.0, str(value))


def _spread(values: Sequence[float | None], about: Mapping[str, Any]) -> str:
    """The median and, in brackets, the outer quantiles."""
    low, middle, high = (_quantile(values, q, about) for q in _QUANTILES.values())
    return middle if low == high else f"{middle} [{low}, {high}]"


def without_effect(study: Study) -> Iterator[str]:
    """The settings, and `replicate`, of which all values give the same metrics to the last bit."""
    runs = [run for run in study.records if run.status == "COMPLETED"]
    if not study.about["metrics"]:
        return
    for name in (*study.about["varied"], "replicate"):
        groups: dict[tuple[object, ...], list[tuple[object, tuple[float | None, ...]]]] = {}
        for run in runs:
            settings = {**run.settings, "replicate": run.replicate}
            value = settings.pop(name, None)
            if name == "replicate":  # which differ in their seeds as well
                settings = {k: v for k, v in settings.items() if not k.endswith("seed")}
            groups.setdefault((run.variant, *settings.values()), []).append(
                (value, tuple(run.metrics.values()))
            )
        varied = [found for found in groups.values() if len({value for value, _ in found}) > 1]
        if varied and all(len({metrics for _, metrics in found}) == 1 for found in varied):
            yield name


def summarise(study: Study) -> Summary:
    """Settings, status, metrics and cost of every run; of a sweep, quantiles by variant."""
    if study.about["swept"]:
        return _summarise_sweep(study)
    return Summary(
        tuple(run.variant for run in study.records),
        tuple((label, tuple(cells)) for label, cells in _lines(study)),
    )


def _summarise_sweep(study: Study) -> Summary:
    groups: dict[str, list[RunRecord]] = {}
    for run in study.records:
        groups.setdefault(run.variant, []).append(run)
    lines = [("runs", [str(len(runs)) for runs in groups.values()])]
    for status in dict.fromkeys(run.status for run in study.records):
        counts = [sum(run.status == status for run in runs) for runs in groups.values()]
        lines.append((status, [str(count) for count in counts]))
    for name, about in study.about["metrics"].items():
        for text, q in _QUANTILES.items():
            cells = [
                _quantile([run.metrics.get(name) for run in runs], q, about)
                for runs in groups.values()
            ]
            lines.append((f"{label_of(name, about)}, {text}", cells))
    return Summary(tuple(groups), tuple((label, tuple(cells)) for label, cells in lines))


def _quantile(values: Sequence[float | None], q: float, about: Mapping[str, Any]) -> str:
    """A quantile of the known values.

    The median of an even number of values is the mean of the two middle ones, as everywhere in the
    reports; every other quantile is one of the values, so that inf does no harm.
    """
    known = sorted(value for value in values if value is not None and not math.isnan(value))
    if not known:
        return metric_value(None, about)
    if q != _QUANTILES["median"]:
        return metric_value(float(np.quantile(known, q, method="inverted_cdf")), about)
    found = metric_value(median(known), about)
    # The mean of a number and inf says nothing of the number: exactly half of the runs settle.
    half = found == NOT_SETTLED and math.isfinite(known[(len(known) - 1) // 2])
    return f"{found} in half" if half else found


def metric_definitions(study: Study) -> tuple[tuple[str, str], ...]:
    """The label of each metric and what it is, with its source."""
    return tuple(
        (label_of(name, about), f"{about['metric']} of {about['of']}: {about['definition']}")
        for name, about in study.about["metrics"].items()
    )


def number(value: object) -> str:
    """A value for people: four digits; a dash where there is none."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # of the settings of an FMU, which may have line breaks
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in value)
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, float):  # a list of numbers
        return str(value)
    if math.isnan(value):
        return "–"
    return short(value, 4) if math.isfinite(value) else "∞" if value > 0.0 else "-∞"


def metric_value(value: float | None, about: Mapping[str, Any]) -> str:
    """A metric for people; a settling time that is not within the run is "not settled"."""
    if value == math.inf and about["metric"] == "settling_time":
        return NOT_SETTLED
    return number(value)


def short(value: float, digits: int) -> str:
    """A number with so many digits; without an exponent up to 100,000."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if 10.0 ** (digits - 1) <= abs(rounded) < 1e5 else f"{value:.{digits}g}"


def _lines(study: Study) -> Iterator[tuple[str, list[str]]]:
    runs = study.records
    yield "status", [run.status for run in runs]
    for name in study.about["varied"]:
        yield name, [number(run.settings.get(name)) for run in runs]
    for name, about in study.about["metrics"].items():
        yield label_of(name, about), [metric_value(run.metrics.get(name), about) for run in runs]
    yield "macro steps", [number(run.steps) for run in runs]
    yield "wall time [s]", [number(run.wall_time) for run in runs]
    for name in dict.fromkeys(name for run in runs for name in run.deviations):
        yield (
            f"error of {name} / peak",
            [f"{run.deviations[name]:.1e}" if name in run.deviations else "–" for run in runs],
        )


def label_of(name: str, about: Mapping[str, Any]) -> str:
    """A metric's name with its unit."""
    unit = plain_unit(about["unit"])
    return f"{name} [{unit}]" if unit else name
