"""Verification: the closed loop of a run solved as one differential equation, by other means.

Every FMU of `congelation build` carries the structure that its equations were derived from, in
``resources/spec.json``. From it the theory derives plant and controller anew, closes the loop
without any co-simulation, and scipy solves it to 1e-12, stopping at every jump of theta(t).
"""

from __future__ import annotations

import itertools
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import numpy.typing as npt

from congelation.arguments import checked
from congelation.cosim.result import Result
from congelation.cosim.system import Component, System
from congelation.errors import CongelationError, InvalidInput
from congelation.export.forms import BLOCKS, fit, models_of
from congelation.export.interface import start_names
from congelation.fmi.description import describe
from congelation.fmi.start_values import resolve_start
from congelation.results.record import Trajectory
from congelation.scenario.parts import Case, Experiment, Scalar
from congelation.signals import Profile, Segment
from congelation.theory.closed_loop import ClosedLoop, SmoothPiece, Source, close
from congelation.theory.model import Model, Output, Variables

__all__ = [
    "LARGEST_DEVIATION",
    "Deviation",
    "Reference",
    "compare",
    "reference",
    "start_values_of",
    "theta_of",
    "verify",
]

Floats = npt.NDArray[np.float64]

LARGEST_DEVIATION = 1e-3
"""A co-simulation further than this from the monolithic solution, relative to a variable's peak,
does not count as a solution of the loop: such a curve differs visibly in print."""

_ROLES = ("plant", "controller")


@dataclass(frozen=True)
class Deviation:
    """The largest error of one variable of a run.

    Parameters
    ----------
    variable : str
        ``component.variable``.
    error : float
        max_t |co-simulated - monolithic|.
    relative : float
        `error` divided by max_t |monolithic|.
    """

    variable: str
    error: float
    relative: float


@dataclass(frozen=True)
class Reference:
    """The loop of a run as one differential equation, with everything that its solution needs.

    Attributes
    ----------
    plant, controller : str
        Names of the components.
    sources : tuple of str
        Names of the components that a reference or a disturbance comes from.
    disturbed : bool
        Whether the plant is disturbed, by one of them or by start values of its input.
    loop : ClosedLoop
    profiles : tuple of Profile
        theta(t), component by component, without the constants dtheta.
    offsets : tuple of float
        The constants dtheta.
    segments : tuple of SmoothPiece
        theta(t) from the start time to the stop time.
    start : ndarray
        Start values of the loop's states.
    """

    plant: str
    controller: str
    sources: tuple[str, ...]
    disturbed: bool
    loop: ClosedLoop
    profiles: tuple[Profile, ...]
    offsets: tuple[float, ...]
    segments: tuple[SmoothPiece, ...]
    start: Floats

    @property
    def state_names(self) -> tuple[str, ...]:
        """The loop's states as ``component.variable``."""
        return tuple(self._name(name) for name in self.loop.state_names)

    def solve(self, times: Floats) -> dict[str, Floats]:
        """The solution at increasing `times`: the values of each ``component.variable``.

        Those that the loop determines: a disturbance that comes from a profile is none of them.

        Raises
        ------
        CongelationError
            If the solver gives up.
        """
        solution = self.loop.solve(self.segments, self.start, times)
        if not solution.success:
            raise CongelationError(f"the monolithic solution stopped: {solution.message}")
        names = (*self.loop.state_names, *self.loop.output_names)
        given = {
            f"source{k}.{name}"
            for k, model in enumerate(self.loop.sources, start=1)
            for y in model.outputs
            if model.signals and ca.depends_on(y.variables.symbol, model.signals.variables.symbol)
            for name in y.variables.names
        }
        return {
            self._name(name): values
            for name, values in zip(names, (*solution.states.T, *solution.outputs.T), strict=True)
            if name not in given
        }

    @cached_property
    def certified(self) -> ClosedLoop:
        """The loop that the certificate is of."""
        return self.opened(self.disturbed)

    def opened(self, disturbed: bool) -> ClosedLoop:
        """The loop for any reference, and for any disturbance or none: open inputs are states.

        A law with damping against disturbances promises something for each of them.
        """
        plant, sources = self.loop.plant, []
        names = [n for i in plant.inputs if i.source == "disturbance" for n in i.variables.names]
        if names and not disturbed and not {"epsilon_d", "q_d"} & self.loop.values.keys():
            sources = [_constant(dict.fromkeys(names, 0.0))]
        return close(plant, self.loop.controller, self.loop.values, sources)

    @property
    def certified_names(self) -> tuple[str, ...]:
        """The states of that loop as ``component.variable``."""
        return tuple(self._name(name) for name in self.certified.state_names)

    def _name(self, name: str) -> str:
        side, _, variable = name.partition(".")
        names = {"plant": self.plant, "controller": self.controller}
        names |= {f"source{k}": name for k, name in enumerate(self.sources, start=1)}
        return f"{names.get(side, '')}.{variable}"  # held inputs are of no component


