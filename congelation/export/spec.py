"""A spec: the plant and the controller to build FMUs of, read from TOML.

    title = "System (60) with state feedback"
    form = "strict-feedback"

    [structure]                     # what the form is derived from
    n = 2
    p = 2
    phibar = {"1,1" = [-1, 0], "2,1" = [0, -1]}

    [units]                         # optional: one unit, or one for each element
    u = "V"
    x = ["rad/s", "A"]

    [plant]
    name = "StrictFeedbackPlant"    # of the FMU
    start = {x0 = [2, -1]}          # defaults of its parameters
    [plant.profile]                 # default theta(t)
    "theta[1]" = [{constant = -3}, {sine = {amplitude = 0.6, omega = 0.4}}]

    [controller]
    name = "StateFeedbackController"
    start = {c = [0.5, 0.5], epsilon = 0.3}

The forms and the keys of their structure:

    scalar             none
    matched            A, B: x' = A x + B (u + theta^T x)
    strict-feedback    n, p, phibar: (9), a table of the rows phibar_{i,j} that are not 0
    observer           n, m, filter: (27), with the "iss" or the "standard" K-filter
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from congelation.errors import nearest
from congelation.export.defaults import check_defaults
from congelation.export.equations import Special
from congelation.export.forms import FORMS, Form, Structure
from congelation.export.interface import ProfileSlots
from congelation.fmi.units import base_unit
from congelation.signals import Profile, Slots
from congelation.theory.model import Model
from congelation.toml import Section, read_document

__all__ = ["FmuSpec", "Spec", "read_spec"]

LARGEST_ORDER = 100
"""Of n, m and p: what the recursions derive outgrows any memory long before."""

Units = Mapping[str, str | list[str]]


@dataclass(frozen=True)
class FmuSpec:
    """One FMU to build.

    Attributes
    ----------
    name : str
        Of the FMU.
    folder : str
        Its folder in fmu_src, with its slave.
    model : Model
        With the defaults of the spec.
    special : Special or None
        The simpler equations that hold with neutral adaptation settings.
    profiles : tuple of ProfileSlots
        Of a plant: the default profile of each component of theta.
    """

    name: str
    folder: str
    model: Model
    special: Special | None = None
    profiles: tuple[ProfileSlots, ...] = ()


@dataclass(frozen=True)
class Spec:
    """What `read_spec` read; `form` and `structure` are what the models are derived from."""

    title: str
    form: str
    structure: Structure
    plant: FmuSpec
    controller: FmuSpec


def read_spec(file: Path) -> Spec:
    """Read a spec.

    Raises
    ------
    InvalidInput
        Naming the file, the path in it, and what would be valid.
    """
    _, top = read_document(file)
    top.only(("title", "form", "structure", "units", "plant", "controller")).require("form")
    name = top.text("form")
    if name not in FORMS:
        raise top.error("form", f"= '{name}' is not known; {nearest(name, FORMS)}")
    form = FORMS[name]
    structure = _structure(top.section("structure"), form)
    plant, controller, special = top.attempt("structure", lambda: form.models(structure))
    units = _units(top.section("units"), plant, controller)
    sections = top.section("plant"), top.section("controller")
    blocks = (
        _plant(sections[0], form.plant_folder, plant.with_units(units), file.parent),
        _block(sections[1], form.controller_folder, controller.with_units(units), special),
    )
    if blocks[0].name.lower() == blocks[1].name.lower():
        raise sections[1].error(
            "name", f"= '{blocks[1].name}' is the plant's too; give the two FMUs different names"
        )
    return Spec(top.text("title", file.stem), name, structure, *blocks)


def _structure(section: Section, form: Form) -> Structure:
    section.only(form.keys).require(*(key for key in form.keys if key not in form.optional))
    structure: dict[str, object] = dict(form.optional)
    for key in section.data:
        structure[key] = _READERS[key](section, key)
    return structure


def _order(section: Section, key: str) -> int:
    value = section.data[key]
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= LARGEST_ORDER:
        raise section.wrong(key, f"a whole number up to {LARGEST_ORDER}")
    return value


def _phibar(section: Section, key: str) -> list[list[list[float]]]:
    """phibar_{i,j} of (10) from a table ``"i,j" = [..p numbers..]``; those left out are 0."""
    n, p = _order(section, "n"), _order(section, "p")
    phibar = np.zeros((n, n, p))
    table = section.section(key)
    valid = [f"{i},{j}" for i in range(1, n + 1) for j in range(1, i + 1)]
    for place, value in table.only(valid).data.items():
        i, j = (int(part) - 1 for part in place.split(","))
        if not isinstance(value, list) or len(value) != p:
            raise table.wrong(place, f"{p} numbers")
        try:
            phibar[i, j] = value
        except (OverflowError, TypeError, ValueError):
            raise table.wrong(place, f"{p} numbers") from None
    rows: list[list[list[float]]] = phibar.tolist()
    return rows


def _numbers(section: Section, key: str) -> object:
    try:
        numbers = np.asarray(section.data[key], dtype=float)
    except (OverflowError, TypeError, ValueError):
        raise section.wrong(key, "numbers, or rows of numbers of one length") from None
    if not np.isfinite(numbers).all():
        raise section.wrong(key, "finite numbers")
    return numbers.tolist()


def _text(section: Section, key: str) -> str:
    return section.text(key)


_READERS = {
    "n": _order,
    "m": _order,
    "p": _order,
    "phibar": _phibar,
    "A": _numbers,
    "B": _numbers,
    "filter": _text,
}


def _units(section: Section, *models: Model) -> Units:
    """The units of variables by name; those of theta hold for its estimate too."""
    sizes: dict[str, int] = {}
    for model in models:
        groups = [i.variables for i in model.inputs] + [y.variables for y in model.outputs]
        groups += [] if model.theta is None else [model.theta]
        sizes.update({v.name: len(v.names) for v in groups})
    units: dict[str, str | list[str]] = {}
    for name, value in section.only(sizes).data.items():
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, list) or (value is names and len(names) != sizes[name]):
            raise section.wrong(name, f"a unit, or {sizes[name]} of them")
        for unit in map(str, names):
            section.attempt(name, partial(base_unit, unit or "1"))
        units[name] = value if isinstance(value, str) else [str(unit) for unit in names]
    return {"theta_hat": units["theta"], **units} if "theta" in units else units


def _block(section: Section, folder: str, model: Model, special: Special | None) -> FmuSpec:
    section.only(("name", "start"))
    name = section.text("name", model.name)
    if not name.isidentifier():
        raise section.wrong("name", "a C identifier: letters, digits and _")
    start = section.section("start")
    changed = start.attempt("", lambda: model.with_defaults(start.data))
    # An FMU whose own defaults it would refuse is not built.
    start.attempt("", lambda: check_defaults(model, start.data, special))
    return FmuSpec(name, folder, changed, special)


def _plant(section: Section, folder: str, model: Model, base: Path) -> FmuSpec:
    section.only(("name", "start", "profile"))
    own = {key: value for key, value in section.data.items() if key != "profile"}
    block = _block(Section(section.file, section.path, own), folder, model, None)
    names = model.theta.names if model.theta is not None else ()
    table = section.section("profile").only(names)
    profiles = tuple(_profile(table, name, base) for name in names)
    return replace(block, profiles=tuple(ProfileSlots(p, _slots(p)) for p in profiles))


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
