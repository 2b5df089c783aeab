"""The classes of systems that FMUs can be built for, and how their models are derived."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from congelation.errors import InvalidInput, nearest
from congelation.export.equations import Special
from congelation.signals import Slots
from congelation.theory.adaptation import NEUTRAL, AdaptationFactory, gradient, robust
from congelation.theory.blocks import delay, disturbance, lag, noise, reference, saturation
from congelation.theory.filtered_transformation import filtered_transformation_controller
from congelation.theory.kfilter import FilterFactory, iss_filter, standard_filter
from congelation.theory.matching import matched_controller, matched_plant
from congelation.theory.model import Model
from congelation.theory.observer_form import observer_form_plant
from congelation.theory.options import Options
from congelation.theory.output_feedback import output_feedback_controller
from congelation.theory.scalar import scalar_controller, scalar_plant
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import Nonlinear, Regressors, strict_feedback_plant

__all__ = ["BLOCKS", "FORMS", "BlockForm", "Form", "Structure", "fit", "models_of"]

Structure = Mapping[str, Any]
"""What a form is derived from, as numbers and lists: it goes into FMUs as JSON."""

FILTERS: Mapping[str, FilterFactory] = {"iss": iss_filter, "standard": standard_filter}


@dataclass(frozen=True)
class Form:
    """A class of systems.

    Attributes
    ----------
    keys : tuple of str
        What its structure holds.
    plant, controller : callable
        From the structure to the model; the controller takes the law of its estimates too.
    optional : mapping
        Keys that may be left out, and what they then are; None: they stay out.
    law : tuple of str
        Keys that say what the law copes with: a plant goes with any of them.
    """

    keys: tuple[str, ...]
    plant: Callable[[Structure], Model]
    controller: Callable[[Structure, AdaptationFactory], Model]
    optional: Mapping[str, object] = field(default_factory=dict)
    law: tuple[str, ...] = ()

    def models(self, structure: Structure) -> tuple[Model, Model, Special | None]:
        """Plant, controller with every adaptation law, and its special case without them.

        None where the controller has adaptation laws of its own.
        """
        general = self.controller(structure, robust)
        names = {parameter.variables.name for parameter in general.parameters}
        plain = None
        if names.issuperset(NEUTRAL):
            plain = Special(self.controller(structure, gradient), NEUTRAL)
        return self.plant(structure), general, plain


@dataclass(frozen=True)
class BlockForm:
    """A class of blocks that stand beside a plant and a controller.

    Attributes
    ----------
    keys : tuple of str
        What its structure holds.
    model : callable
        From the structure to the model.
    run_time : str
        See `congelation.export.spec.FmuSpec`.
    optional : mapping
        Keys that may be left out, and what they then are.
    room : Slots
        How many terms its profiles have room for.
    """

    keys: tuple[str, ...]
    model: Callable[[Structure], Model]
    run_time: str
    optional: Mapping[str, object] = field(default_factory=dict)
    room: Slots = field(default_factory=Slots)


def models_of(form: str, plant: Structure, controller: Structure) -> tuple[Model, Model]:
    """A plant and a controller of a form, from the structures that their specs gave."""
    return FORMS[form].plant(plant), FORMS[form].controller(controller, robust)


def fit(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether a plant and a controller, by what their FMUs tell of them, are of one system."""

    def system(about: Mapping[str, Any]) -> dict[str, Any]:
        law = FORMS[about["form"]].law if about["form"] in FORMS else ()
        return {key: value for key, value in about["structure"].items() if key not in law}

    return bool(one["form"] == other["form"]) and system(one) == system(other)


def _order(structure: Structure, key: str) -> int:
    return int(structure[key])


def _filter(structure: Structure) -> FilterFactory:
    name = str(structure.get("filter", "iss"))
    if name not in FILTERS:
        raise InvalidInput(f"filter = '{name}' is not known; {nearest(name, FILTERS)}")
    return FILTERS[name]


