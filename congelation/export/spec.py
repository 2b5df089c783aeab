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
    strict-feedback    n, p, phibar: (9), a table of the rows phibar_{i,j} that are not 0;
                       or phi: formulas, {1 = ["x[1]**2", "sin(x[1])"]}, p in each row;
                       gain = "varying": the input gain b(t) is the last element of theta;
                       tracking, radius = "estimated", disturbance: what the law is to cope
                       with; a disturbed plant has the inputs d[1] .. d[n];
                       Upsilon: formulas in t of what is known of theta(t),
                       {1 = ["1", "sin(2*t)"]}, as many in each of p rows;
                       law = "bound-estimator": a rival of congelation
    observer           n, m, filter: (27), with the "iss" or the "standard" K-filter;
                       tracking, radius, disturbance as above;
                       law = "filtered-transformation": a rival

A block to put between them, or to drive them with, is a spec of one FMU:

    form = "reference"

    [structure]
    n = 2

    [block]
    name = "Reference"
    start = {amplitude = [1, 0]}
    [block.profile]
    r = [{square = {amplitude = 1, period = 20}}]

The forms of blocks, and the keys of their structure:

    reference          n, sines: yr[0] .. yr[n], a signal and its derivatives
    disturbance        size: d[1] .. d[size], from profiles
    noise              size: y = u + n(t), sampled random numbers
    saturation         size: y = u within the limits
    lag                size: T y' = gain u - y
    delay              size: y(t) = u(t - delay)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from congelation import keys
from congelation.errors import InfeasibleDesign, InvalidInput, amount, shown
from congelation.export.equations import Special
from congelation.export.forms import BLOCKS, FORMS, BlockForm, Form, Structure
from congelation.export.interface import ProfileSlots, profiled_names
from congelation.export.spec_units import read_units
from congelation.signals import Profile, Slots
from congelation.theory.model import Model
from congelation.theory.values import complete_values
from congelation.toml import Section, read_document

__all__ = ["BlockSpec", "FmuSpec", "Role", "Spec", "read_buildable", "read_spec"]

Role = Literal["plant", "controller", "block"]


@dataclass(frozen=True)
class FmuSpec:
    """One FMU to build.

    Attributes
    ----------
    name : str
        Of the FMU.
    model : Model
        With the defaults of the spec.
    special : Special or None
        The simpler equations that hold with neutral adaptation settings.
    profiles : tuple of ProfileSlots
        The default profile of each component of theta, or of each signal of a block.
    stated : frozenset of str
        The parameters, and what has a profile, that the spec gives a value or a profile.
    role : str
    run_time : str
        The module of fmu_src/python whose class of the same name the FMU's slave is.
    """

    name: str
    model: Model
    special: Special | None = None
    profiles: tuple[ProfileSlots, ...] = ()
    stated: frozenset[str] = frozenset()
    role: Role = "controller"
    run_time: str = "block"


@dataclass(frozen=True)
class Spec:
    """What to build FMUs of: a spec that was read and checked.

    Attributes
    ----------
    name : str
        Of the file, without its suffix.
    title : str
        Of the system, for people.
    form : str
        The class of systems, such as ``strict-feedback``.
    structure : mapping
        What the models are derived from: the keys of ``[structure]``.
    plant : FmuSpec
    controller : FmuSpec

    Examples
    --------
    >>> spec = cg.Spec.read("specs/scalar.toml")
    >>> [fmu.name for fmu in spec.fmus]
    ['ScalarPlant', 'ScalarController']
    """

    name: str
    title: str
    form: str
    structure: Structure
    plant: FmuSpec
    controller: FmuSpec

    @classmethod
    def read(cls, file: Path | str) -> Spec:
        """The spec that a file holds; `InvalidInput` says what is wrong in it."""
        return read_spec(Path(file))

    @property
    def fmus(self) -> tuple[FmuSpec, ...]:
        """What to build."""
        return self.plant, self.controller


@dataclass(frozen=True)
class BlockSpec:
    """What to build a block of, as `read_buildable` read it; its attributes are those of `Spec`."""

    name: str
    title: str
    form: str
    structure: Structure
    block: FmuSpec

    @property
    def fmus(self) -> tuple[FmuSpec, ...]:
        """What to build."""
        return (self.block,)


class IsBlock(InvalidInput):
    """A spec is that of a block, where one of a plant and its controller is asked for."""


def read_spec(file: Path) -> Spec:
    """Read the spec of a plant and its controller.

    Raises
    ------
    InvalidInput
        Naming the file, the path in it, and what would be valid; `IsBlock` where it is of a block.
    """
    spec = read_buildable(file)
    if isinstance(spec, BlockSpec):
        raise IsBlock(
            f"{file}: this is the spec of a block ({spec.form}), which can be built only; give "
            "that of a plant and its controller"
        )
    return spec


