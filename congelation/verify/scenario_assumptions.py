"""What the theorem does not allow of the loops in a scenario's system."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping
from typing import cast

from congelation.cosim.system import Component
from congelation.errors import InvalidInput, shown
from congelation.export.forms import fit, models_of
from congelation.export.spec_assumptions import degree_of, known_theta, of_rest, structured
from congelation.scenario.parts import Scalar
from congelation.scenario.scenario import Case, Scenario
from congelation.theory.assumptions import Remark, remarks_on
from congelation.verify.loop_parts import spec_of, start_values_of, theta_of

__all__ = ["case_assumptions", "loops_of", "scenario_warnings", "sweep_warnings"]

MOST_POINTS = 200
"""Points of a sweep that are looked at for each variant, 5 ms each; of more only the extremes."""

MOST_STRUCTURED = 20
"""The same of a law that knows Upsilon(t), for which vartheta is fitted at each point, in 0.1 s."""

MOST_NAMED = 4
"""Values of a setting that are named one by one."""

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


def sweep_warnings(scenario: Scenario) -> tuple[str, ...]:
    """One line for each assumption that points of the sweep break and their variant does not.

    Only points are looked at that differ in settings of theta(t) or of the controller. Where these
    are too many, those are with the least and the largest value of each setting, and the line does
    not say how many points there are.
    """
    if scenario.sweep is None:
        return ()
    said: dict[str, list[str]] = {}
    for variant in scenario.variants:
        case = scenario.case(variant.settings)
        names = _settings_that_matter(scenario.sweep.names(), case)
        if not names:
            continue
        known = {str(remark) for remark in case_assumptions(case)}
        sweep = scenario.sweep.of_variant(variant.name)
        names |= {name for constraint in sweep.constraints for name in constraint.names}
        knows_Upsilon = any("Upsilon" in spec_of(c)["structure"] for _, c in loops_of(case))
        most_points = MOST_STRUCTURED if knows_Upsilon else MOST_POINTS
        parts = list(sweep.parts(names, most_points))
        drawn = sweep.samples if any(axis.name in names for axis in sweep.axes) else 0
        every = max(drawn, math.prod(map(len, parts))) <= most_points
        if not every:
            parts = [_extremes(entries) for entries in parts]
        points: list[dict[str, Scalar]] = []
        broken: dict[str, list[tuple[Remark, dict[str, Scalar]]]] = {}
        for entries in itertools.islice(itertools.product(*parts), most_points):
            point = {name: value for entry in entries for name, value in entry.items()}
            try:
                if not sweep.holds(point):
                    continue
                remarks = case_assumptions(scenario.case({**variant.settings, **point}))
            except InvalidInput:  # the plan, or the record of the run, says it
                continue
            points.append(point)
            for remark in remarks:
                if remark.broken and str(remark) not in known:
                    broken.setdefault(remark.where, []).append((remark, point))
        for found in broken.values():
            worst = max((remark for remark, _ in found), key=lambda remark: remark.excess)
            share = f"{len(found)} of {len(points)} different points" if every else "points"
            where = _where([point for _, point in found], points)
            line = f"an assumption of the theorem is broken at {share} of the sweep{where}"
            most = ", at worst" if len(found) > 1 else ""
            said.setdefault(f"{line}{most}: {worst}", []).append(variant.name)
    return tuple(f"{scenario.place}: {', '.join(of)}: {line}" for line, of in said.items())


def _settings_that_matter(names: Collection[str], case: Case) -> set[str]:
    """Those of some settings that assumptions may be about: theta(t) and the controllers'."""
    found = set()
    for plant, controller in loops_of(case):
        owned = f"{plant.name}.profile[", f"{plant.name}.dtheta"
        gains = tuple(f"{controller.name}.{gain}" for gain in ("c[", "Gamma[", "epsilon"))
        for name in names:
            of_theta = name.startswith(owned) and not name.endswith((".seed", ".rate"))
            own = name.startswith(f"{controller.name}.") and not name.startswith(gains)
            if of_theta or own:
                found.add(name)
    return found


def _extremes(entries: list[dict[str, Scalar]]) -> list[dict[str, Scalar]]:
    """Of the entries those with the least and the largest value of each number."""
    ends: dict[int, dict[str, Scalar]] = {}
    for name in entries[0]:
        if all(isinstance(entry.get(name), int | float) for entry in entries):
            for extreme in (min, max):
                entry = extreme(entries, key=lambda entry: entry[name])
                ends[id(entry)] = entry
    return list(ends.values()) or entries


def _where(broken: list[dict[str, Scalar]], points: list[dict[str, Scalar]]) -> str:
    """The settings whose values tell the points that break an assumption from the others."""
    said = []
    for name in points[0]:
        values = list(dict.fromkeys(point[name] for point in broken if name in point))
        if len(values) == len({point[name] for point in points if name in point}):
            continue
        ordered = sorted(values, key=lambda v: (isinstance(v, str), v))
        texts = [f"{v:.6g}" if isinstance(v, float) else shown(v) for v in ordered]
        if len(texts) > MOST_NAMED:
            texts = [f"{texts[0]} to {texts[-1]}"]
        said.append(f"{name} = {' or '.join(texts)}")
    return f" ({', '.join(said)})" if said else ""


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
