"""A spec: the plant and the controller to build FMUs of, read from TOML.

title = "System (60) with state feedback"
form = "strict-feedback"

[structure]                     # what the form is derived from
n = 2
p = 2
phibar = {"1,1" = [-1, 0], "2,1" = [0, -1]}

[plant]
name = "StrictFeedbackPlant"    # of the FMU
start = {x0 = [2, -1]}          # defaults of its parameters
[plant.profile]                 # default theta(t)
"theta[1]" = [{constant = -3}, {sine = {amplitude = 0.6, omega = 0.4}}]

[controller]
name = "StateFeedbackController"
start = {c = [0.5, 0.5], epsilon = 0.3}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from congelation.errors import nearest
from congelation.export.interface import ProfileSlots
from congelation.signals import Profile, Slots
from congelation.theory.model import Model
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.scalar import scalar_controller, scalar_plant
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import strict_feedback_plant
from congelation.toml import Section, read_document

__all__ = ["FORMS", "FmuSpec", "Form", "Spec", "models_of", "read_spec"]

Structure = Mapping[str, object]


@dataclass(frozen=True)
class Form:
    """A class of systems: the keys of its structure, its models, its folders in fmu_src."""

    keys: tuple[str, ...]
    plant: Callable[[Structure], Model]
    controller: Callable[[Structure], Model]
    plant_folder: str
    controller_folder: str


@dataclass(frozen=True)
class FmuSpec:
    """One FMU to build: its name, the folder with its slave, its model and default profiles."""

    name: str
    folder: str
    model: Model
    profiles: tuple[ProfileSlots, ...] = ()


@dataclass(frozen=True)
class Spec:
    """What `read_spec` read; `form` and `structure` are what the models are derived from."""

    title: str
    form: str
    structure: Structure
    plant: FmuSpec
    controller: FmuSpec


def _phibar(structure: Structure) -> np.ndarray:
    return np.asarray(structure["phibar"], dtype=float)


def _orders(structure: Structure) -> tuple[int, int]:
    return int(str(structure["n"])), int(str(structure["m"]))


FORMS: Mapping[str, Form] = {
    "scalar": Form(
        (),
        lambda s: scalar_plant(),
        lambda s: scalar_controller(),
        "scalar_plant",
        "scalar_controller",
    ),
    "strict-feedback": Form(
        ("n", "p", "phibar"),
        lambda s: strict_feedback_plant(_phibar(s)),
        lambda s: state_feedback_controller(_phibar(s)),
        "strict_feedback_plant",
        "state_feedback_controller",
    ),
    "observer": Form(
        ("n", "m"),
        lambda s: observer_form_plant(*_orders(s)),
        lambda s: output_feedback_controller(*_orders(s)),
        "observer_form_plant",
        "output_feedback_controller",
    ),
}


def models_of(form: str, structure: Structure) -> tuple[Model, Model]:
    """Plant and controller of a form, from its structure as `Spec` holds it."""
    return FORMS[form].plant(structure), FORMS[form].controller(structure)


def read_spec(file: Path) -> Spec:
    """Read a spec.

    Raises
    ------
    InvalidInput
        Naming the file, the path in it, and what would be valid.
    """
    _, top = read_document(file)
    top.only(("title", "form", "structure", "plant", "controller")).require("form")
    name = top.text("form")
    if name not in FORMS:
        raise top.error("form", f"= '{name}' is not known; {nearest(name, FORMS)}")
    form = FORMS[name]
    structure = _structure(top.section("structure"), form)
    plant, controller = top.attempt("structure", lambda: models_of(name, structure))
    return Spec(
        top.text("title", file.stem),
        name,
        structure,
        _plant(top.section("plant"), form.plant_folder, plant, file.parent),
        _block(top.section("controller"), form.controller_folder, controller),
    )


def _structure(section: Section, form: Form) -> Structure:
    section.only(form.keys).require(*form.keys)
    structure: dict[str, object] = {}
    for key in form.keys:
        if key == "phibar":
            structure[key] = _read_phibar(section)
        else:
            value = section.data[key]
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise section.wrong(key, "a whole number")
            structure[key] = value
    return structure


def _read_phibar(section: Section) -> list[list[list[float]]]:
    """phibar_{i,j} of (10) from a table ``"i,j" = [..p numbers..]``; those left out are 0."""
    n, p = (int(section.number(key)) for key in ("n", "p"))
    phibar = np.zeros((n, n, p))
    table = section.section("phibar")
    valid = [f"{i},{j}" for i in range(1, n + 1) for j in range(1, i + 1)]
    for key, value in table.only(valid).data.items():
        i, j = (int(part) - 1 for part in key.split(","))
        if not isinstance(value, list) or len(value) != p:
            raise table.wrong(key, f"{p} numbers")
        try:
            phibar[i, j] = value
        except (TypeError, ValueError):
            raise table.wrong(key, f"{p} numbers") from None
    rows: list[list[list[float]]] = phibar.tolist()
    return rows


def _block(section: Section, folder: str, model: Model) -> FmuSpec:
    section.only(("name", "start"))
    name = section.text("name", model.name)
    if not name.isidentifier():
        raise section.wrong("name", "a C identifier: letters, digits and _")
    start = section.section("start")
    return FmuSpec(name, folder, start.attempt("", lambda: model.with_defaults(start.data)))


def _plant(section: Section, folder: str, model: Model, base: Path) -> FmuSpec:
    section.only(("name", "start", "profile"))
    rest = Section(
        section.file,
        section.path,
        {key: value for key, value in section.data.items() if key != "profile"},
    )
    block = _block(rest, folder, model)
    names = model.theta.names if model.theta is not None else ()
    table = section.section("profile").only(names)
    profiles = tuple(_profile(table, name, base) for name in names)
    slotted = tuple(ProfileSlots(profile, _slots(profile)) for profile in profiles)
    return FmuSpec(block.name, folder, block.model, slotted)


def _profile(table: Section, name: str, base: Path) -> Profile:
    spec = table.data.get(name, 0.0)
    return table.attempt(name, lambda: Profile.from_spec(spec, "term", str(base)))


def _slots(profile: Profile) -> Slots:
    """The default room, more where the default profile needs it."""
    room = Slots()
    kinds = [term.kind for term in profile.terms]
    return Slots(
        max(room.sines, kinds.count("sine")),
        max(room.squares, kinds.count("square")),
        max(room.chirps, kinds.count("chirp")),
        max(room.telegraphs, kinds.count("telegraph")),
    )