def reference(case: Case) -> Reference:
    """Derive the loop of a run anew.

    Raises
    ------
    InvalidInput
        If the system is no loop of a plant and its controller, both from `congelation build`, and
        maybe of a Reference that the controller follows.
    """
    plant, controller, blocks = _loop_members(case.system)
    models = _models(plant, controller)
    members = (plant, controller, *blocks)
    values = {component.name: start_values_of(component) for component in members}
    links = _check_loop(case.system, plant, controller, blocks, models)
    sources = [
        Source(model, _parameters(model, values[block.name]), links[block.name])
        for block in blocks
        for model in (_block(block),)
    ]
    # What no block drives is held at its start value.
    driven = {name for block in blocks for name in links[block.name]}
    held = {
        name: float(values[component.name][name])
        for component, model in zip((plant, controller), models, strict=True)
        for entry in model.inputs
        if entry.source != "loop"
        for name in entry.variables.names
        if name not in driven
    }
    if held:
        sources.append(_constant(held))
    loop = close(*models, _parameters(models[1], values[controller.name]), sources)
    derived = (*models, *(source.model for source in sources[: len(blocks)]))
    states = {
        state.variables.name: [
            float(values[c.name][name]) for name in start_names(state, c is plant)
        ]
        for c, model in zip(members, derived, strict=True)
        for state in model.states
    }
    profiles, offsets = theta_of(values[plant.name])
    signals = [p for block in blocks for p in theta_of(values[block.name])[0]]
    disturbed = any(
        name in driven or held[name] != 0
        for entry in models[0].inputs
        if entry.source == "disturbance"
        for name in entry.variables.names
    )
    return Reference(
        plant.name,
        controller.name,
        tuple(block.name for block in blocks),
        disturbed,
        loop,
        tuple(profiles),
        tuple(offsets),
        _segments(case, profiles, offsets, signals, timed=bool(blocks)),
        loop.start(states),
    )


def _block(component: Component) -> Model:
    """The model of a block, derived anew."""
    about = _spec(component)
    return BLOCKS[about["form"]].model(about["structure"])


def _constant(values: Mapping[str, float]) -> Source:
    """A source that holds elements of inputs at these values."""
    held = Variables("held", ca.SX(ca.DM(list(values.values()))), "Inputs that nothing drives")
    model = Model("Constant", "Held inputs", (), (), (), (Output(held),))
    return Source(model, links=dict(zip(values, held.names, strict=True)))


def compare(found: Reference, trajectory: Trajectory) -> tuple[Deviation, ...]:
    """The deviation of each recorded variable that the loop determines.

    Raises
    ------
    CongelationError
        If the monolithic solution cannot be found.
    """
    return _deviations(found, trajectory.time, trajectory.columns, trajectory.values)


@checked
def verify(system: System, result: Result) -> tuple[Deviation, ...]:
    """Compare a run with the solution of the same loop as one differential equation.

    The loop is derived anew from the structures that its FMUs carry, and solved without any
    co-simulation by another integrator.

    Parameters
    ----------
    system : System
        A plant and its controller, both from `congelation.build`, connected both ways.
    result : Result
        What `congelation.simulate` returned for it.

    Returns
    -------
    tuple of Deviation
        The largest error of each recorded variable that the loop determines.

    Raises
    ------
    InvalidInput
        The system is no such loop.
    CongelationError
        The differential equation cannot be solved.

    Examples
    --------
    >>> links = cg.Connection("plant.x", "law.x"), cg.Connection("law.u", "plant.u")
    >>> plant = cg.Component("plant", fmus / "ScalarPlant.fmu", {"x0": [2.0]})
    >>> law = cg.Component("law", fmus / "ScalarController.fmu")
    >>> system = cg.System((plant, law), links)
    >>> result = cg.simulate(system, stop_time=1.0, tolerance=1e-6, coupling="hermite")
    >>> max(deviation.relative for deviation in cg.verify(system, result)) < 1e-4
    True
    """
    start, stop = float(result.time[0]), float(result.time[-1])
    # Of the experiment its times and columns count; how it was stepped does not.
    horizon = Experiment(stop, result.names, start, step=stop - start)
    found = reference(Case(system, horizon))
    return _deviations(found, result.time, result.names, result.values)


