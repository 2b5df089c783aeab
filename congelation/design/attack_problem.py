"""What may be attacked: the closed loop of one variant, and the theta(t) that its design admits.

This is the one module of the room that knows scenarios; the searches are of a `Problem`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from congelation.design.shooting import Cells
from congelation.errors import InvalidInput, nearest
from congelation.scenario.scenario import Case, Scenario
from congelation.signals import Profile
from congelation.theory.certificate import Certificate, PerturbationSet
from congelation.theory.closed_loop import ClosedLoop
from congelation.verify.certify import certificate_of
from congelation.verify.reference import Reference, reference

__all__ = ["Admissible", "Problem", "Varied", "chosen_variants", "held", "problem_of"]

Floats = NDArray[np.float64]

MOST_CORNERS = 64
"""Corners of a box from which a search starts; more are drawn at random."""


@dataclass(frozen=True)
class Admissible:
    """The set that theta(t) has to stay in: a box, or a ball cut by the bound on one element.

    Attributes
    ----------
    center : ndarray, shape (p,)
    half : ndarray, shape (p,)
        Half widths of the box; 0 where an element is constant. For a ball they are all 0.
    ball : PerturbationSet or None
        Given: theta - center is in this set instead.
    """

    center: Floats
    half: Floats
    ball: PerturbationSet | None = None

    @property
    def radius(self) -> float:
        """Radius of the smallest ball about the center that holds the set."""
        return float(np.linalg.norm(self.half)) if self.ball is None else self.ball.delta

    def worst(self, gradient: Floats) -> Floats:
        """The theta of the set with the largest gradient . theta; shape (p,)."""
        if self.ball is None:
            return self.center + np.where(gradient < 0.0, -self.half, self.half)
        return self.center + self.ball.worst(gradient)

    @cached_property
    def extremes(self) -> Floats:
        """Corners of a box; of a ball the ends of its axes and diagonals. Shape (m, p)."""
        moves = self.half > 0.0 if self.ball is None else np.array(self.ball.varies)
        free = np.flatnonzero(moves)
        signs = itertools.product((-1.0, 1.0), repeat=len(free))
        if 2 ** len(free) > MOST_CORNERS:
            generator = np.random.default_rng(0)
            signs = iter(generator.choice([-1.0, 1.0], size=(MOST_CORNERS, len(free))).tolist())
        directions = np.zeros((0, len(self.center)))
        for chosen in signs:
            row = np.zeros(len(self.center))
            row[free] = chosen
            directions = np.vstack([directions, row])
        if self.ball is not None:
            axes = np.eye(len(self.center))[free]
            directions = np.vstack([directions, axes, -axes])
        return np.array([self.worst(row) for row in directions])

    @cached_property
    def lattice(self) -> Floats:
        """The extremes, the center, and the middles between opposite sides. Shape (m, p)."""
        middles = [self.center]
        for j, half in enumerate(self.half):
            for sign in (-1.0, 1.0) if half > 0.0 else ():
                middles.append(self.center + sign * half * np.eye(len(self.center))[j])
        return np.unique(np.vstack([self.extremes, *middles]), axis=0)


@dataclass(frozen=True)
class Varied:
    """An input or a parameter that is to be varied between two values."""

    component: str
    variable: str
    low: float
    high: float
    is_input: bool

    @property
    def source(self) -> str:
        """Name of the component that drives it."""
        return f"source_{self.component}_{self.variable}".translate(
            str.maketrans("[],.()", "______")
        )


@dataclass(frozen=True)
class Problem:
    """One variant of a scenario as a closed loop to attack.

    Attributes
    ----------
    variant : str
    case : Case
    reference : Reference
        The loop, its start values and the scenario's own theta(t).
    admissible : Admissible
    """

    variant: str
    case: Case
    reference: Reference
    admissible: Admissible

    @property
    def loop(self) -> ClosedLoop:
        return self.reference.loop

    @property
    def start(self) -> Floats:
        """The loop's states at the start time."""
        return self.reference.start

    @property
    def span(self) -> tuple[float, float]:
        """Start and stop time of the scenario, in seconds."""
        return self.case.experiment.start_time, self.case.experiment.stop_time

    @cached_property
    def certificate(self) -> Certificate:
        return certificate_of(self.loop)

    def signal(self, name: str) -> ca.SX:
        """The group ``component.variable`` of outputs as a column.

        Raises
        ------
        InvalidInput
            If the loop has no such output.
        """
        sides = {self.reference.plant: "plant", self.reference.controller: "controller"}
        component, _, variable = name.partition(".")
        full = f"{sides.get(component, component)}.{variable}"
        known = {n.split("[")[0] for n in self.loop.output_names}
        if full not in known:
            names = {
                f"{c}.{n.partition('.')[2]}"
                for c, s in sides.items()
                for n in known
                if n.startswith(s)
            }
            raise InvalidInput(f"'{name}' is no output of the loop; {nearest(name, sorted(names))}")
        return self.loop.bound_signal(full)

    def own_profile(self, end: float, cell: float) -> Cells:
        """The scenario's own theta(t), held over cells that also end at its jumps.

        Parameters
        ----------
        end : float
            Seconds; may lie beyond the stop time.
        cell : float
            The longest cell, in seconds.
        """
        own = held(self.reference.profiles, self.span[0], end, cell)
        return Cells(own.edges, own.theta + np.array(self.reference.offsets)).merged()


