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

import hashlib
import json
import math
import tomllib
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import tomli_w
from numpy.typing import NDArray

from congelation.design.problem import held
from congelation.design.shooting import Cells, Shooting
from congelation.errors import InvalidInput
from congelation.export.assumptions import spec_assumptions
from congelation.export.spec import Spec, read_spec
from congelation.scenario.metrics import METRICS
from congelation.signals import Profile, box_radius
from congelation.theory.closed_loop import ClosedLoop, Segment, close
from congelation.verify.certify import Design, certify_design

__all__ = ["OBJECTIVES", "Proposal", "Tuning", "tune", "write_proposals"]

Floats = NDArray[np.float64]

OBJECTIVES = ("settling", "effort", "peak_input")
"""Seconds until ``|x|`` stays below a bound; the integral of u^2; max |u|."""

TUNED = ("k_bar", "c", "d", "Gamma", "gamma", "epsilon", "r", "rho", "Q")
"""Parameters that candidates change, where a controller has them; matrices as a whole."""

REACH = 2.0
"""Decades that a parameter may move from the spec's value, up or down."""

HORIZON_CELLS = 400
"""Cells of the horizon on which theta(t) is held in the search; proposals are solved without."""

MOST_STEPS = 40_000
"""A candidate that needs more is too stiff to be built, and counts as infeasible."""

CERTIFY_SAMPLES = 1000

SHARES = (0.4, 0.2, 0.2, 0.2)
"""Of the evaluations: for the wishes as they are, and with emphasis on each objective."""

EMPHASIS = 0.25
"""An emphasised wish is asked for with so much of its value."""

NEAR = 5.0
"""Designs of the front are told of where no objective is more than so many times its wish."""

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
    own : mapping
        The objectives of the spec's own design.
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
    own: Mapping[str, float]
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
            why = (
                "it can be met alone, not together with the others"
                if alone
                else f"not met by any candidate; the least was {self.best[name]:.4g}"
            )
            lines.append(f"{name} = {wish:.4g}: the nearest design has {value:.4g} ({why})")
        return tuple(lines)


