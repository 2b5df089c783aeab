"""The parts of a loop: which components of a system they are, and what their FMUs carry.

Every FMU of `congelation build` has the structure that its equations were derived from in
``resources/spec.json``.
"""

from __future__ import annotations

import itertools
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.system import Component, System
from congelation.errors import InvalidInput
from congelation.export.forms import BLOCKS, fit, models_of
from congelation.fmi.description import describe
from congelation.fmi.start_values import resolve_start
from congelation.scenario.parts import Scalar
from congelation.signals import Profile
from congelation.theory.model import Model

__all__ = ["Part", "driven_by", "loop_parts", "spec_of", "start_values_of", "theta_of"]

Floats = npt.NDArray[np.float64]

_ROLES = ("plant", "controller")


def spec_of(component: Component) -> dict[str, Any]:
    """The spec that the component's FMU was built from; empty if it has none."""
    with zipfile.ZipFile(component.fmu) as archive:
        if "resources/spec.json" not in archive.namelist():
            return {}
        spec: dict[str, Any] = json.loads(archive.read("resources/spec.json"))
    return spec if {"role", "form", "structure"} <= spec.keys() else {}


def _required_spec(component: Component) -> dict[str, Any]:
    """The same, or InvalidInput."""
    if spec := spec_of(component):
        return spec
    raise InvalidInput(
        f"{component.fmu.name} has no resources/spec.json; only FMUs of `congelation build` "
        "have one"
    )


@dataclass(frozen=True)
class Part:
    """A component of a loop: its model, derived anew, and the values that it starts with."""

    name: str
    model: Model
    values: Mapping[str, Scalar]

    @property
    def parameters(self) -> dict[str, Floats]:
        """The parameters of its model by name."""
        return {
            p.variables.name: np.array([float(self.values[n]) for n in p.variables.names])
            for p in self.model.parameters
        }


def loop_parts(system: System) -> tuple[Part, Part, tuple[Part, ...]]:
    """The plant, the controller, and the blocks that a reference or a disturbance comes from."""
    about = {component.name: _required_spec(component) for component in system.components}
    roles = {about[component.name]["role"]: component for component in system.components}
    blocks = [c for c in system.components if about[c.name]["form"] in ("reference", "disturbance")]
    references = [c for c in blocks if about[c.name]["form"] == "reference"]
    alone = len(system.components) == 2 + len(blocks) and len(references) <= 1
    if not alone or not set(_ROLES) <= set(roles):
        names = ", ".join(component.name for component in system.components)
        raise InvalidInput(
            "a plant and its controller are needed, one Reference at most, and Disturbances, not "
            f"{names}"
        )
    pair = [roles[role] for role in _ROLES]
    plant, controller = (about[component.name] for component in pair)
    if not fit(plant, controller):
        raise InvalidInput(
            f"{pair[0].name} and {pair[1].name} are of different systems; take a plant and a "
            "controller of one spec, or of specs that differ in the law alone"
        )
    models = [*models_of(plant["form"], plant["structure"], controller["structure"])]
    for block in blocks:
        spec = about[block.name]
        models.append(BLOCKS[spec["form"]].model(spec["structure"]))
    first, second, *others = (
        Part(component.name, model, start_values_of(component))
        for component, model in zip([*pair, *blocks], models, strict=True)
    )
    return first, second, tuple(others)


def driven_by(
    system: System, plant: Part, controller: Part, blocks: Sequence[Part]
) -> dict[str, dict[str, str]]:
    """The elements of inputs that each block drives, and the elements of outputs that drive them.

    The monolithic loop connects equal names both ways, and all of a reference; the system has to
    do just that.
    """
    wanted: set[str] = set()
    outside: dict[str, tuple[str, str]] = {}
    for one, other in ((controller, plant), (plant, controller)):
        for entry in other.model.inputs:
            names = entry.variables.names
            if entry.source == "loop":
                wanted |= {f"{one.name}.{name} -> {other.name}.{name}" for name in names}
            else:
                outside |= {f"{other.name}.{name}": (name, entry.source) for name in names}
    driven: dict[str, dict[str, str]] = {block.name: {} for block in blocks}
    given, following = set(), ""
    for link in system.resolve().links:
        if link.converts:
            raise InvalidInput(
                f"connection '{link.name}' converts units, which the equations do not: give "
                "both blocks one unit"
            )
        source, _, target = link.name.partition(" -> ")
        block, _, output = source.partition(".")
        if block not in driven or target not in outside:
            given.add(link.name)
            continue
        name, kind = outside[target]
        driven[block][name] = output
        if kind == "reference":
            following = block
            given.add(link.name)
    if following:
        references = (target for target, (_, kind) in outside.items() if kind == "reference")
        wanted |= {f"{following}.{outside[target][0]} -> {target}" for target in references}
    for name in sorted(wanted ^ given):
        verb = "is missing" if name in wanted else "is none of the loop's"
        raise InvalidInput(f"connection '{name}' {verb}")
    return driven


def start_values_of(component: Component) -> dict[str, Scalar]:
    """The value of every variable of an FMU that starts with one: given, or else its own."""
    description = describe(component.fmu)
    own = {
        v.name: _typed(v.type, v.default)
        for v in description.variables.values()
        if v.default or v.type == "String"
    }
    start = resolve_start(description, component.start, f"component '{component.name}'")
    return {**own, **{item.variable.name: item.value for item in start}}


def _typed(kind: str, text: str) -> Scalar:
    if kind == "Boolean":
        return text in ("true", "1")
    if kind == "Integer":
        return int(text)
    return text if kind == "String" else float(text)


def theta_of(values: Mapping[str, Scalar]) -> tuple[list[Profile], list[float]]:
    """The profile of each component of theta, and the constant that is added to it."""
    profiles: list[Profile] = []
    offsets: list[float] = []
    for j in itertools.count(1):
        prefix = f"profile[{j}]."
        flat = {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)}
        if not flat:
            break
        profiles.append(Profile.from_flat(flat))
        offsets.append(float(values.get(f"dtheta[{j}]", 0.0)))
    return profiles, offsets
