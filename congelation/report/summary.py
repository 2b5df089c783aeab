"""The summary of a study as text: one line per quantity, one column per run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from congelation.study.store import Study

__all__ = ["Summary", "metric_definitions", "number", "summarise"]


_QUANTILES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}


@dataclass(frozen=True)
class Summary:
    """A table: `columns` names the runs, each line has a label and one cell per run."""

    columns: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]


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
