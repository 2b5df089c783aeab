"""What the theorem does not allow of the loops in a scenario's system."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import cast

from congelation.cosim.system import Component
from congelation.export.forms import fit, models_of
from congelation.export.spec_assumptions import degree_of, known_theta, of_rest, structured
from congelation.scenario.scenario import Case, Scenario
from congelation.theory.assumptions import Remark, remarks_on
from congelation.verify.loop_parts import spec_of, start_values_of, theta_of

__all__ = ["case_assumptions", "loops_of", "scenario_warnings"]

_ELEMENT = re.compile(r"(?P<name>\w+)(\[[\d,]+\])?")


def case_assumptions(case: Case) -> tuple[Remark, ...]:
    """The assumptions that the loops of a case break, and what cannot be known of them.

    A loop is a plant and a controller of one structure, both from build_fmu.py, of which the
    controller drives the plant. What is no such loop has no theorem, and no remarks.
    """
    driven = {c.target for c in case.system.connections}
    span = case.experiment.start_time, case.experiment.stop_time
    remarks = [remark for loop in loops_of(case) for remark in _of_loop(*loop, driven, span)]
    return tuple(sorted(remarks, key=lambda remark: not remark.broken))


def loops_of(case: Case) -> list[tuple[Component, Component]]:
    """Each plant with each controller of its structure that drives it, both from build_fmu.py."""
    about = {c.name: spec_of(c) for c in case.system.components}
    drives = {(c.source.split(".")[0], c.target) for c in case.system.connections}
    return [
        (plant, controller)
        for plant in case.system.components
        for controller in case.system.components
        if about[plant.name].get("role") == "plant"
        and about[controller.name].get("role") == "controller"
        and fit(about[plant.name], about[controller.name])
        and (controller.name, f"{plant.name}.u") in drives
    ]


def scenario_warnings(scenario: Scenario) -> tuple[str, ...]:
    """One line for each remark on a variant: where, what, and what would do."""
    lines = {
        f"{scenario.place}: {variant.name}: {remark}": None
        for variant in scenario.variants
        for remark in case_assumptions(scenario.case(variant.settings))
    }
    return tuple(lines)


def _of_loop(
    plant: Component, controller: Component, driven: set[str], span: tuple[float, float]
) -> tuple[Remark, ...]:
    profiles, offsets = theta_of(start_values_of(plant))
    inputs = {
        j
        for j in range(len(profiles))
        if {f"{plant.name}.dtheta", f"{plant.name}.dtheta[{j + 1}]"} & driven
    }
    # A profile that is 0, and that the scenario does not state, is one that nobody stated.
    absent = [
        j
        for j, profile in enumerate(profiles)
        if profile.bounds() == (0.0, 0.0)
        and not any(name.startswith(f"profile[{j + 1}].") for name in plant.start)
        and f"dtheta[{j + 1}]" not in plant.start
    ]

    about = spec_of(plant)

    def place(name: str) -> str:
        if name.startswith("theta["):
            return f'{plant.name}.profile."{name}"'
        return f"{controller.name}.{name}"

    known, split = known_theta(profiles, offsets, absent, inputs), None
    own = spec_of(controller)["structure"]
    if "Upsilon" in own:
        _, model = models_of(about["form"], about["structure"], own)
        split = structured(model, profiles, offsets, *span)
    return remarks_on(
        _parameters(start_values_of(controller)),
        known if split is None else of_rest(known, split),
        degree_of(about["form"], about["structure"]),
        place,
        varying_gain=about["structure"].get("gain") == "varying",
        constants=None if split is None else split.vartheta,
    )


def _parameters(values: Mapping[str, object]) -> dict[str, list[float]]:
    """Vectors from their elements ``c[1]``, ``c[2]``, .. in the order of the FMU."""
    grouped: dict[str, list[float]] = {}
    for name, value in values.items():
        match = _ELEMENT.fullmatch(name)
        if match is not None and not isinstance(value, str):
            grouped.setdefault(match["name"], []).append(float(cast(float, value)))
    return grouped