def read_buildable(file: Path) -> Spec | BlockSpec:
    """Read a spec, of a plant and its controller or of a block.

    Raises
    ------
    InvalidInput
        Naming the file, the path in it, and what would be valid.
    """
    _, top = read_document(file, "spec")
    if "components" in top.data and "form" not in top.data:
        raise InvalidInput(f"{file}: this is a scenario (congelation run {file}); give a spec")
    read = top.read(keys.SPEC)
    name: str = read["form"]
    title = read["title"] or file.stem
    unfit = ("plant", "controller") if name in BLOCKS else ("block",)
    for key in unfit:
        if key in top.data:
            what = "a block" if name in BLOCKS else "a plant and its controller"
            raise top.error(key, f"does not belong to the form '{name}', which is {what}")
    return (_block_spec if name in BLOCKS else _pair_spec)(file, top, read, name, title)


def _block_spec(
    file: Path, top: Section, read: Mapping[str, Any], form: str, title: str
) -> BlockSpec:
    block = BLOCKS[form]
    structure = _structure(read["structure"], block)
    model = top.attempt("structure", lambda: block.model(structure))
    measured = model.with_units(read_units(read["units"], form, structure, model))
    fmu = _profiled(read["block"], measured, file.parent, block.room)
    fmu = replace(fmu, role="block", run_time=block.run_time)
    return BlockSpec(file.stem, title, form, structure, fmu)


def _pair_spec(file: Path, top: Section, read: Mapping[str, Any], form: str, title: str) -> Spec:
    structure = _structure(read["structure"], FORMS[form])
    models = top.attempt("structure", lambda: FORMS[form].models(structure))
    plant_model, controller_model, special = models
    units = read_units(read["units"], form, structure, plant_model, controller_model)
    section: Section = read["controller"]
    start = section.section("start")
    if structure.get("radius") == "estimated" and "delta" in start.data:
        raise start.error(
            "delta",
            'is given, while radius = "estimated"; leave one of them out (docs/theory.md, '
            "'Unknown radius')",
        )
    plant = _profiled(read["plant"], plant_model.with_units(units), file.parent)
    plant = replace(plant, role="plant", run_time="driven")
    controller = _block(section, controller_model.with_units(units), special)
    if plant.name.lower() == controller.name.lower():
        raise section.error(
            "name", f"= '{controller.name}' is the plant's too; give the two FMUs different names"
        )
    return Spec(file.stem, title, form, structure, plant, controller)


def _structure(section: Section, form: Form | BlockForm) -> Structure:
    section.only(form.keys).require(*(key for key in form.keys if key not in form.optional))
    structure = {key: value for key, value in form.optional.items() if value is not None}
    for key in section.data:
        value = section.value(keys.STRUCTURE[key])
        reader = _READERS.get(key)
        structure[key] = value if reader is None else reader(section, key)
    return structure


def _phibar(section: Section, key: str) -> list[list[list[float]]]:
    """phibar_{i,j} of (10) from a table ``"i,j" = [..p numbers..]``; those left out are 0."""
    n, p = (section.value(keys.STRUCTURE[name]) for name in ("n", "p"))
    phibar = np.zeros((n, n, p))
    table = section.section(key)
    valid = [f"{i},{j}" for i in range(1, n + 1) for j in range(1, i + 1)]
    for place, value in table.only(valid).data.items():
        i, j = (int(part) - 1 for part in place.split(","))
        if not isinstance(value, list) or len(value) != p:
            raise table.wrong(place, amount((p,)))
        try:
            phibar[i, j] = value
        except (OverflowError, TypeError, ValueError):
            raise table.wrong(place, amount((p,))) from None
    rows: list[list[list[float]]] = phibar.tolist()
    return rows


def _phi(section: Section, key: str) -> list[list[str]]:
    """phi_i from a table ``i = [..p formulas..]``; those left out are 0."""
    n, p = (section.value(keys.STRUCTURE[name]) for name in ("n", "p"))
    table = section.section(key).only([str(i) for i in range(1, n + 1)])
    rows = [["0"] * p for _ in range(n)]
    for place, value in table.data.items():
        if not isinstance(value, list) or len(value) != p:
            raise table.wrong(place, f'{p} formulas, such as "x[1]**2"')
        rows[int(place) - 1] = [str(formula) for formula in value]
    return rows


def _upsilon(section: Section, key: str) -> list[list[str]]:
    """Upsilon(t) from a table ``i = [..q formulas..]`` with the rows 1 .. p."""
    p = section.value(keys.STRUCTURE["p"])
    places = [str(i) for i in range(1, p + 1)]
    table = section.section(key).only(places).require(*places)
    rows: list[list[str]] = []
    for place in places:
        value = table.data[place]
        if not isinstance(value, list) or not value or (rows and len(value) != len(rows[0])):
            raise table.wrong(place, 'formulas such as "sin(2*t)", as many in each row')
        rows.append([str(formula) for formula in value])
    return rows


