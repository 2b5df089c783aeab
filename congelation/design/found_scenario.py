"""A find as a scenario file: theta(t) in tables, all variants, to be played through FMUs."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import tomli_w

from congelation.cosim.system import Component, Connection, System
from congelation.design.attack_problem import Varied
from congelation.design.finds import Attack, Find
from congelation.design.shooting import Cells
from congelation.places import write_whole
from congelation.scenario.scenario import Experiment, Scenario
from congelation.signals import Profile

__all__ = ["driven", "profile_table", "scenario_table", "write_finds"]

Profiles = dict[str, list[dict[str, object]]]
"""The table ``profile`` of a component: terms by ``theta[j]``."""

TOLERANCE = 1e-6
"""Tolerance of the run if the attacked scenario states a step, which may miss bursts."""

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
    return [_write(found, find, folder) for find in found.finds]


def _write(found: Attack, find: Find, folder: Path) -> Path:
    scenario = found.scenario
    stem = re.sub(r"\W+", "_", f"{find.variant}_{find.objective}").strip("_").lower()
    if found.source is None:
        system = scenario.system
        profiles = {find.plant: profile_table(find.cells, folder, stem)}
    else:
        system, profiles = driven(
            scenario.system, find.cells, found.varied, found.source, folder, stem
        )
    title = f"{scenario.title}: worst found for {find.variant}, {find.objective} = {find.value:.6g}"
    table = scenario_table(scenario, system, profiles, folder, float(find.cells.edges[-1]), title)
    # What was maximised, so that the run of the file shows it.
    metrics = table.get("metrics", {})
    of = {"of": f"{find.plant}.x"}
    if find.struck is not None:
        table["metrics"] = metrics | {LATE: {"metric": "peak", **of, "after": find.struck}}
    elif find.objective in ("peak", "ise"):
        maximised = {"metric": find.objective, **of}
        if find.objective not in metrics and maximised not in metrics.values():
            table["metrics"] = metrics | {find.objective: maximised}
    file = folder / f"{stem}.toml"
    write_whole(file, tomli_w.dumps(table))
    return file


def driven(
    system: System, cells: Cells, vary: Sequence[Varied], source: Path, folder: Path, stem: str
) -> tuple[System, dict[str, Profiles]]:
    """The system with parameters set and inputs driven by tables, which are written to `folder`.

    With the profiles of the components that drive inputs, by component.
    """
    components = {c.name: c for c in system.components}
    connections = list(system.connections)
    table = profile_table(cells, folder, stem)
    profiles: dict[str, Profiles] = {}
    for one, profile in zip(vary, table.values(), strict=True):
        target = components[one.component]
        if not one.is_input:
            start = {**target.start, one.variable: float(cells.theta[0, vary.index(one)])}
            components[one.component] = replace(target, start=start)
            continue
        flat = Profile.from_spec(profile, base=str(folder)).to_flat()
        start = {f"profile[1].{k}": v for k, v in flat.items()}
        start |= {"x0[1]": 0.0, "u": 0.0}  # theta is put out; the plant itself stays at rest
        components[one.source] = Component(one.source, source.absolute(), start)
        profiles[one.source] = {"theta[1]": profile}
        connections.append(Connection(f"{one.source}.theta[1]", f"{one.component}.{one.variable}"))
    return System(tuple(components.values()), tuple(connections)), profiles


def profile_table(cells: Cells, folder: Path, stem: str) -> Profiles:
    """The table ``profile`` of a plant, its tables written as CSV beside the scenario.

    A component that never jumps needs no file.
    """
    profile: Profiles = {}
    for j, column in enumerate(cells.theta.T.tolist(), 1):
        rows = [(0, column[0])]
        rows += [(k, b) for k, (a, b) in enumerate(itertools.pairwise(column), 1) if a != b]
        if len(rows) == 1:
            profile[f"theta[{j}]"] = [{"constant": column[0]}]
            continue
        file = f"{stem}_theta_{j}.csv"
        lines = [f"{float(cells.edges[k])!r},{value!r}" for k, value in rows]
        write_whole(folder / file, "\n".join(["time,value", *lines, ""]))
        profile[f"theta[{j}]"] = [{"table": {"file": file}}]
    return profile


def scenario_table(
    scenario: Scenario,
    system: System,
    profiles: Mapping[str, Profiles],
    folder: Path,
    stop_time: float,
    title: str,
) -> dict[str, Any]:
    """The scenario with another system and other profiles, as the tables of its TOML file.

    Sweeps are left out; so are the profiles that variants set.
    """
    components: dict[str, object] = {}
    for component in system.components:
        table: dict[str, object] = {"fmu": os.path.relpath(component.fmu, folder)}
        replaced = component.name in profiles
        start = {
            k: v for k, v in component.start.items() if not (replaced and k.startswith("profile["))
        }
        if start:
            table["start"] = start
        if replaced:
            table["profile"] = dict(profiles[component.name])
        components[component.name] = table
    document: dict[str, Any] = {
        "title": title,
        "connections": [f"{c.source} -> {c.target}" for c in system.connections],
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
            "set": {k: s for k, s in v.settings.items() if not _of_profile(k, profiles)},
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


def _of_profile(setting: str, profiles: Iterable[str]) -> bool:
    return any(setting.startswith(f"{component}.profile[") for component in profiles)
