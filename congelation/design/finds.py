"""Finds of an attack: what they are, and how a candidate becomes one.

Every candidate is solved again by another integrator, split at the jumps of theta(t), and is a find
only where the two agree. A find is a lower bound on the worst case; the certificate of a variant
that holds bounds it from above.
"""

from __future__ import annotations

import math
import pathlib
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from congelation.design.attack_problem import Problem, Varied
from congelation.design.shooting import Cells
from congelation.errors import InvalidInput
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import MetricSpec, Scenario
from congelation.theory.certificate import ROUNDING
from congelation.theory.closed_loop import SmoothPiece, Solution
from congelation.verify.certify import Design, certify_design
from congelation.verify.scenario_assumptions import case_assumptions

__all__ = ["DIFFERENCE", "Attack", "Bound", "Find", "Objective", "Trial", "judged", "solved_again"]

Floats = NDArray[np.float64]

DIFFERENCE = 1e-3
"""A find whose two solutions differ by more, relative to its value, is dropped."""

CERTIFY_SAMPLES = 300

GRID = 4000
"""Times at which the second solution is reported, besides the steps of the first."""


@dataclass(frozen=True)
class Bound:
    """What the certificate bounds, along a find, and by what.

    Attributes
    ----------
    V0 : float
        V at the start, ell in the centre of the admissible theta.
    energy : float
        The largest part of V that is of z (of x, where there is no z): |z|^2/2; at most V0.
    decay : float
        The integral of the claimed rate of decay, sum c_i z_i^2 for the backstepping designs; at
        most V0.
    """

    V0: float
    energy: float
    decay: float


@dataclass(frozen=True)
class Find:
    """A theta(t) and what it does to one variant.

    Attributes
    ----------
    variant, objective : str
    plant : str
        The component that theta(t) belongs to.
    value : float
        Of the objective, by the second integrator; a lower bound on its worst case.
    cells : Cells
        theta(t), held between its jumps.
    difference : float
        Between the two solutions, relative to the value.
    margin : float
        The largest relative margin of the certificate along the find; above 1e-9 it fails there.
    certified : bool
        Whether a search of the variant's states found no violation of its certificate.
    bound : Bound or None
        None where the variant is not certified.
    struck, growth : float or None
        Of a late burst: when theta(t) strikes, in seconds, and the rate, in 1/s, at which the loop
        then grows with the estimates frozen; not positive where no burst was found.
    initial : float
        The size, at the start, of the signals that the objective is of.
    """

    variant: str
    objective: str
    plant: str
    value: float
    cells: Cells
    difference: float
    margin: float
    certified: bool
    bound: Bound | None
    struck: float | None = None
    growth: float | None = None
    initial: float = math.nan

    @property
    def violated(self) -> bool:
        """Whether a certified variant breaks its certificate here."""
        return self.certified and self.margin > ROUNDING


@dataclass(frozen=True)
class Attack:
    """What an attack on a scenario found.

    Attributes
    ----------
    scenario : Scenario
    finds : tuple of Find
        Variant by variant, objective by objective.
    missed : tuple of str
        One line for each variant and objective without a find, and why.
    varied : tuple of Varied
        What was varied in place of theta(t).
    notes : tuple of str
        A line for each search in which runs failed, and so were passed over.
    source : Path or None
        The FMU that drove inputs; None where theta(t) was attacked.
    """

    scenario: Scenario
    finds: tuple[Find, ...]
    missed: tuple[str, ...]
    varied: tuple[Varied, ...] = ()
    source: pathlib.Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def violated(self) -> tuple[Find, ...]:
        """The finds under which a certified variant breaks its certificate."""
        return tuple(find for find in self.finds if find.violated)


@dataclass(frozen=True)
class Objective:
    """What is to be made large: a metric of a group of signals; `late`: from the strike on."""

    name: str
    spec: MetricSpec
    late: bool = False

    def score(self, time: Floats, values: Floats) -> float:
        """The metric of a trajectory; infinite where a settling time is."""
        found = metric(self.spec.metric).function(time, values, **self.spec.options)
        return math.nan if found is None else float(found)


