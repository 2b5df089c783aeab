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
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from functools import partial

from congelation.arguments import checked
from congelation.design.attack_problem import Problem, chosen_variants, problem_of
from congelation.design.derivative_free import maximise
from congelation.design.finds import (
    DIFFERENCE,
    Attack,
    Find,
    Objective,
    Trial,
    judged,
    solved_again,
)
from congelation.design.late_strike import SETTLED, strikes
from congelation.design.search import Search
from congelation.design.search_pool import SearchPool
from congelation.design.shooting import Cells, Path, Shooting
from congelation.errors import InvalidInput, nearest, require_count
from congelation.scenario.load import load_scenario
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import MetricSpec, Scenario

__all__ = ["OBJECTIVES", "attack"]

Progress = Callable[[str, str, float, float], None]

OBJECTIVES = ("peak", "ise", "late")
"""max |x|, the integral of |x|^2, and max |x| after |x| had settled."""

EFFORT = 4e8
"""Elementary operations of the solutions of one search: half a minute on a machine of 2020."""

_GRADIENT = {"peak": True, "integral_of_square": False, "ise": False}
"""The metrics that the search has gradients of, and whether they are peaks."""


@checked
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
        ``peak``, the largest ``|x|``; ``ise``, the integral of its square; ``late``, the largest
        after it had settled; or names of the scenario's metrics.
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
    require_count(workers, "workers")
    if not objectives:
        raise InvalidInput("objectives is empty; name what is to be maximised")
    if not 0.0 < effort < math.inf:
        raise InvalidInput(f"effort = {effort} is not valid; give a positive number")
    chosen = chosen_variants(scenario, variants)
    jobs = [
        _Job(scenario, v, _objective(scenario, o), effort, seed) for v in chosen for o in objectives
    ]
    outcomes: dict[int, Find | str] = {}
    show: Progress = progress or (lambda variant, objective, done, best: None)
    if workers == 1 or len(jobs) == 1:
        for k, job in enumerate(jobs):
            outcomes[k] = _do(job, partial(show, job.variant, job.objective.name))
    else:
        with SearchPool(workers) as pool:
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


@dataclass(frozen=True)
class _Job:
    scenario: Scenario
    variant: str
    objective: Objective
    effort: float
    seed: int


def _objective(scenario: Scenario, name: str) -> Objective:
    specs = {spec.name: spec for spec in scenario.metrics}
    if name in specs:
        if metric(specs[name].metric).loop:
            raise InvalidInput(
                f"objective '{name}' is a metric of the loop as a whole; give one of a group of "
                "signals (every find states its margin of the certificate)"
            )
        return Objective(name, specs[name])
    if name not in OBJECTIVES:
        raise InvalidInput(f"'{name}' is no objective; {nearest(name, [*OBJECTIVES, *specs])}")
    return Objective(
        name, MetricSpec(name, "ise" if name == "ise" else "peak", "", {}), name == "late"
    )


def _do(
    job: _Job, progress: Callable[[float, float], None] = lambda done, best: None
) -> Find | str:
    """Search, then verify, best first."""
    problem, spec = problem_of(job.scenario, job.variant), job.objective.spec
    of = spec.of or f"{problem.reference.plant}.x"
    objective = replace(job.objective, spec=replace(spec, of=of))
    differences = []
    for trial in _trials(problem, objective, job, progress):
        solution, score = solved_again(problem, objective, trial)
        if not solution.success:
            continue
        difference = abs(score - trial.score) / max(abs(score), 1e-300)
        if objective.late and score <= SETTLED:
            difference = 0.0  # nothing is claimed of it but that it stays small
        if difference <= DIFFERENCE or score == trial.score:
            return judged(problem, objective, trial, solution, difference, job.seed)
        differences.append(difference)
    if not differences:
        return f"{job.variant}: {objective.name}: the loop does not settle, or no solution ended"
    return (
        f"{job.variant}: {objective.name}: no candidate was confirmed; two integrators differ by "
        f"{min(differences):.1e} at least"
    )


def _trials(
    problem: Problem,
    objective: Objective,
    job: _Job,
    progress: Callable[[float, float], None],
) -> Iterator[Trial]:
    """The candidates of a search, the best first."""
    v, peak = problem.signal(objective.spec.of), _GRADIENT.get(objective.spec.metric)
    if objective.late:
        shooting = Shooting(problem.loop, v, rtol=1e-8, atol=1e-13)
        steps = int(job.effort * EFFORT / shooting.operations / 3)
        for s in strikes(problem, shooting, steps=steps, seed=job.seed, progress=progress):
            yield Trial(s.cells, s.value, s.path.time, s.time, s.growth)
        return
    shooting = Shooting(problem.loop, v)
    steps = int(job.effort * EFFORT / shooting.operations)
    if peak is None:
        yield from _without_gradient(problem, objective, shooting, steps, job.seed, progress)
        return
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
        yield Trial(c.cells, c.value, c.path.time)


def _without_gradient(
    problem: Problem,
    objective: Objective,
    shooting: Shooting,
    steps: int,
    seed: int,
    progress: Callable[[float, float], None],
) -> Iterator[Trial]:
    """The candidates for a metric without a gradient, the best first."""
    spent = 0

    def scored(cells: Cells) -> tuple[float, Path]:
        nonlocal spent
        path = shooting.solve(
            problem.start, cells, longest=(problem.span[1] - problem.span[0]) / 500
        )
        spent += len(path.cell)
        return objective.score(path.time, shooting.signals(path, cells)), path

    for cells in maximise(
        lambda cells: scored(cells)[0],
        problem.admissible,
        problem.span,
        seed=seed,
        more=lambda: spent < steps,
        progress=lambda best: progress(min(1.0, spent / steps), best),
    ):
        score, path = scored(cells)
        yield Trial(cells, score, path.time)