def _numbers(section: Section, key: str) -> object:
    try:
        numbers = np.asarray(section.data[key], dtype=float)
    except (OverflowError, TypeError, ValueError):
        raise section.wrong(key, "numbers, or rows of numbers of one length") from None
    if not np.isfinite(numbers).all():
        raise section.wrong(key, "finite numbers")
    return numbers.tolist()


_READERS = {"phibar": _phibar, "phi": _phi, "Upsilon": _upsilon, "A": _numbers, "B": _numbers}


def _block(section: Section, model: Model, special: Special | None) -> FmuSpec:
    read = section.read(keys.CONTROLLER)
    name: str = read["name"] or model.name
    if not name.isidentifier():
        raise section.wrong("name", "a C identifier: letters, digits and _")
    start: Section = read["start"]
    for key, value in start.data.items():
        if isinstance(value, Mapping):
            raise start.error(
                key,
                f"= {shown(value)} is not valid; give numbers alone: a spec takes them in the "
                "units of its table [units], and times in seconds",
            )
    changed = start.attempt("", lambda: model.with_defaults(start.data))
    # An FMU whose own defaults it would refuse is not built.
    start.attempt("", lambda: _check_defaults(model, start.data, special))
    return FmuSpec(name, changed, special, stated=frozenset(start.data))


def _profiled(section: Section, model: Model, base: Path, room: Slots | None = None) -> FmuSpec:
    """The FMU of a model with profiles, which have `room` for terms at least."""
    profile: Section = section.read(keys.PLANT)["profile"]
    block = _block(section.without("profile"), model, None)
    names = profiled_names(model)
    table = profile.only(names)
    profiles = tuple(_profile(table, name, base) for name in names)
    slots = tuple(
        ProfileSlots(p, (room or Slots()) | Slots.of(term.kind for term in p.terms))
        for p in profiles
    )
    return replace(block, profiles=slots, stated=block.stated.union(table.data))


def _profile(table: Section, name: str, base: Path) -> Profile:
    spec = table.data.get(name, 0.0)
    return table.attempt(name, lambda: Profile.from_spec(spec, "term", str(base)))


def _check_defaults(
    model: Model, given: Mapping[str, object], special: Special | None = None
) -> None:
    """Refuse defaults with which an FMU would refuse itself.

    Parameters
    ----------
    model : Model
        With the defaults of its form.
    given : mapping
        The spec's own, as `Model.with_defaults` takes them.
    special : Special, optional
        The equations that take the place of the model's at some values.

    Raises
    ------
    InvalidInput
        If a value is outside its domain, a gain does not exist, or the rates and outputs at the
        start are not finite; the text names the values without which they are.
    """
    try:
        lost = _not_finite(model.with_defaults(given), special)
    except InfeasibleDesign as error:
        # r = 3 is a default: its user has to know that there is such a parameter.
        if str(error).partition(" = ")[0] in {p.variables.name for p in model.parameters} - {
            *given
        }:
            raise InfeasibleDesign(f"it is left out, and so {error}") from None
        raise
    if not lost:
        return
    culprits = [name for name in given if _mends(model, given, name, special)] or list(given)
    named = ", ".join(f"{name} = {shown(given[name])}" for name in culprits)
    raise InvalidInput(
        f"{named} cannot be used: {', '.join(lost)} would not be finite at the start; "
        "give values that are neither as large nor as small"
    )


def _mends(model: Model, given: Mapping[str, object], name: str, special: Special | None) -> bool:
    """Whether everything is finite without the given value of `name`."""
    fewer = {key: value for key, value in given.items() if key != name}
    try:
        return not _not_finite(model.with_defaults(fewer), special)
    except InvalidInput:
        return False


def _not_finite(model: Model, special: Special | None) -> list[str]:
    """Names of the rates, outputs and their derivatives that are not finite at the start."""
    values = complete_values(model)
    is_special = special is not None and all(
        values[name] == value for name, value in special.values.items()
    )
    used = special.model if special is not None and is_special else model
    start = {s.variables.name: s.start for s in model.states}
    named = {f"der({s.variables.name})": s.rate for s in used.states}
    for output in used.outputs:
        symbol, name = output.variables.symbol, output.variables.name
        named[name] = symbol
        if output.differentiated:
            named[f"der({name})"] = used.total_derivative(symbol)
    numbers = used.evaluate(list(named.values()), {**values, **start})
    return [name for name, n in zip(named, numbers, strict=True) if not np.isfinite(n).all()]