@dataclass(frozen=True)
class Trial:
    """A candidate of a search, its score by the first integrator and the times of that."""

    cells: Cells
    score: float
    time: Floats
    struck: float | None = None
    growth: float | None = None


def solved_again(problem: Problem, objective: Objective, trial: Trial) -> tuple[Solution, float]:
    """The loop under a candidate by DOP853, and the score at the times of the first solution."""
    cells, end = trial.cells, float(trial.time[-1])
    times = np.union1d(trial.time, np.linspace(float(cells.edges[0]), end, GRID))
    segments = [
        SmoothPiece(float(a), float(b), partial(_constant, theta))
        for a, b, theta in zip(cells.edges[:-1], cells.edges[1:], cells.theta, strict=True)
    ]
    solution = problem.loop.solve(segments, problem.start, times, rtol=1e-11, atol=1e-14)
    if not solution.success:
        return solution, math.nan
    picked = np.isin(times, trial.time)
    if objective.spec.metric in ("ise", "integral_of_square"):
        picked[:] = True  # the first solution integrates to more than its own steps tell
    return solution, objective.score(times[picked], _measured(problem, objective, solution)[picked])


def judged(
    problem: Problem,
    objective: Objective,
    trial: Trial,
    solution: Solution,
    difference: float,
    seed: int,
) -> Find:
    """The find that a confirmed candidate is, with the certificate along it."""
    time, values = solution.time, _measured(problem, objective, solution)
    after = time >= (trial.struck or -math.inf)
    rows = np.linspace(0, len(time) - 1, min(len(time), 2000)).round().astype(int)
    try:
        radius = problem.admissible.radius
        remarks = case_assumptions(problem.case)
        design = Design(problem.variant, problem.loop, radius, remarks)
        certified = certify_design(design, CERTIFY_SAMPLES, seed).holds
        ell = problem.certificate.perturbations.ell(
            problem.admissible.center, problem.admissible.half
        )
        margins = problem.certificate.along(solution.states[rows], ell)
    except InvalidInput:  # there is no certificate for these gains
        certified, margins = False, []
    margin = max((m.relative for m in margins), default=math.nan)
    bound = None
    if certified:
        decay = metric("ise").function(
            time[rows], np.sqrt([[max(m.claimed, 0.0)] for m in margins])
        )
        bound = Bound(margins[0].V, _energy(problem, solution), float(decay or 0.0))
    return Find(
        variant=problem.variant,
        objective=objective.name,
        plant=problem.reference.plant,
        value=objective.score(time[after], values[after]),
        cells=trial.cells.until(float(time[-1])),
        difference=difference,
        margin=margin,
        certified=certified,
        bound=bound,
        struck=trial.struck,
        growth=trial.growth,
        initial=float(np.linalg.norm(values[0])),
    )


def _constant(theta: Floats, t: float) -> Floats:
    return theta


def _energy(problem: Problem, solution: Solution) -> float:
    """The largest |z|^2/2, or x^T P x of the matched design, or x^2/2 of the scalar one."""
    names = [n.split("[")[0] for n in problem.loop.output_names]
    z = solution.outputs[:, [n == "controller.z" for n in names]]
    if z.size == 0:
        z = solution.outputs[:, [n == "plant.x" for n in names]]
        if "P" in problem.loop.values:
            return float(np.einsum("ti,ij,tj->t", z, problem.loop.values["P"], z).max())
    return float(np.sum(z**2, axis=1).max() / 2)


def _measured(problem: Problem, objective: Objective, solution: Solution) -> Floats:
    """The signals that an objective is of."""
    component, _, variable = objective.spec.of.partition(".")
    side = "plant" if component == problem.reference.plant else "controller"
    rows = [n.split("[")[0] == f"{side}.{variable}" for n in problem.loop.output_names]
    values: Floats = solution.outputs[:, rows]
    return values
