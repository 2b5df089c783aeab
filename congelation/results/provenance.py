"""Provenance: what is kept with the rows of a study, so that a result directory explains itself."""

from __future__ import annotations

import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from congelation.fmi.description import Description, Variable, describe
from congelation.fmi.start_values import resolve_start
from congelation.keys import EXPERIMENT
from congelation.results.identity import code_version
from congelation.scenario.metrics import Metric, metric
from congelation.scenario.parts import MetricSpec
from congelation.scenario.scenario import Scenario
from congelation.scenario.settings import profile_prefixes

__all__ = ["about"]

_PACKAGES = ("fmpy", "pythonfmu", "numpy", "scipy", "pyarrow")

_SIZES = ("mean", "amplitude", "deviation")
"""The numbers of a profile that are values of what it is of."""


def about(
    scenario: Scenario, varied: Sequence[str], axes: Sequence[Sequence[str]] = ()
) -> dict[str, Any]:
    """Where the rows of a study come from and how to read them, representable in JSON.

    `varied` names the columns with the settings that differ between runs, `axes` those that each
    axis of a sweep changes together.
    """
    descriptions = {c.name: describe(c.fmu) for c in scenario.system.components}
    return {
        "title": scenario.title,
        "scenario_file": scenario.file.name if scenario.file is not None else "",
        "scenario": scenario.text,
        "stop_time": scenario.experiment.stop_time,
        "given": {f"experiment.{key}": getattr(scenario.experiment, key) for key in scenario.given},
        "varied": list(varied),
        "axes": [list(names) for names in axes],
        "units": {name: unit for name in varied if (unit := _unit_of_setting(name, descriptions))},
        "spelled": _spelled(varied, descriptions),
        "profiles": _profiles(scenario, descriptions),
        "metrics": {spec.name: _about_metric(spec, descriptions) for spec in scenario.metrics},
        "figures": [asdict(figure) for figure in scenario.figures],
        "fmus": {
            name: {"file": found.path.name, "sha256": found.sha256}
            for name, found in descriptions.items()
        },
        "connections": [
            {**asdict(connection), "unit": _unit_of(connection.source, descriptions)}
            for connection in scenario.system.connections
        ],
        "versions": _versions(),
    }


def _spelled(varied: Sequence[str], descriptions: Mapping[str, Description]) -> dict[str, str]:
    """How scenarios spell varied numbers of profiles: ``plant.profile[1].sine[1].omega`` is
    ``plant.profile.theta[1].sine[1].omega`` there."""
    found = {}
    for name in varied:
        owner, _, variable = name.partition(".")
        if owner not in descriptions:  # the experiment
            continue
        for component, prefix in profile_prefixes(descriptions[owner]).items():
            if variable.startswith(prefix):
                rest = variable.removeprefix(prefix).replace("mean", "constant")
                found[name] = f"{owner}.profile.{component}.{rest}"
    return found


def _profiles(
    scenario: Scenario, descriptions: Mapping[str, Description]
) -> dict[str, dict[str, float | str]]:
    """The outputs that are their profile and nothing else, each with the settings of that profile
    and their values before those of a variant: ``plant.theta[1]`` with ``plant.profile[1].mean``
    and so on, unless something drives ``plant.dtheta[1]``."""
    driven = {connection.target for connection in scenario.system.connections}
    found: dict[str, dict[str, float | str]] = {}
    for component in scenario.system.components:
        owner, description = component.name, descriptions[component.name]
        given = {
            start.variable.name: start.value
            for start in resolve_start(description, component.start, owner)
        }
        for of, prefix in profile_prefixes(description).items():
            whole = f"{owner}.d{of.partition('[')[0]}"
            if of in description.variables and driven.isdisjoint((f"{owner}.d{of}", whole)):
                found[f"{owner}.{of}"] = {
                    f"{owner}.{name}": _value(variable, given.get(name, variable.default))
                    for name, variable in description.variables.items()
                    if name.startswith(prefix)
                }
    return found


def _value(variable: Variable, value: object) -> float | str:
    """The value of a parameter, a number whatever its type is unless it is a text."""
    if variable.type in ("Real", "Integer"):
        return float(str(value or 0))
    if variable.type == "Boolean":
        return float(str(value).lower() in ("true", "1"))
    return str(value or "")


def _about_metric(spec: MetricSpec, descriptions: Mapping[str, Description]) -> dict[str, Any]:
    group = _units(spec.of, descriptions)
    return {
        "metric": spec.metric,
        "of": spec.of or "the closed loop",
        "options": dict(spec.options),
        "definition": metric(spec.metric).definition,
        "unit": _unit(metric(spec.metric), group),
    }


def _units(of: str, descriptions: Mapping[str, Description]) -> set[str]:
    """Units of a variable, or of the elements of a vector; none of what is no variable."""
    component, _, name = of.partition(".")
    return {
        v.unit
        for v in (descriptions[component].variables.values() if component else ())
        if v.name == name or v.name.startswith(f"{name}[")
    }


def _unit_of_setting(name: str, descriptions: Mapping[str, Description]) -> str:
    """The unit of what a variant or an axis sets; empty where it has none."""
    component, _, variable = name.partition(".")
    if component == "experiment":
        return next((key.unit for key in EXPERIMENT.keys if key.name == variable), "")
    if component not in descriptions:
        return ""
    variables = descriptions[component].variables
    # A profile is in the unit of what it is of, which its parameters do not declare.
    for of, prefix in profile_prefixes(descriptions[component]).items():
        if variable.startswith(prefix) and variable.rpartition(".")[2].endswith(_SIZES):
            return variables[of].unit if of in variables else ""
    found = variables.get(variable)
    return found.unit if found is not None else ""


def _unit_of(of: str, descriptions: Mapping[str, Description]) -> str:
    """The unit of what a connection carries, all of them where the elements have several."""
    return ", ".join(sorted(unit for unit in _units(of, descriptions) if unit))


def _unit(found: Metric, group: Collection[str]) -> str:
    """The unit of a metric; variables of several units have none but where theirs play no part."""
    if len(group) > 1 and found.unit("a") != found.unit("b"):
        return ""
    return found.unit(next(iter(group), ""))


def _versions() -> dict[str, str]:
    versions = {"congelation": code_version(), "Python": platform.python_version()}
    for package in _PACKAGES:
        versions[package] = version(package)
    return {**versions, "platform": platform.platform()}
