"""Candidates of a search for gains: what each does, and a result directory of all that were solved.

A candidate is the design of a spec with each of its gains multiplied by a power of ten.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from congelation.cosim.result import Status
from congelation.design.attack_problem import held
from congelation.design.search_pool import SearchPool
from congelation.design.shooting import Cells, Shooting
from congelation.errors import InvalidInput, counted
from congelation.export.spec import Spec, read_spec
from congelation.results.identity import (
    NUMERICS_VERSION,
    code_version,
    content_hash,
    file_hash,
)
from congelation.results.record import RunRecord
from congelation.results.store import Store
from congelation.scenario.metrics import METRICS
from congelation.signals import Profile
from congelation.theory.closed_loop import ClosedLoop, close
from congelation.verify.reference import smooth_pieces

__all__ = ["OBJECTIVES", "Candidates", "Evaluator"]

Floats = NDArray[np.float64]

Vector = tuple[float, ...]
"""Powers of ten, to four digits."""

OBJECTIVES = ("settling", "effort", "peak_input")
"""Seconds until ``|x|`` stays below a bound; the integral of u^2; max |u|."""

TUNED = ("k_bar", "c", "d", "Gamma", "gamma", "epsilon", "r", "rho", "Q")
"""Parameters that candidates change, where a controller has them; matrices as a whole."""

HORIZON_CELLS = 400
"""Cells of the horizon on which theta(t) is held in the search; proposals are solved without."""

MOST_STEPS = 40_000
"""A candidate that needs more is too stiff to be built, and counts as infeasible."""

INFEASIBLE = "INFEASIBLE"
"""Status of a candidate that cannot be solved."""

EXTENDED = "settling_extended"
"""Metric of a stored candidate: the settling time that the search sees, `Evaluator.solve`."""

_MEASURED = {
    "settling": ("settling_time", "plant.x", "s"),
    "effort": ("ise", "controller.u", ""),
    "peak_input": ("peak", "controller.u", ""),
    EXTENDED: ("settling_time", "plant.x", "s"),
}


class Evaluator:
    """A spec on which candidates are solved; a candidate is a vector of powers of ten."""

    def __init__(self, file: Path, below: float, stop_time: float) -> None:
        self.file = file
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

    def settings(self, vector: Floats) -> dict[str, float]:
        """The FMU variables that a candidate changes; of a matrix, its first element."""
        values = self.values(vector)
        found = {}
        for name, index in self._parts:
            value = values[name]
            if isinstance(index, int):
                suffix, element = f"[{index + 1}]" if value.size > 1 else "", value.flat[index]
            else:
                suffix, element = "[1,1]", value.flat[0]
            found[f"controller.{name}{suffix}"] = float(element)
        return found

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
        """The objectives of a candidate; None where it does not exist or is too stiff.

        Where |x| has not settled by the stop time, the settling time is that time, extended by the
        logarithm of what is left, so that the search sees which of two candidates is nearer.
        """
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
        if math.isinf(settling):
            end = float(np.linalg.norm(x[-1]))
            settling = self.stop * (1.0 + math.log(max(end / self.below, 1.0)))
        return settling, *others

    def exact(self, vector: Floats) -> tuple[float, ...]:
        """The objectives under theta(t) itself, by DOP853."""
        loop = self.loop(vector)
        times = np.linspace(0.0, self.stop, 20_001)
        segments = smooth_pieces((0.0, self.stop), self.profiles, [0.0] * len(self.profiles))
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

    def _objectives(
        self, time: Floats, x: Floats, effort: float, peak: float
    ) -> tuple[float, float, float]:
        settling = float(METRICS["settling_time"].function(time, x, below=self.below) or 0.0)
        return settling, effort, peak


_here: list[Evaluator] = []
"""The evaluator of a worker process."""


def _open_bench(spec: Path, below: float, stop_time: float) -> None:
    _here[:] = [Evaluator(spec, below, stop_time)]


def _solve_here(vector: Vector) -> Vector | None:
    return _here[0].solve(np.array(vector))


class Candidates:
    """The candidates of a search, each solved once; a context manager.

    Parameters
    ----------
    evaluator : Evaluator
    workers : int
        Processes.
    folder : Path, optional
        A result directory, which gets each candidate as a run as soon as it is solved.
    resume : bool
        Whether the directory may have candidates, which are not solved again.

    Attributes
    ----------
    solved : dict
        Objectives by vector, of those that this search asked for; None where there are none.

    Raises
    ------
    InvalidInput
        If the directory has runs and `resume` is false, or they are of another search.
    """

    def __init__(
        self, evaluator: Evaluator, workers: int, folder: Path | None, resume: bool
    ) -> None:
        self.evaluator = evaluator
        self.solved: dict[Vector, Vector | None] = {}
        self._known: dict[str, Vector | None] = {}
        self._key = {
            "spec": file_hash(evaluator.file),
            "below": evaluator.below,
            "stop_time": evaluator.stop,
            "numerics": NUMERICS_VERSION,
        }
        self._study = content_hash(self._key)
        self._store = None if folder is None else self._opened(Store(folder), resume)
        self._pool = None
        if workers > 1:
            self._pool = SearchPool(
                workers, _open_bench, (evaluator.file, evaluator.below, evaluator.stop)
            )

    def __enter__(self) -> Candidates:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if self._pool is not None:
            self._pool.__exit__(kind, error, trace)
        if self._store is not None:
            self._store.close()
            if self._store.count():
                self._store.export()

    def solve(self, vectors: Sequence[Vector]) -> list[Vector | None]:
        """The objectives of candidates; the new ones are solved side by side and stored."""
        ids = {v: content_hash([self._key, v]) for v in vectors}
        new = [v for v in ids if ids[v] not in self._known]
        found: Iterable[Vector | None]
        if self._pool is None:
            found = (self.evaluator.solve(np.array(v)) for v in new)
        else:
            found = self._pool.map(_solve_here, new)
        first = len(self._known)
        records = []
        for number, (vector, objectives) in enumerate(zip(new, found, strict=True), first):
            self._known[ids[vector]] = objectives
            records.append(self._record(ids[vector], number, vector, objectives))
        if self._store is not None and records:
            self._store.add(records)
        self.solved |= {v: self._known[ids[v]] for v in vectors}
        return [self.solved[v] for v in vectors]

    def _record(
        self, run_id: str, number: int, vector: Vector, objectives: Vector | None
    ) -> RunRecord:
        status = Status.COMPLETED.name if objectives is not None else INFEASIBLE
        metrics: dict[str, float | None] = dict.fromkeys(_MEASURED)
        if objectives is not None:
            metrics |= zip(OBJECTIVES, objectives, strict=True)
            metrics[EXTENDED] = objectives[0]
            if objectives[0] > self.evaluator.stop:
                metrics["settling"] = math.inf
        return RunRecord(
            run_id=run_id,
            study=self._study,
            number=number,
            variant="design",
            settings=self.evaluator.settings(np.array(vector)),
            status=status,
            message="" if objectives is not None else "there is no such design, or it is too stiff",
            metrics=metrics,
            code_version=code_version(),
            numerics_version=NUMERICS_VERSION,
        )

    def _opened(self, store: Store, resume: bool) -> Store:
        count = store.count()
        if count and not resume:
            raise InvalidInput(
                f"{store.root} holds {counted(count, 'design')}; give --resume to go on, or "
                "another --out"
            )
        if count and store.newest() != self._study:
            raise InvalidInput(f"{store.root} is of another spec or horizon; give another --out")
        store.create()
        store.begin(self._study, self._about())
        for row in store.rows(self._study):
            record = RunRecord.of(row)
            values = [record.metrics[name] for name in (EXTENDED, *OBJECTIVES[1:])]
            solved = record.status == Status.COMPLETED.name
            self._known[record.run_id] = tuple(v or 0.0 for v in values) if solved else None
        return store

    def _about(self) -> Mapping[str, Any]:
        """How to read the rows, as of a sweep."""
        metrics: dict[str, dict[str, Any]] = {
            name: {
                "metric": kind,
                "of": of,
                "options": {"below": self.evaluator.below} if kind == "settling_time" else {},
                "definition": METRICS[kind].definition,
                "unit": unit,
            }
            for name, (kind, of, unit) in _MEASURED.items()
        }
        metrics[EXTENDED]["definition"] += "; if never, the stop time times 1 + ln(|x| / below)"
        return {
            "title": f"{self.evaluator.spec.title}: designs tried",
            "scenario_file": self.evaluator.file.name,
            "scenario": self.evaluator.file.read_text("utf-8"),
            "varied": list(self.evaluator.settings(np.zeros(self.evaluator.dimension))),
            "metrics": metrics,
            "figures": [],
            "fmus": {},
            "versions": {"congelation": code_version()},
            "swept": True,
        }


def _rounded(value: Floats) -> Floats:
    return np.array([float(f"{v:.4g}") for v in value.ravel()]).reshape(value.shape)