def tune(
    spec: Path | str,
    *,
    wishes: Mapping[str, float] | None = None,
    below: float = 1e-2,
    stop_time: float = 20.0,
    evaluations: int = 600,
    seed: int = 0,
    proposals: int = 6,
    workers: int = 1,
    journal: Path | None = None,
    resume: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Tuning:
    """Search for gains that meet a wish.

    Parameters
    ----------
    spec : path
        A spec; its x0, theta(t) and delta stay as they are.
    wishes : mapping, optional
        Upper bounds by `OBJECTIVES`; the spec's own settling and effort where left out.
    below : float
        What ``|x|`` has to stay below to count as settled, in the units of x.
    stop_time : float
        Seconds.
    evaluations : int
        Candidates to solve.
    seed : int
        Equal seeds give equal candidates.
    proposals : int
        Most designs of the front to propose.
    workers : int
        Processes.
    journal : Path, optional
        Where each solved candidate is written at once.
    resume : bool
        Take the candidates that the journal has from there.
    progress : callable
        Called with the number of candidates solved, and of all.

    Raises
    ------
    InvalidInput
        If the spec or a wish is not valid, or the journal is of another search.

    Examples
    --------
    >>> tuning = cg.tune("specs/scalar.toml", evaluations=8, stop_time=5.0)
    >>> all(proposal.certified for proposal in tuning.front)
    True
    """
    spec = Path(spec)
    bench = _Bench(spec, below, stop_time)
    own = bench.exact(np.zeros(bench.dimension))
    # A design that does not settle is asked to do so by the stop time.
    asked = (min(own[0], stop_time), *own[1:])
    wanted = _wishes(wishes, asked)
    key = {
        "spec": hashlib.sha256(spec.read_bytes()).hexdigest(),
        "below": below,
        "stop_time": stop_time,
    }
    with _Book(journal, key, resume) as book:
        pool: Executor | None = None

        def told() -> None:
            progress(min(len(book.solved), evaluations), evaluations)

        if workers > 1:
            pool = ProcessPoolExecutor(
                workers, get_context("spawn"), _open_bench, (spec, below, stop_time)
            )
        try:
            for share, goal in zip(SHARES, _goals(wanted, asked), strict=True):
                _descend(bench, goal, int(share * evaluations), seed, pool, book, told)
        finally:
            if pool is not None:
                pool.shutdown(cancel_futures=True)
        points = [(np.array(v), o) for v, o in book.solved.items() if o is not None]
    if not points:
        raise InvalidInput(f"{spec}: no candidate could be solved for {stop_time:g} s")
    values = np.array([o for _, o in points])
    front = [points[i][0] for i in _front(values, wanted, proposals)]
    proposed = [bench.proposal(v) for v in front]
    certified = [p for p in proposed if p.certified] or proposed
    nearest = min(
        certified, key=lambda p: _achievement([p.objectives[n] for n in OBJECTIVES], wanted)
    )
    return Tuning(
        spec,
        dict(zip(OBJECTIVES, own, strict=True)),
        wanted,
        nearest,
        (nearest, *(p for p in certified if p is not nearest)),
        dict(zip(OBJECTIVES, values.min(axis=0).tolist(), strict=True)),
        len(book.solved),
    )


def write_proposals(found: Tuning, folder: Path) -> list[Path]:
    """Each proposal as a spec, ``<spec>_1.toml`` being the nearest."""
    folder.mkdir(parents=True, exist_ok=True)
    document = tomllib.loads(found.spec.read_text("utf-8"))
    files = []
    for k, proposal in enumerate(found.front, 1):
        start = {**document["controller"].get("start", {})}
        start |= {name: _plain(value) for name, value in proposal.values.items()}
        told = ", ".join(f"{n} {v:.4g}" for n, v in proposal.objectives.items())
        changed = {
            **document,
            "title": f"{document.get('title', found.spec.stem)}; tuned: {told}",
            "controller": {**document["controller"], "start": start},
        }
        files.append(folder / f"{found.spec.stem}_{k}.toml")
        files[-1].write_text(tomli_w.dumps(changed), encoding="utf-8")
    return files


class _Bench:
    """A spec on which candidates are solved; a candidate is a vector of powers of ten."""

    def __init__(self, file: Path, below: float, stop_time: float) -> None:
        self.spec: Spec = read_spec(file)
        self.below, self.stop = below, stop_time
        model = self.spec.controller.model
        defaults = model.defaults()
        self.own = {name: defaults[name] for name in TUNED if name in defaults}
        # A vector's elements move one by one, a matrix as a whole.
        self._parts = [
            (name, index)
            for name, value in self.own.items()
            for index in (range(value.size) if value.shape[1] == 1 else (slice(None),))
        ]
        self.dimension = len(self._parts)

    @cached_property
    def profiles(self) -> list[Profile]:
        return [slots.profile for slots in self.spec.plant.profiles]

    @cached_property
    def cells(self) -> Cells:
        return held(self.profiles, 0.0, self.stop, self.stop / HORIZON_CELLS)

    def values(self, vector: Floats) -> dict[str, Floats]:
        """The parameters of a candidate, to four digits."""
        changed = {name: value.copy() for name, value in self.own.items()}
        for (name, index), power in zip(self._parts, vector, strict=True):
            changed[name].reshape(-1)[index] *= 10.0**power
        return {name: _rounded(value) for name, value in changed.items()}

    def loop(self, vector: Floats) -> ClosedLoop:
        model = self.spec.controller.model
        return close(self.spec.plant.model, model, {**model.defaults(), **self.values(vector)})

    def solve(self, vector: Floats) -> tuple[float, ...] | None:
        """The objectives of a candidate; None where it does not exist or is too stiff."""
        try:
            loop = self.loop(vector)
            shooting = Shooting(loop, loop.bound_signal("controller.u"), rtol=1e-6, atol=1e-8)
            path = shooting.solve(loop.start(), self.cells, most_steps=MOST_STEPS)
        except InvalidInput:
            return None
        if not path.finished:
            return None
        x = path.states[:, : len(self.spec.plant.model.states[0].variables.names)]
        settling, *others = self._objectives(path.time, x, path.integral, path.peak)
        if math.isinf(settling):  # so that the search sees which of two is nearer
            end = float(np.linalg.norm(x[-1]))
            settling = self.stop * (1.0 + math.log(max(end / self.below, 1.0)))
        return settling, *others

    def exact(self, vector: Floats) -> tuple[float, ...]:
        """The objectives under theta(t) itself, by DOP853."""
        loop = self.loop(vector)
        times = np.linspace(0.0, self.stop, 20_001)
        start, segments = 0.0, []
        while start < self.stop:
            pieces = [profile.segment(start) for profile in self.profiles]
            end = min(self.stop, *(piece.end for piece in pieces))
            segments.append(Segment(start, end, partial(_theta, pieces)))
            start = end
        # More rows where the transient is.
        times = np.union1d(times, np.geomspace(1e-6, self.stop, 2000))
        solution = loop.solve(segments, loop.start(), times, rtol=1e-10, atol=1e-12)
        if not solution.success:
            raise InvalidInput(
                f"{self.spec.title}: the loop could not be solved: {solution.message}"
            )
        names = [n.split("[")[0] for n in loop.output_names]
        u = solution.outputs[:, [n == "controller.u" for n in names]]
        x = solution.states[:, : len(self.spec.plant.model.states[0].variables.names)]
        effort = float(METRICS["ise"].function(solution.time, u) or 0.0)
        return self._objectives(solution.time, x, effort, float(np.abs(u).max()))

    def proposal(self, vector: Floats) -> Proposal:
        loop = self.loop(vector)
        remarks = spec_assumptions(self.spec)
        design = Design(self.spec.title, loop, box_radius(self.profiles), remarks)
        own = self.own
        changed = {n: v for n, v in self.values(vector).items() if (v != own[n]).any()}
        objectives = dict(zip(OBJECTIVES, self.exact(vector), strict=True))
        return Proposal(changed, objectives, certify_design(design, CERTIFY_SAMPLES).holds)

    def _objectives(
        self, time: Floats, x: Floats, effort: float, peak: float
    ) -> tuple[float, float, float]:
        settling = float(METRICS["settling_time"].function(time, x, below=self.below) or 0.0)
        return settling, effort, peak


class _Book:
    """The candidates solved so far, kept in a file of one line each."""

    def __init__(self, file: Path | None, key: Mapping[str, object], resume: bool) -> None:
        self._file, self._key = file, key
        self._stream: TextIO | None = None
        self.solved: dict[tuple[float, ...], tuple[float, ...] | None] = {}
        self.known: dict[tuple[float, ...], tuple[float, ...] | None] = {}
        if file is None:
            return
        if file.exists() and not resume:
            raise InvalidInput(
                f"{file} is there already; go on with --resume, or choose another --out"
            )
        if file.exists():
            head, *lines = file.read_text("utf-8").splitlines()
            if json.loads(head) != dict(key):
                raise InvalidInput(f"{file} is of another spec or horizon; choose another --out")
            for line in lines:
                try:
                    vector, objectives = json.loads(line)
                except ValueError:  # the last line of a search that was killed
                    continue
                self.known[tuple(vector)] = None if objectives is None else tuple(objectives)

    def __enter__(self) -> _Book:
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            fresh = not self._file.exists()
            self._stream = self._file.open("a", encoding="utf-8")
            if fresh:
                print(json.dumps(dict(self._key)), file=self._stream, flush=True)
        return self

    def __exit__(self, *error: object) -> None:
        if self._stream is not None:
            self._stream.close()

    def write(self, vector: tuple[float, ...], objectives: tuple[float, ...] | None) -> None:
        """Keep a candidate, and in the file if it is not there."""
        self.solved[vector] = objectives
        if self._stream is not None and vector not in self.known:
            print(json.dumps([vector, objectives]), file=self._stream, flush=True)


_here: list[_Bench] = []
"""The bench of a worker process."""


def _open_bench(spec: Path, below: float, stop_time: float) -> None:
    _here[:] = [_Bench(spec, below, stop_time)]


def _solve_here(vector: tuple[float, ...]) -> tuple[float, ...] | None:
    return _here[0].solve(np.array(vector))


def _descend(
    bench: _Bench,
    goal: Mapping[str, float],
    evaluations: int,
    seed: int,
    pool: Executor | None,
    book: _Book,
    progress: Callable[[], None],
) -> None:
    """One run of the strategy towards a goal, from the spec's own design."""
    import cma  # here: the import takes half a second, which other commands need not wait for

    options = {
        "seed": seed + 1,
        "verbose": -9,
        "bounds": [-REACH, REACH],
        "maxfevals": evaluations,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the strategy's advice on its options
        strategy = cma.CMAEvolutionStrategy(np.zeros(bench.dimension), 0.5, options)
        done = 0
        while done < evaluations and not strategy.stop():
            asked = [tuple(np.round(v, 4).tolist()) for v in strategy.ask()]
            new = [v for v in asked if v not in book.known and v not in book.solved]
            found: Iterable[tuple[float, ...] | None]
            if pool is None:
                found = (bench.solve(np.array(v)) for v in new)
            else:
                found = pool.map(_solve_here, new)
            for vector, objectives in zip(new, found, strict=True):
                book.write(vector, objectives)
            for vector in asked:
                if vector in book.known:
                    book.write(vector, book.known[vector])
            done += len(asked)
            progress()
            strategy.tell(
                [list(v) for v in asked], [_achievement(book.solved[v], goal) for v in asked]
            )


def _achievement(objectives: Sequence[float] | None, goal: Mapping[str, float]) -> float:
    """The largest logarithm of an objective over its goal, and a little of all of them."""
    if objectives is None:
        return INFEASIBLE
    named = dict(zip(OBJECTIVES, objectives, strict=True))
    ratios = [math.log(max(named[name], 1e-12) / wish) for name, wish in goal.items()]
    return max(ratios) + 0.02 * sum(ratios)


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


def _theta(pieces: Sequence[Any], t: float) -> list[float]:
    return [piece.value(t) for piece in pieces]


def _rounded(value: Floats) -> Floats:
    return np.array([float(f"{v:.4g}") for v in value.ravel()]).reshape(value.shape)


def _plain(value: Floats) -> object:
    if value.size == 1:
        return float(value.item())
    return value.ravel().tolist() if value.shape[1] == 1 else value.tolist()
