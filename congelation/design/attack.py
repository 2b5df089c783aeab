"""The theta(t) that does most harm to each variant of a scenario, of those that its design admits.

What is found is a *lower* bound on the worst case. The certificate bounds it from above: with V(0)
for the congealed parameters in the centre of the admissible set, |z|^2 <= 2 V(0) and the integral
of the claimed rate of decay is at most V(0). Every find is solved again by another integrator,
split at the jumps, and dropped where the two differ.
"""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from congelation.design.free import maximise
from congelation.design.late import SETTLED, strikes
from congelation.design.problem import Problem, Varied, problem_of
from congelation.design.search import Search
from congelation.design.shooting import Cells, Path, Shooting
from congelation.errors import InvalidInput, nearest
from congelation.scenario.load import load_scenario
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import MetricSpec, Scenario
from congelation.theory.certificate import ROUNDING
from congelation.theory.closed_loop import Segment, Solution
from congelation.verify.assumptions import case_assumptions
from congelation.verify.certify import Design, certify_design

__all__ = ["OBJECTIVES", "Attack", "Bound", "Find", "attack"]

Floats = NDArray[np.float64]
Progress = Callable[[str, str, float, float], None]

OBJECTIVES = ("peak", "ise", "late")
"""max |x|, the integral of |x|^2, and max |x| after |x| had settled."""

EFFORT = 4e8
"""Elementary operations of the solutions of one search: half a minute on a machine of 2020."""

DIFFERENCE = 1e-3
"""A find whose two solutions differ by more, relative to its value, is dropped."""

CERTIFY_SAMPLES = 300

GRID = 4000
"""Times at which the second solution is reported, besides the steps of the first."""

_GRADIENT = {"peak": True, "integral_of_square": False, "ise": False}
"""The metrics that the search has gradients of, and whether they are peaks."""


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
    source : Path or None
        The FMU that drove inputs; None where theta(t) was attacked.
    """

    scenario: Scenario
    finds: tuple[Find, ...]
    missed: tuple[str, ...]
    varied: tuple[Varied, ...] = ()
    source: pathlib.Path | None = None

    @property
    def violated(self) -> tuple[Find, ...]:
        """The finds under which a certified variant breaks its certificate."""
        return tuple(find for find in self.finds if find.violated)


def attack(
    scenario: Scenario | pathlib.Path | str,
    *,
    objectives: Sequence[str] = OBJECTIVES,
    variants: Sequence[str] | None = None,
    effort: float = 1.0,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
) -> Attack:
    """Search for the admissible theta(t) that does most harm to each variant.

    Parameters
    ----------
    scenario : Scenario or path
        A loop of a plant and its controller. Admissible is the box that the profile of theta fills;
        where it is constant, the ball of radius delta about it.
    objectives : sequence of str
        Of `OBJECTIVES`, or names of the scenario's metrics.
    variants : sequence of str, optional
        Names; all where left out.
    effort : float
        1 is about half a minute for each variant and objective.
    seed : int
        Of the random starts. Equal seeds give equal finds.
    workers : int
        Processes that share the variants and objectives.
    progress : callable, optional
        Called with variant, objective, the fraction done and the largest value so far; from worker
        processes only when they are done.

    Raises
    ------
    InvalidInput
        If an objective or variant is unknown, or the scenario is no such loop.

    Examples
    --------
    >>> found = cg.attack("scenarios/scalar.toml", variants=["Controller 2"], objectives=["peak"],
    ...                   effort=0.02)
    >>> found.finds[0].value > 1.0
    True
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(pathlib.Path(scenario))
    names = [v.name for v in scenario.variants]
    for name in variants or ():
        if name not in names:
            raise InvalidInput(f"'{name}' is no variant; {nearest(name, names)}")
    chosen = [n for n in names if variants is None or n in variants]
    jobs = [
        _Job(scenario, v, _objective(scenario, o), effort, seed) for v in chosen for o in objectives
    ]
    outcomes: dict[int, Find | str] = {}
    show: Progress = progress or _silent
    if workers == 1 or len(jobs) == 1:
        for k, job in enumerate(jobs):
            outcomes[k] = _do(job, partial(show, job.variant, job.objective.name))
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(_do, job): k for k, job in enumerate(jobs)}
            for future in as_completed(futures):
                k = futures[future]
                outcomes[k] = found = future.result()
                best = found.value if isinstance(found, Find) else math.nan
                show(jobs[k].variant, jobs[k].objective.name, 1.0, best)
    ordered = [outcomes[k] for k in range(len(jobs))]
    return Attack(
        scenario,
        tuple(one for one in ordered if isinstance(one, Find)),
        tuple(one for one in ordered if isinstance(one, str)),
    )


def _silent(variant: str, objective: str, done: float, best: float) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class _Objective:
    """What is to be made large: a metric of a group of signals; `late`: from the strike on."""

    name: str
    spec: MetricSpec
    late: bool = False

    def score(self, time: Floats, values: Floats) -> float:
        """The metric of a trajectory; infinite where a settling time is."""
        found = metric(self.spec.metric).function(time, values, **self.spec.options)
        return math.nan if found is None else float(found)


@dataclass(frozen=True)
class _Job:
    scenario: Scenario
    variant: str
    objective: _Objective
    effort: float
    seed: int


@dataclass(frozen=True)
class _Trial:
    """A candidate of a search, its score by the first integrator and the times of that."""

    cells: Cells
    score: float
    time: Floats
    struck: float | None = None
    growth: float | None = None


