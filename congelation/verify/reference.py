"""Verification: the closed loop of a run solved as one differential equation, by other means.

From the structures that the FMUs carry (`loop_parts`) the theory derives plant and controller anew,
closes the loop without any co-simulation, and scipy solves it to 1e-12, stopping at every jump of
theta(t).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import casadi as ca
import numpy as np
import numpy.typing as npt

from congelation.arguments import checked
from congelation.cosim.result import Result
from congelation.cosim.system import System
from congelation.errors import CongelationError, InvalidInput
from congelation.export.interface import start_names
from congelation.results.record import Trajectory
from congelation.scenario.parts import Case, Experiment
from congelation.signals import Profile, Segment
from congelation.theory.closed_loop import ClosedLoop, SmoothPiece, Source, close
from congelation.theory.model import Model, Output, Variables
from congelation.verify.loop_parts import driven_by, loop_parts, theta_of

__all__ = [
    "LARGEST_DEVIATION",
    "Deviation",
    "Reference",
    "compare",
    "reference",
    "smooth_pieces",
    "verify",
]

Floats = npt.NDArray[np.float64]

LARGEST_DEVIATION = 1e-3
"""A co-simulation further than this from the monolithic solution, relative to a variable's peak,
does not count as a solution of the loop: such a curve differs visibly in print."""


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

    @classmethod
    def of(cls, variable: str, values: Floats, exact: Floats) -> Deviation:
        """That of co-simulated values from exact ones."""
        error, peak = float(np.max(np.abs(values - exact))), float(np.max(np.abs(exact)))
        relative = error / peak if peak > 0.0 else math.inf
        return cls(variable, error, relative if error != 0.0 else 0.0)


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

    @property
    def center(self) -> Floats:
        """The centre of the box that theta(t) fills."""
        bounds = [profile.bounds() for profile in self.profiles]
        if not np.isfinite(bounds).all():
            raise InvalidInput("theta(t) has no bounds")
        middle: Floats = np.mean(bounds, axis=1) + np.array(self.offsets)
        return middle

    @property
    def radii(self) -> Floats:
        """Half the sides of the box that theta(t) fills."""
        bounds = np.array([profile.bounds() for profile in self.profiles], dtype=float)
        half: Floats = (bounds[:, 1] - bounds[:, 0]) / 2
        return half

    @cached_property
    def certified(self) -> ClosedLoop:
        """The loop that the certificate is of."""
        return self.opened(self.disturbed)

    def opened(self, disturbed: bool) -> ClosedLoop:
        """The loop for any reference, and for any disturbance or none: open inputs are states.

        A law with damping against disturbances promises something for each of them.
        """
        plant, sources = self.loop.plant, []
        names = _disturbances(plant)
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
    plant, controller, blocks = loop_parts(case.system)
    links = driven_by(case.system, plant, controller, blocks)
    sources = [Source(block.model, block.parameters, links[block.name]) for block in blocks]
    # What no block drives is held at its start value.
    driven = {name for given in links.values() for name in given}
    held = {
        name: float(part.values[name])
        for part in (plant, controller)
        for entry in part.model.inputs
        if entry.source != "loop"
        for name in entry.variables.names
        if name not in driven
    }
    if held:
        sources.append(_constant(held))
    loop = close(plant.model, controller.model, controller.parameters, sources)
    states = {
        state.variables.name: [float(part.values[n]) for n in start_names(state, part is plant)]
        for part in (plant, controller, *blocks)
        for state in part.model.states
    }
    profiles, offsets = theta_of(plant.values)
    signals = [p for block in blocks for p in theta_of(block.values)[0]]
    disturbances = _disturbances(plant.model)
    return Reference(
        plant.name,
        controller.name,
        tuple(block.name for block in blocks),
        any(name in driven or held[name] != 0 for name in disturbances),
        loop,
        tuple(profiles),
        tuple(offsets),
        smooth_pieces(
            (case.experiment.start_time, case.experiment.stop_time),
            (*profiles, *signals),
            (*offsets, *(0.0 for _ in signals)),
            timed=bool(blocks),
        ),
        loop.start(states),
    )


def _disturbances(plant: Model) -> list[str]:
    """The elements of inputs by which a plant is disturbed."""
    inputs = [entry for entry in plant.inputs if entry.source == "disturbance"]
    return [name for entry in inputs for name in entry.variables.names]


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
        Deviation.of(column, values[:, k], exact[column][rows])
        for k, column in enumerate(columns)
        if column in exact
    )


def smooth_pieces(
    span: tuple[float, float],
    profiles: Sequence[Profile],
    offsets: Sequence[float],
    *,
    timed: bool = False,
) -> tuple[SmoothPiece, ...]:
    """Profiles plus constants, and the time if asked for, on the pieces of a span between jumps."""
    time, stop = span
    found = []
    while time < stop:
        pieces = [profile.segment(time) for profile in profiles]
        end = min([piece.end for piece in pieces] + [stop])
        found.append(SmoothPiece(time, end, partial(_values_at, pieces, offsets, timed)))
        time = end
    return tuple(found)


def _values_at(
    pieces: Sequence[Segment], offsets: Sequence[float], timed: bool, t: float
) -> list[float]:
    values = [piece.value(t) + offset for piece, offset in zip(pieces, offsets, strict=True)]
    return [*values, t] if timed else values