def _regressors(structure: Structure) -> Regressors | Any:
    """phibar of (10), or the nonlinear regressors phi."""
    if ("phi" in structure) == ("phibar" in structure):
        raise InvalidInput(
            "phibar and phi are two ways to give the regressors; give one: phibar for a linear "
            "plant, phi for formulas in x[1] .. x[n]"
        )
    if "phibar" in structure:
        return structure["phibar"]
    return Nonlinear(tuple(tuple(row) for row in structure["phi"]))


def _options(structure: Structure) -> Options:
    return Options(
        tracking=bool(structure.get("tracking", False)),
        varying_gain=structure.get("gain", "constant") == "varying",
        unknown_radius=structure.get("radius", "known") == "estimated",
        bound_estimator=structure.get("law", "congelation") == "bound-estimator",
        disturbance=bool(structure.get("disturbance", False)),
        Upsilon=tuple(tuple(row) for row in structure.get("Upsilon", ())),
    )


def _output_feedback(structure: Structure, law: AdaptationFactory) -> Model:
    """The controller of the observer form, by the law that its structure names."""
    n, m, options = _order(structure, "n"), _order(structure, "m"), _options(structure)
    name = structure.get("law", "congelation")
    if name == "filtered-transformation":
        if structure.keys() & {"tracking", "radius", "gain", "disturbance"}:
            raise InvalidInput(
                "law = 'filtered-transformation' is a regulator that knows no radius; leave out "
                "tracking, radius, gain and disturbance (docs/rivals.md)"
            )
        return filtered_transformation_controller(n, m)
    _check_law(name, "observer", ("congelation", "filtered-transformation"))
    return output_feedback_controller(n, m, law, _filter(structure), options)


def _state_feedback(structure: Structure, law: AdaptationFactory) -> Model:
    """The controller of the strict-feedback form."""
    name = structure.get("law", "congelation")
    _check_law(name, "strict-feedback", ("congelation", "bound-estimator"))
    return state_feedback_controller(_regressors(structure), law, _options(structure))


def _check_law(name: str, form: str, offered: tuple[str, ...]) -> None:
    if name not in offered:
        raise InvalidInput(f"law = '{name}' is none of form '{form}'; {nearest(name, offered)}")


_LAW = ("tracking", "radius", "law", "disturbance")
"""Keys that say what a law copes with. A disturbed plant has an input more; it goes with the law of
an undisturbed one, and the other way round."""

FORMS: Mapping[str, Form] = {
    "scalar": Form(
        (),
        lambda s: scalar_plant(),
        lambda s, law: scalar_controller(law),
    ),
    "matched": Form(
        ("A", "B"),
        lambda s: matched_plant(s["A"], s["B"]),
        lambda s, law: matched_controller(s["A"], s["B"], law),
    ),
    "strict-feedback": Form(
        ("n", "p", "phibar", "phi", "gain", *_LAW, "Upsilon"),
        lambda s: strict_feedback_plant(
            _regressors(s), _options(s).varying_gain, _options(s).disturbance
        ),
        _state_feedback,
        dict.fromkeys(("phibar", "phi", "gain", *_LAW, "Upsilon")),
        (*_LAW, "Upsilon"),
    ),
    "observer": Form(
        ("n", "m", "filter", "gain", *_LAW),
        lambda s: observer_form_plant(_order(s, "n"), _order(s, "m"), _options(s).disturbance),
        _output_feedback,
        {"filter": "iss", **dict.fromkeys(("gain", *_LAW))},
        ("filter", *_LAW),
    ),
}


def _sized(model: Callable[[int], Model], run_time: str, room: Slots | None = None) -> BlockForm:
    """The form of blocks of `size` equal signals."""
    return BlockForm(
        ("size",), lambda s: model(_order(s, "size")), run_time, {"size": 1}, room or Slots()
    )


BLOCKS: Mapping[str, BlockForm] = {
    "reference": BlockForm(
        ("n", "sines"),
        lambda s: reference(_order(s, "n"), _order(s, "sines")),
        "driven",
        {"sines": 2},
    ),
    "disturbance": _sized(disturbance, "driven"),
    "noise": _sized(noise, "driven", Slots(noises=1)),
    "saturation": _sized(saturation, "block"),
    "lag": _sized(lag, "block"),
    "delay": _sized(delay, "delay"),
}
