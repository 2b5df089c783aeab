"""Provenance: what is kept with the rows of a study, so that a result directory explains itself."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from congelation.fmi.description import Description, describe
from congelation.results.identity import code_version
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import MetricSpec, Scenario

__all__ = ["about"]

_PACKAGES = ("fmpy", "pythonfmu", "numpy", "scipy", "pyarrow")


def about(scenario: Scenario, varied: Sequence[str]) -> dict[str, Any]:
    """Where the rows of a study come from and how to read them, representable in JSON.

    `varied` names the columns with the settings that differ between runs.
    """
    descriptions = {c.name: describe(c.fmu) for c in scenario.system.components}
    return {
        "title": scenario.title,
        "scenario_file": scenario.file.name,
        "scenario": scenario.text,
        "varied": list(varied),
        "metrics": {spec.name: _about_metric(spec, descriptions) for spec in scenario.metrics},
        "figures": [asdict(figure) for figure in scenario.figures],
        "fmus": {
            name: {"file": found.path.name, "sha256": found.sha256}
            for name, found in descriptions.items()
        },
        "versions": _versions(),
    }


def _about_metric(spec: MetricSpec, descriptions: Mapping[str, Description]) -> dict[str, Any]:
    component, _, name = spec.of.partition(".")
    group = {
        v.unit
        for v in (descriptions[component].variables.values() if component else ())
        if v.name == name or v.name.startswith(f"{name}[")
    }
    return {
        "metric": spec.metric,
        "of": spec.of or "the closed loop",
        "options": dict(spec.options),
        "definition": metric(spec.metric).definition,
        "unit": metric(spec.metric).unit(group.pop() if len(group) == 1 else ""),
    }


def _versions() -> dict[str, str]:
    versions = {"congelation": code_version(), "Python": platform.python_version()}
    for package in _PACKAGES:
        versions[package] = version(package)
    return {**versions, "platform": platform.platform()}
