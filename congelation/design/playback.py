"""A find as a scenario file: theta(t) in tables, all variants, to be played through FMUs."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import tomli_w

from congelation.design.attack import Attack, Find
from congelation.design.shooting import Cells
from congelation.scenario.scenario import Experiment, Scenario

__all__ = ["scenario_table", "write_finds", "write_profile"]

TOLERANCE = 1e-6
"""Of the experiment, where the attacked scenario states a step instead: it has to follow bursts."""

LATE = "peak_late"
"""Name of the metric that measures a late burst."""


def write_finds(found: Attack, folder: Path) -> list[Path]:
    """One scenario for each find, with the tables of its theta(t) beside it.

    Returns
    -------
    list of Path
        The scenarios ``<variant>_<objective>.toml``, in the order of the finds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [_write(found.scenario, find, folder) for find in found.finds]


def _write(scenario: Scenario, find: Find, folder: Path) -> Path:
    stem = re.sub(r"\W+", "_", f"{find.variant}_{find.objective}").strip("_").lower()
    profile = write_profile(find.cells, folder, stem)
    title = f"{scenario.title}: worst found for {find.variant}, {find.objective} = {find.value:.6g}"
    table = scenario_table(
        scenario, find.plant, folder, profile, float(find.cells.edges[-1]), title
    )
    if find.struck is not None:
        spec = {"metric": "peak", "of": f"{find.plant}.x", "after": find.struck}
        table["metrics"] = {**table.get("metrics", {}), LATE: spec}
    file = folder / f"{stem}.toml"
    file.write_text(tomli_w.dumps(table), encoding="utf-8")
    return file


def write_profile(cells: Cells, folder: Path, stem: str) -> dict[str, list[dict[str, object]]]:
    """The table ``profile`` of a plant, its tables written as CSV beside the scenario.

    A component that never jumps needs no file.
    """
    profile: dict[str, list[dict[str, object]]] = {}
    for j, column in enumerate(cells.theta.T.tolist(), 1):
        rows = [(0, column[0])]
        rows += [(k, b) for k, (a, b) in enumerate(itertools.pairwise(column), 1) if a != b]
        if len(rows) == 1:
            profile[f"theta[{j}]"] = [{"constant": column[0]}]
            continue
        file = f"{stem}_theta_{j}.csv"
        lines = [f"{float(cells.edges[k])!r},{value!r}" for k, value in rows]
        (folder / file).write_text("\n".join(["time,value", *lines, ""]), encoding="utf-8")
        profile[f"theta[{j}]"] = [{"table": {"file": file}}]
    return profile


def scenario_table(
    scenario: Scenario,
    plant: str,
    folder: Path,
    profile: Mapping[str, object],
    stop_time: float,
    title: str,
) -> dict[str, Any]:
    """The scenario with another theta(t) of its `plant`, as the tables of its TOML file.

    Sweeps are left out; so are the profiles that variants set.
    """
    components: dict[str, object] = {}
    for component in scenario.system.components:
        table: dict[str, object] = {"fmu": os.path.relpath(component.fmu, folder)}
        start = {k: v for k, v in component.start.items() if not k.startswith("profile[")}
        if start:
            table["start"] = start
        if component.name == plant:
            table["profile"] = dict(profile)
        components[component.name] = table
    document: dict[str, Any] = {
        "title": title,
        "connections": [f"{c.source} -> {c.target}" for c in scenario.system.connections],
        "components": components,
        "experiment": _experiment(scenario.case({}).experiment, stop_time),
    }
    if scenario.metrics:
        document["metrics"] = {
            m.name: {"metric": m.metric, **({"of": m.of} if m.of else {}), **m.options}
            for m in scenario.metrics
        }
    document["figures"] = [{"name": f.name, "panels": list(f.panels)} for f in scenario.figures]
    document["variants"] = [
        {
            "name": v.name,
            "set": {k: s for k, s in v.settings.items() if not _of_profile(k, plant)},
        }
        for v in scenario.variants
    ]
    return document


def _experiment(experiment: Experiment, stop_time: float) -> dict[str, object]:
    table: dict[str, object] = {"stop_time": stop_time}
    for field in fields(Experiment):
        value = getattr(experiment, field.name)
        if field.name in ("stop_time", "step") or value is None or value == ():
            continue
        if field.name in ("options", "start_time") and not value:
            continue
        table[field.name] = list(value) if isinstance(value, tuple) else value
    if "tolerance" not in table:
        table["tolerance"] = TOLERANCE
    return table


def _of_profile(setting: str, plant: str) -> bool:
    return setting.startswith(f"{plant}.profile[")