def _deviations(
    found: Reference, time: Floats, columns: Sequence[str], values: Floats
) -> tuple[Deviation, ...]:
    # A time is twice in the rows where theta(t) jumps; the solver takes it once.
    times, rows = np.unique(time, return_inverse=True)
    exact = found.solve(times)
    return tuple(
        _deviation(column, values[:, k], exact[column][rows])
        for k, column in enumerate(columns)
        if column in exact
    )


def _deviation(variable: str, values: Floats, exact: Floats) -> Deviation:
    error, peak = float(np.max(np.abs(values - exact))), float(np.max(np.abs(exact)))
    if error == 0.0:
        return Deviation(variable, 0.0, 0.0)
    return Deviation(variable, error, error / peak if peak > 0.0 else math.inf)


def _loop_members(system: System) -> tuple[Component, Component, tuple[Component, ...]]:
    """The plant, the controller, and the blocks that a reference or a disturbance comes from."""
    about = {component.name: _spec(component) for component in system.components}
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
    return roles["plant"], roles["controller"], tuple(blocks)


def _spec(component: Component) -> dict[str, Any]:
    """The spec that the component's FMU was built from."""
    try:
        with zipfile.ZipFile(component.fmu) as archive:
            spec: dict[str, Any] = json.loads(archive.read("resources/spec.json"))
    except KeyError as error:
        raise InvalidInput(
            f"{component.fmu.name} has no resources/spec.json; only FMUs of `congelation build` "
            "have one"
        ) from error
    return spec


def _models(plant: Component, controller: Component) -> tuple[Model, Model]:
    specs = [_spec(plant), _spec(controller)]
    if not fit(*specs):
        raise InvalidInput(
            f"{plant.name} and {controller.name} are of different systems; take a plant and a "
            "controller of one spec, or of specs that differ in the law alone"
        )
    return models_of(specs[0]["form"], specs[0]["structure"], specs[1]["structure"])


def start_values_of(component: Component) -> dict[str, Scalar]:
    """The value of every variable of an FMU that starts with one: given, or else its own."""
    description = fmpy.read_model_description(str(component.fmu), validate=False)
    own = {
        v.name: _typed(v.type, v.start) for v in description.modelVariables if v.start is not None
    }
    start = resolve_start(describe(component.fmu), component.start, f"component '{component.name}'")
    return {**own, **{item.variable.name: item.value for item in start}}


def _typed(kind: str, text: str) -> Scalar:
    if kind == "Boolean":
        return text in ("true", "1")
    if kind == "Integer":
        return int(text)
    return text if kind == "String" else float(text)


def _check_loop(
    system: System,
    plant: Component,
    controller: Component,
    blocks: Sequence[Component],
    models: tuple[Model, Model],
) -> dict[str, dict[str, str]]:
    """The elements of inputs that each block drives, and the elements of outputs that drive them.

    The monolithic loop connects equal names both ways, and all of a reference; the system has to
    do just that.
    """
    wanted: set[str] = set()
    outside: dict[str, tuple[str, str]] = {}
    for one, other, model in ((controller, plant, models[0]), (plant, controller, models[1])):
        for entry in model.inputs:
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


def _parameters(model: Model, values: Mapping[str, Scalar]) -> dict[str, Floats]:
    return {
        p.variables.name: np.array([float(values[n]) for n in p.variables.names])
        for p in model.parameters
    }


def _segments(
    case: Case,
    profiles: Sequence[Profile],
    offsets: Sequence[float],
    signals: Sequence[Profile],
    timed: bool,
) -> tuple[SmoothPiece, ...]:
    """theta(t), then the signals of the reference and time, on the pieces between their jumps."""
    stop = case.experiment.stop_time
    segments, time = [], case.experiment.start_time
    while time < stop:
        pieces = [profile.segment(time) for profile in (*profiles, *signals)]
        end = min([piece.end for piece in pieces] + [stop])
        added = (*offsets, *(0.0 for _ in signals))
        segments.append(SmoothPiece(time, end, partial(_theta_at, pieces, added, timed)))
        time = end
    return tuple(segments)


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


def _theta_at(
    pieces: Sequence[Segment], offsets: Sequence[float], timed: bool, t: float
) -> list[float]:
    values = [piece.value(t) + offset for piece, offset in zip(pieces, offsets, strict=True)]
    return [*values, t] if timed else values
