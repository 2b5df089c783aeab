"""The summary of a study as text: one line per quantity, one column per run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from congelation.errors import InvalidInput, nearest
from congelation.results.records import Study

__all__ = [
    "Summary",
    "metric_definitions",
    "number",
    "summarise",
    "summarise_groups",
]


_QUANTILES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}


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
        Columns: `variant`, `status`, `replicate` where there are any, or varied settings.

    Raises
    ------
    InvalidInput
        If there is no such column.
    """
    replicate = [name for name in ("replicate",) if study.rows and name in study.rows[0]]
    known = ["variant", "status", *replicate, *study.about["varied"]]
    for name in by:
        if name not in known:
            raise InvalidInput(f"'{name}' is no column to group by; {nearest(name, known)}")
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    ordered = sorted(study.rows, key=lambda row: [_order(row[name]) for name in by])
    for row in ordered:
        groups.setdefault(tuple(number(row[name]) for name in by), []).append(row)
    metrics = study.about["metrics"]
    columns = ["runs", "completed", *(_label(name, about) for name, about in metrics.items())]
    lines = []
    for label, rows in groups.items():
        completed = sum(row["status"] == "COMPLETED" for row in rows)
        cells = [str(len(rows)), str(completed)]
        cells += [_spread([row[name] for row in rows]) for name in metrics]
        lines.append((", ".join(label), tuple(cells)))
    return Summary(tuple(columns), tuple(lines))


def _order(value: object) -> tuple[int, float, str]:
    """A key that sorts numbers before texts, and missing values last."""
    if isinstance(value, int | float):
        return 0, float(value), ""
    return (2, 0.0, "") if value is None else (1, 0.0, str(value))


def _spread(values: Sequence[float | None]) -> str:
    """The median and, in brackets, the outer quantiles."""
    low, median, high = (_quantile(values, q) for q in _QUANTILES.values())
    return median if low == high else f"{median} [{low}, {high}]"


def summarise(study: Study) -> Summary:
    """Settings, status, metrics and cost of every run; of a sweep, quantiles by variant."""
    if "sweep" in study.about:
        return _summarise_sweep(study)
    return Summary(
        tuple(str(row["variant"]) for row in study.rows),
        tuple((label, tuple(cells)) for label, cells in _lines(study)),
    )


def _summarise_sweep(study: Study) -> Summary:
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in study.rows:
        groups.setdefault(str(row["variant"]), []).append(row)
    statuses = dict.fromkeys(str(row["status"]) for row in study.rows)
    lines = [("runs", [str(len(rows)) for rows in groups.values()])]
    for status in statuses:
        counts = [sum(row["status"] == status for row in rows) for rows in groups.values()]
        lines.append((status, [str(count) for count in counts]))
    for name, about in study.about["metrics"].items():
        for text, q in _QUANTILES.items():
            cells = [_quantile([row[name] for row in rows], q) for rows in groups.values()]
            lines.append((f"{_label(name, about)}, {text}", cells))
    return Summary(tuple(groups), tuple((label, tuple(cells)) for label, cells in lines))


def _quantile(values: Sequence[float | None], q: float) -> str:
    """A quantile of the known values; always one of them, so that inf does no harm."""
    known = [value for value in values if value is not None and not math.isnan(value)]
    return number(float(np.quantile(known, q, method="inverted_cdf"))) if known else number(None)


def metric_definitions(study: Study) -> tuple[tuple[str, str], ...]:
    """The label of each metric and what it is, with its source."""
    return tuple(
        (_label(name, about), f"{about['metric']} of {about['of']}: {about['definition']}")
        for name, about in study.about["metrics"].items()
    )


def number(value: object) -> str:
    """A value for people: four digits; a dash where there is none."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | str):
        return str(value)
    if isinstance(value, float) and math.isnan(value):
        return "–"
    return f"{value:.4g}"


def _lines(study: Study) -> Iterator[tuple[str, list[str]]]:
    rows = study.rows
    yield "status", [str(row["status"]) for row in rows]
    for name in study.about["varied"]:
        yield name, [number(row[name]) for row in rows]
    for name, about in study.about["metrics"].items():
        never = about["metric"] == "settling_time"
        yield (
            _label(name, about),
            ["never" if never and row[name] == math.inf else number(row[name]) for row in rows],
        )
    yield "macro steps", [number(row["macro_steps"]) for row in rows]
    yield "wall time [s]", [number(row["wall_time"]) for row in rows]
    deviations = study.about.get("verification", {})
    for name in dict.fromkeys(d["variable"] for found in deviations.values() for d in found):
        yield (
            f"error of {name} / peak",
            [_error(deviations.get(row["run_id"], []), name) for row in rows],
        )


def _label(name: str, about: Mapping[str, Any]) -> str:
    return f"{name} [{about['unit']}]" if about["unit"] else name


def _error(found: list[Mapping[str, Any]], variable: str) -> str:
    return next((f"{d['relative']:.1e}" for d in found if d["variable"] == variable), "–")
