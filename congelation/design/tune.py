"""Gains for a wish: settling time, control effort and peak input of a certified design.

A candidate is the spec's design with each of its gains multiplied by a power of ten. What it does
under the spec's own theta(t) is solved without FMUs, some milliseconds each. The search is CMA-ES
on the largest ratio of an objective to its wish (Wierzbicki's achievement function), in several
directions of emphasis; of all candidates met, those that no other beats are the Pareto front. The
certificate holds for every candidate by its proof, and is searched for violations before one is
proposed.

References
----------
N. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772.
A. P. Wierzbicki, The use of reference objectives in multiobjective optimization, in: Multiple
Criteria Decision Making Theory and Application, Springer 1980.
"""

from __future__ import annotations

import math
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from congelation.arguments import checked
from congelation.design.tuning_candidates import OBJECTIVES, Candidates, Evaluator
from congelation.errors import InvalidInput, require_count
from congelation.export.spec_assumptions import spec_assumptions
from congelation.places import write_whole
from congelation.signals import box_radius
from congelation.verify.certify import Design, certify_design

__all__ = ["OBJECTIVES", "Proposal", "Tuning", "tune", "write_proposals"]

Floats = NDArray[np.float64]

REACH = 2.0
"""Decades that a parameter may move from the spec's value, up or down."""

STOP_TIME = 20.0
"""End of the simulations, in seconds, where neither it nor a long settling time is asked for."""

CERTIFY_SAMPLES = 1000

SHARES = (0.4, 0.2, 0.2, 0.2)
"""Parts of the evaluations for the wishes as they are, then with emphasis on each objective."""

EMPHASIS = 0.25
"""Factor by which the value of an emphasised wish is multiplied."""

NEAR = 5.0
"""Designs of the front are listed if each objective is at most so many times its wish."""

INFEASIBLE = 1e3
"""The achievement of a candidate that does not exist, in units of e."""


@dataclass(frozen=True)
class Proposal:
    """A design of the Pareto front.

    Attributes
    ----------
    values : mapping
        The parameters that differ from the spec's, by name, in their shape.
    objectives : mapping
        By `OBJECTIVES`, from a solution with rtol 1e-10 under the spec's own theta(t); a settling
        time is infinite where the design has not settled by the stop time.
    certified : bool
        Whether a search found no violation of its certificate.
    """

    values: Mapping[str, Floats]
    objectives: Mapping[str, float]
    certified: bool


@dataclass(frozen=True)
class Tuning:
    """What `tune` found.

    Attributes
    ----------
    spec : Path
    own : Proposal
        The spec's own design, which is a candidate, too.
    stop_time : float
        When the simulations ended, in seconds.
    wishes : mapping
    nearest : Proposal
        Comes nearest to the wishes: the least largest ratio of an objective to its wish.
    front : tuple of Proposal
        Some of the Pareto front, `nearest` first.
    best : mapping
        The least value of each objective met by any candidate, whatever the others were.
    evaluations : int
    """

    spec: Path
    own: Proposal
    stop_time: float
    wishes: Mapping[str, float]
    nearest: Proposal
    front: tuple[Proposal, ...]
    best: Mapping[str, float]
    evaluations: int

    @property
    def unmet(self) -> tuple[str, ...]:
        """One line for each wish that the nearest design does not meet."""
        lines = []
        for name, wish in self.wishes.items():
            value = self.nearest.objectives[name]
            if value <= wish:
                continue
            alone = self.best[name] <= wish
            why = "it can be met alone, not together with the others"
            if not alone and math.isinf(self.best[name]):
                why = "no candidate does"
            elif not alone:
                why = f"not met by any candidate; the least was {self.best[name]:.4g}"
            reached = (
                f"has {value:.4g}"
                if math.isfinite(value)
                else f"has not settled by {self.stop_time:g} s"
            )
            lines.append(f"{name} = {wish:.4g}: the nearest design {reached} ({why})")
        return tuple(lines)


