"""What the theorem does not allow of the loops in a scenario's system."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Mapping
from typing import Any, cast

from congelation.cosim.system import Component
from congelation.export.assumptions import degree_of, known_theta
from congelation.scenario.scenario import Case
from congelation.theory.assumptions import Remark, remarks_on
from congelation.verify.reference import start_values_of, theta_of

__all__ = ["case_assumptions", "case_warnings"]

_ELEMENT = re.compile(r"(?P<name>\w+)(\[[\d,]+\])?")


def case_assumptions(case: Case) -> tuple[Remark, ...]:
    """The assumptions that the loops of a case break, and what cannot be known of them.

    A loop is a plant and a controller of one structure, both from build_fmu.py, of which the
    controller drives the plant. What is no such loop has no theorem, and no remarks.
    """
    about = {c.name: _about(c) for c in case.system.components}
    links = [
        (*str(c).split(" -> ")[0].split(".", 1), *str(c).split(" -> ")[1].split(".", 1))
        for c in case.system.connections
    ]
    remarks: list[Remark] = []
    for plant in case.system.components:
        own = about[plant.name]
        if own is None or own["role"] != "plant":
            continue
        drivers = {source for source, _, target, name in links if (target, name) == (plant.name, "u")}
        controllers = [c for c in case.system.components if c.name in drivers]
        for controller in controllers:
            other = about[controller.name]
            if other is not None and other["role"] == "controller" and _same(own, other):
                driven = {name for _, _, target, name in links if target == plant.name}
                remarks += _of_loop(plant, controller, own, driven)
    return tuple(sorted(remarks, key=lambda remark: not remark.broken))


def case_warnings(case: Case) -> tuple[str, ...]:
    """One line for each remark on a case: where, what, and what would do."""
    return tuple(str(remark) for remark in case_assumptions(case))


def _of_loop(
    plant: Component, controller: Component, about: Mapping[str, Any], driven: set[str]
) -> tuple[Remark, ...]:
    profiles, offsets = theta_of(start_values_of(plant))
    inputs = {j for j in range(len(profiles)) if {"dtheta", f"dtheta[{j + 1}]"} & driven}
    # A profile that is 0, and that the scenario does not state, is one that nobody stated.
    absent = [
        j
        for j, profile in enumerate(profiles)
        if profile.bounds() == (0.0, 0.0)
        and not any(name.startswith(f"profile[{j + 1}].") for name in plant.start)
        and f"dtheta[{j + 1}]" not in plant.start
    ]

    def place(name: str) -> str:
        if name.startswith("theta["):
            return f'{plant.name}.profile."{name}"'
        return f"{controller.name}.{name}"

    return remarks_on(
        _parameters(start_values_of(controller)),
        known_theta(profiles, offsets, absent, inputs),
        degree_of(about["form"], about["structure"]),
        place,
    )


def _about(component: Component) -> dict[str, Any] | None:
    """The spec that the component's FMU was built from, if it has one."""
    with zipfile.ZipFile(component.fmu) as archive:
        if "resources/spec.json" not in archive.namelist():
            return None
        about: dict[str, Any] = json.loads(archive.read("resources/spec.json"))
    return about if {"role", "form", "structure"} <= about.keys() else None


def _same(plant: Mapping[str, Any], controller: Mapping[str, Any]) -> bool:
    return all(plant[key] == controller[key] for key in ("form", "structure"))


def _parameters(values: Mapping[str, object]) -> dict[str, list[float]]:
    """Vectors from their elements ``c[1]``, ``c[2]``, .. in the order of the FMU."""
    grouped: dict[str, list[float]] = {}
    for name, value in values.items():
        match = _ELEMENT.fullmatch(name)
        if match is not None and not isinstance(value, str):
            grouped.setdefault(match["name"], []).append(float(cast(float, value)))
    return grouped