def held(profiles: Sequence[Profile], start: float, end: float, cell: float) -> Cells:
    """theta(t) held at its value in the middle of cells, which end at its jumps too.

    Parameters
    ----------
    profiles : sequence of Profile
    start, end : float
        Seconds.
    cell : float
        The longest cell, in seconds.
    """
    edges = {end, *np.arange(start, end, cell).tolist()}
    for profile in profiles:
        time = start
        while (time := profile.next_event(time)) < end:
            edges.add(time)
    grid = np.array(sorted(edges))
    grid = grid[np.append(np.diff(grid) > 1e-6 * cell, True)]
    middles = (grid[:-1] + grid[1:]) / 2
    return Cells(grid, np.array([[p.value(t) for p in profiles] for t in middles]))


def chosen_variants(scenario: Scenario, names: Sequence[str] | None) -> list[str]:
    """The names of the variants to attack, in the scenario's order; None: of all.

    Raises
    ------
    InvalidInput
        No name, or one of no variant.
    """
    known = [variant.name for variant in scenario.variants]
    if names is None:
        return known
    if not names:
        raise InvalidInput("variants is empty; leave it out for all")
    for name in names:
        if name not in known:
            raise InvalidInput(f"'{name}' is no variant; {nearest(name, known)}")
    return [name for name in known if name in names]


def problem_of(scenario: Scenario, variant: str) -> Problem:
    """The loop of a variant and the admissible theta(t).

    Admissible is the box that the profile of theta fills; where no profile varies, the ball of the
    design's radius delta (for a_{n-1} of output feedback delta_1) about the constants.

    Raises
    ------
    InvalidInput
        If the scenario is no loop of a plant and its controller, or its theta(t) is not bounded or
        not admissible for the design.
    """
    settings = next(v.settings for v in scenario.variants if v.name == variant)
    case = scenario.case(settings)
    found = reference(case)
    if found.loop.controller.Upsilon is not None:
        raise InvalidInput(
            f"{variant}: its controller knows a part of theta(t), Upsilon(t) vartheta, which an "
            "attack would break; attack a variant without Upsilon"
        )
    if found.sources:
        raise InvalidInput(
            f"{variant}: {', '.join(found.sources)} drives the loop, and this search moves "
            "theta(t) alone, in a loop that nothing else drives; vary the FMUs' inputs "
            f"instead, such as --vary {found.plant}.dtheta[1]=-1..1"
        )
    if not np.isfinite([profile.bounds() for profile in found.profiles]).all():
        raise InvalidInput(f"{variant}: theta(t) has no bounds; give a profile that has")
    center, half = found.center, found.radii
    ball = _ball(found.loop, len(center))
    theta = found.loop.plant.theta
    names = () if theta is None else theta.names
    constant = [n for n, v, h in zip(names, ball.varies, half, strict=True) if h > 0 and not v]
    if constant:
        raise InvalidInput(
            f"{variant}: {', '.join(constant)} varies; output feedback is designed for a constant "
            "b (Assumption 2), so give it a constant"
        )
    if half.any():
        return Problem(variant, case, found, Admissible(center, half))
    if not ball.delta > 0.0:
        raise InvalidInput(
            f"{variant}: theta(t) is constant and delta = 0, so there is nothing to attack; give a "
            "profile, or a positive delta"
        )
    return Problem(variant, case, found, Admissible(center, half, ball))


def _ball(loop: ClosedLoop, p: int) -> PerturbationSet:
    # Where the law estimates the radius, only the profile tells it.
    delta = float(loop.values["delta"].item()) if "delta" in loop.values else 0.0
    if "delta_1" not in loop.values:
        return PerturbationSet(delta, (True,) * p)
    b = p - loop.values["k"].size
    varies = (False,) * b + (True,) * (p - b)
    return PerturbationSet(delta, varies, first=b, delta_1=float(loop.values["delta_1"].item()))