@checked
def tune(
    spec: Path | str,
    *,
    wishes: Mapping[str, float] | None = None,
    below: float = 1e-2,
    stop_time: float | None = None,
    evaluations: int = 600,
    seed: int = 0,
    proposals: int = 6,
    workers: int = 1,
    out: Path | str | None = None,
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Tuning:
    """Search for gains that meet a wish.

    Parameters
    ----------
    spec : path
        A spec; its x0, theta(t) and delta stay as they are.
    wishes : mapping, optional
        Upper bounds of ``settling`` (seconds), ``effort`` (the integral of u^2) and ``peak_input``
        (the largest ``|u|``); the spec's own settling and effort where left out.
    below : float
        What ``|x|`` has to stay below to count as settled, in the units of x.
    stop_time : float, optional
        Seconds, later than the settling time that is wished; 20, or twice that where it is more.
    evaluations : int
        Candidates to solve, about.
    seed : int
        Equal seeds give equal candidates.
    proposals : int
        Most designs of the front to propose.
    workers : int
        Processes.
    out : Path, optional
        A result directory (`cg.open_results`), which gets each candidate as a run at once.
    resume : bool
        Take the candidates that the directory has from there.
    progress : callable, optional
        Called with the number of candidates solved, and of all.

    Raises
    ------
    InvalidInput
        If the spec or a wish is not valid, or the directory holds another search.

    Examples
    --------
    >>> tuning = cg.tune("specs/scalar.toml", evaluations=8, stop_time=5.0)
    >>> all(proposal.certified for proposal in tuning.front)
    True
    """
    require_count(evaluations, "evaluations")
    require_count(workers, "workers")
    settling = (wishes or {}).get("settling", 0.0)
    if stop_time is None:
        stop_time = max(STOP_TIME, 2.0 * settling)
    if not 0.0 < stop_time < math.inf:
        raise InvalidInput(f"stop_time = {stop_time} is not valid; give a positive time in seconds")
    if settling >= stop_time:
        raise InvalidInput(
            f"wish settling = {settling:g}: the simulations end at {stop_time:g} s; give a stop "
            "time after it"
        )
    spec = Path(spec)
    evaluator = Evaluator(spec, below, stop_time)
    as_it_is = _proposal(evaluator, np.zeros(evaluator.dimension))
    own = tuple(as_it_is.objectives[name] for name in OBJECTIVES)
    # A design that does not settle is asked to do so by the stop time.
    asked = (min(own[0], stop_time), *own[1:])
    wanted = _wishes(wishes, asked)
    with Candidates(evaluator, workers, None if out is None else Path(out), resume) as candidates:

        def count() -> None:
            if progress is not None:
                progress(min(len(candidates.solved), evaluations), evaluations)

        candidates.solve([(0.0,) * evaluator.dimension])
        for share, goal in zip(SHARES, _goals(wanted, asked), strict=True):
            seed += 1
            _descend(candidates, goal, math.ceil(share * evaluations), seed, count)
    points = [(np.array(v), o) for v, o in candidates.solved.items() if o is not None]
    if not points:
        raise InvalidInput(f"{spec}: no candidate could be solved for {stop_time:g} s")
    values = np.array([o for _, o in points])
    front = [points[i][0] for i in _front(values, wanted, proposals)]
    proposed = [_proposal(evaluator, v) for v in front]
    certified = [p for p in proposed if p.certified] or proposed
    nearest = min(
        certified, key=lambda p: _achievement([p.objectives[n] for n in OBJECTIVES], wanted)
    )
    return Tuning(
        spec,
        as_it_is,
        stop_time,
        wanted,
        nearest,
        (nearest, *(p for p in certified if p is not nearest)),
        dict(zip(OBJECTIVES, _least(values, stop_time), strict=True)),
        len(candidates.solved),
    )


def write_proposals(found: Tuning, folder: Path) -> list[Path]:
    """Each proposal as a spec, ``<spec>_1.toml`` being the nearest."""
    folder.mkdir(parents=True, exist_ok=True)
    document = tomllib.loads(found.spec.read_text("utf-8"))
    files = []
    for k, proposal in enumerate(found.front, 1):
        start = {**document["controller"].get("start", {})}
        start |= {name: _plain(value) for name, value in proposal.values.items()}
        reached = ", ".join(f"{n} {v:.4g}" for n, v in proposal.objectives.items())
        changed = {
            **document,
            "title": f"{document.get('title', found.spec.stem)}; tuned: {reached}",
            "controller": {**document["controller"], "start": start},
        }
        files.append(folder / f"{found.spec.stem}_{k}.toml")
        write_whole(files[-1], tomli_w.dumps(changed))
    return files


def _descend(
    candidates: Candidates,
    goal: Mapping[str, float],
    evaluations: int,
    seed: int,
    progress: Callable[[], None],
) -> None:
    """One run of the strategy towards a goal, from the spec's own design."""
    import cma  # here: the import takes half a second, which other commands need not wait for

    options = {
        "seed": seed,
        "verbose": -9,
        "bounds": [-REACH, REACH],
        "maxfevals": evaluations,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the strategy's advice on its options
        strategy = cma.CMAEvolutionStrategy(np.zeros(candidates.evaluator.dimension), 0.5, options)
        done = 0
        while done < evaluations and not strategy.stop():
            asked = [tuple(np.round(v, 4).tolist()) for v in strategy.ask()]
            found = candidates.solve(asked)
            done += len(asked)
            progress()
            strategy.tell([list(v) for v in asked], [_achievement(o, goal) for o in found])


def _proposal(evaluator: Evaluator, vector: Floats) -> Proposal:
    loop = evaluator.loop(vector)
    remarks = spec_assumptions(evaluator.spec)
    design = Design(evaluator.spec.title, loop, box_radius(evaluator.profiles), remarks)
    own = evaluator.own
    changed = {n: v for n, v in evaluator.values(vector).items() if (v != own[n]).any()}
    objectives = dict(zip(OBJECTIVES, evaluator.exact(vector), strict=True))
    return Proposal(changed, objectives, certify_design(design, CERTIFY_SAMPLES).holds)


def _achievement(objectives: Sequence[float] | None, goal: Mapping[str, float]) -> float:
    """The largest logarithm of an objective over its goal, and a little of all of them."""
    if objectives is None:
        return INFEASIBLE
    named = dict(zip(OBJECTIVES, objectives, strict=True))
    ratios = [math.log(max(named[name], 1e-12) / wish) for name, wish in goal.items()]
    return max(ratios) + 0.02 * sum(ratios)


def _least(values: Floats, stop_time: float) -> list[float]:
    """The least of each objective; infinite for a settling time that the search has extended."""
    settling, *others = values.min(axis=0).tolist()
    return [settling if settling <= stop_time else math.inf, *others]


def _goals(wishes: Mapping[str, float], own: Sequence[float]) -> list[Mapping[str, float]]:
    every = {**dict(zip(OBJECTIVES, own, strict=True)), **wishes}
    return [wishes, *({**every, name: EMPHASIS * every[name]} for name in OBJECTIVES)]


def _wishes(wishes: Mapping[str, float] | None, own: Sequence[float]) -> dict[str, float]:
    if not wishes:
        return dict(zip(OBJECTIVES[:2], own[:2], strict=True))
    for name, value in wishes.items():
        if name not in OBJECTIVES or not (math.isfinite(value) and value > 0.0):
            raise InvalidInput(
                f"wish {name} = {value}; valid: a positive number for {', '.join(OBJECTIVES)}"
            )
    return dict(wishes)


def _front(values: Floats, wishes: Mapping[str, float], most: int) -> list[int]:
    """Indices of some designs that no other beats: the nearest to the wishes, and others apart."""
    logs = np.log(np.maximum(values, 1e-12))
    kept = [
        i
        for i in range(len(logs))
        if not np.any(np.all(logs <= logs[i], axis=1) & np.any(logs < logs[i], axis=1))
    ]
    near = math.log(NEAR)
    kept = [
        i
        for i in kept
        if all(logs[i, OBJECTIVES.index(n)] <= math.log(w) + near for n, w in wishes.items())
    ] or kept
    first = min(kept, key=lambda i: _achievement(values[i].tolist(), wishes))
    chosen = [first]
    while len(chosen) < min(most, len(kept)):
        gaps = [min(float(np.abs(logs[i] - logs[j]).max()) for j in chosen) for i in kept]
        if max(gaps) == 0.0:
            break
        chosen.append(kept[int(np.argmax(gaps))])
    return chosen


def _plain(value: Floats) -> object:
    if value.size == 1:
        return float(value.item())
    return value.ravel().tolist() if value.shape[1] == 1 else value.tolist()