def _objective(scenario: Scenario, name: str) -> _Objective:
    specs = {spec.name: spec for spec in scenario.metrics}
    if name in specs:
        if metric(specs[name].metric).loop:
            raise InvalidInput(
                f"objective '{name}' is a metric of the loop as a whole; give one of a group of "
                "signals (the margin of the certificate is told of every find)"
            )
        return _Objective(name, specs[name])
    if name not in OBJECTIVES:
        raise InvalidInput(f"'{name}' is no objective; {nearest(name, [*OBJECTIVES, *specs])}")
    return _Objective(
        name, MetricSpec(name, "ise" if name == "ise" else "peak", "", {}), name == "late"
    )


def _do(
    job: _Job, progress: Callable[[float, float], None] = lambda done, best: None
) -> Find | str:
    """Search, then verify, best first."""
    problem, objective = problem_of(job.scenario, job.variant), job.objective
    name = objective.spec.of or f"{problem.reference.plant}.x"
    differences = []
    for trial in _trials(problem, objective, name, job, progress):
        solution, score = _second(problem, objective, name, trial)
        if not solution.success:
            continue
        difference = abs(score - trial.score) / max(abs(score), 1e-300)
        if objective.late and score <= SETTLED:
            difference = 0.0  # nothing is claimed of it but that it stays small
        if difference <= DIFFERENCE or score == trial.score:
            return _find(problem, job, name, trial, solution, difference)
        differences.append(difference)
    if not differences:
        return f"{job.variant}: {objective.name}: the loop does not settle, or no solution ended"
    return (
        f"{job.variant}: {objective.name}: no candidate was confirmed; two integrators differ by "
        f"{min(differences):.1e} at least"
    )


def _trials(
    problem: Problem,
    objective: _Objective,
    name: str,
    job: _Job,
    progress: Callable[[float, float], None],
) -> Iterator[_Trial]:
    v, peak = problem.signal(name), _GRADIENT.get(objective.spec.metric)
    if objective.late:
        shooting = Shooting(problem.loop, v, rtol=1e-8, atol=1e-13)
        steps = int(job.effort * EFFORT / shooting.operations / 3)
        for s in strikes(problem, shooting, steps=steps, seed=job.seed, progress=progress):
            yield _Trial(s.cells, s.value, s.path.time, s.time, s.growth)
        return
    shooting = Shooting(problem.loop, v)
    steps = int(job.effort * EFFORT / shooting.operations)
    if peak is not None:
        search = Search(
            shooting,
            problem.admissible,
            problem.start,
            problem.span,
            peak=peak,
            steps=steps,
            seed=job.seed,
            progress=progress,
        )
        for c in search.run():
            yield _Trial(c.cells, c.value, c.path.time)
        return

    def scored(cells: Cells) -> tuple[float, Path]:
        path = shooting.solve(
            problem.start, cells, longest=(problem.span[1] - problem.span[0]) / 500
        )
        return objective.score(path.time, shooting.signals(path, cells)), path

    spent = 0

    def value(cells: Cells) -> float:
        nonlocal spent
        score, path = scored(cells)
        spent += len(path.cell)
        return score

    for cells in maximise(
        value,
        problem.admissible,
        problem.span,
        seed=job.seed,
        more=lambda: spent < steps,
        progress=lambda best: progress(min(1.0, spent / steps), best),
    ):
        score, path = scored(cells)
        yield _Trial(cells, score, path.time)


def _second(
    problem: Problem, objective: _Objective, name: str, trial: _Trial
) -> tuple[Solution, float]:
    """The loop under a candidate by DOP853, and the score at the times of the first solution."""
    cells, end = trial.cells, float(trial.time[-1])
    times = np.union1d(trial.time, np.linspace(float(cells.edges[0]), end, GRID))
    segments = [
        Segment(float(a), float(b), partial(_constant, theta))
        for a, b, theta in zip(cells.edges[:-1], cells.edges[1:], cells.theta, strict=True)
    ]
    solution = problem.loop.solve(segments, problem.start, times, rtol=1e-11, atol=1e-14)
    if not solution.success:
        return solution, math.nan
    picked = np.isin(times, trial.time)
    if objective.spec.metric in ("ise", "integral_of_square"):
        picked[:] = True  # the first solution integrates to more than its own steps tell
    return solution, objective.score(times[picked], _group(problem, name, solution)[picked])


def _find(
    problem: Problem, job: _Job, name: str, trial: _Trial, solution: Solution, difference: float
) -> Find:
    time, values = solution.time, _group(problem, name, solution)
    after = time >= (trial.struck or -math.inf)
    rows = np.linspace(0, len(time) - 1, min(len(time), 2000)).round().astype(int)
    try:
        radius = problem.admissible.radius
        remarks = case_assumptions(problem.case)
        design = Design(problem.variant, problem.loop, radius, remarks)
        certified = certify_design(design, CERTIFY_SAMPLES, job.seed).holds
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
        objective=job.objective.name,
        plant=problem.reference.plant,
        value=job.objective.score(time[after], values[after]),
        cells=trial.cells.until(float(time[-1])),
        difference=difference,
        margin=margin,
        certified=certified,
        bound=bound,
        struck=trial.struck,
        growth=trial.growth,
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


def _group(problem: Problem, name: str, solution: Solution) -> Floats:
    component, _, variable = name.partition(".")
    side = "plant" if component == problem.reference.plant else "controller"
    rows = [n.split("[")[0] == f"{side}.{variable}" for n in problem.loop.output_names]
    values: Floats = solution.outputs[:, rows]
    return values
