"""What a sweep has to do: all its runs, those that the result directory lacks, and their index."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from congelation.cosim.result import Status
from congelation.errors import InvalidInput
from congelation.results.provenance import about
from congelation.results.store import Store
from congelation.scenario.axes import Sweep
from congelation.scenario.scenario import EXPERIMENT, Scenario
from congelation.scenario.start_values import Scalar
from congelation.sweep.plan import plan_run, varied_settings
from congelation.sweep.workers import REFUSED, TIMED_OUT, Task, Work

__all__ = ["FAILURES", "WORKER_DIED", "Plan", "plan_sweep", "write_index"]

WORKER_DIED = "WORKER_DIED"
"""Status of a run that ended its worker process twice."""

FAILURES = (
    *(status.name for status in Status if status is not Status.COMPLETED),
    REFUSED,
    TIMED_OUT,
    WORKER_DIED,
)
"""How a run may end other than at its stop time."""


@dataclass(frozen=True)
class Plan:
    """A sweep to do.

    Parameters
    ----------
    scenario : Scenario
    shared : Work
    run_ids : tuple of str
        All runs, in order.
    missing : tuple of Task
        Those that the store does not hold yet.
    others : int
        How many runs the store holds that are none of these.
    """

    scenario: Scenario
    shared: Work
    run_ids: tuple[str, ...]
    missing: tuple[Task, ...]
    others: int = 0

    @property
    def finished(self) -> int:
        """How many of the runs the store holds now."""
        return len(self.shared.store.finished() & {*self.run_ids})


def plan_sweep(
    scenario: Scenario, folder: Path, *, resume: bool, retry: Collection[str] = ()
) -> Plan:
    """The runs of a sweep, every variant at every point, each content once.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        The result directory.
    resume : bool
        Whether the directory may have runs, which are not done again.
    retry : collection of str
        Those of `FAILURES` that are done again nevertheless.

    Raises
    ------
    InvalidInput
        If the scenario has no sweep, the directory has runs and `resume` is false, or there is no
        such status.
    """
    for status in retry:
        if status not in FAILURES:
            raise InvalidInput(f"'{status}' is no status to retry; valid: {', '.join(FAILURES)}")
    sweep = scenario.sweep
    if sweep is None:
        raise InvalidInput(f"{scenario.file}: no [sweep]; give its axes, or use: congelation run")
    store = Store(folder.absolute())
    done = store.finished()
    if done and not resume:
        raise InvalidInput(
            f"{folder} holds {len(done)} finished runs; give --resume to go on, or another --out"
        )
    if next(_points(scenario, sweep), None) is None:
        raise InvalidInput(f"{scenario.file}: sweep.constraints leave no point")
    varied = varied_settings(scenario, sweep.names())
    tasks = {task.run_id: task for task in _tasks(scenario, sweep, varied)}
    missing = (_missing(task, store, done, retry) for task in tasks.values())
    light = replace(scenario, sweep=None, text="")
    shared = Work(light, store, varied, sweep.trajectories, sweep.seed, sweep.timeout)
    return Plan(
        scenario,
        shared,
        tuple(tasks),
        tuple(task for task in missing if task),
        len(done.difference(tasks)),
    )


def _tasks(scenario: Scenario, sweep: Sweep, varied: Sequence[str]) -> Iterator[Task]:
    """Every variant at every point, as often as it is repeated."""
    repetitions = tuple(sweep.repetitions())
    points = _points(scenario, sweep)
    for point, (replicate, seeds) in itertools.product(points, repetitions):
        for variant in scenario.variants:
            settings = {**variant.settings, **point, **seeds}
            try:
                run_id = plan_run(scenario, variant.name, settings, varied).run_id
            except InvalidInput as error:
                raise _drawn(error, sweep) from error
            yield Task(run_id, variant.name, settings, replicate)


def _points(scenario: Scenario, sweep: Sweep) -> Iterator[dict[str, Scalar]]:
    """The points of a sweep; what cannot be evaluated of its constraints is told with its place."""
    try:
        yield from sweep.points()
    except InvalidInput as error:
        raise InvalidInput(f"{scenario.file}: sweep.constraints: {error}") from error


def _drawn(error: InvalidInput, sweep: Sweep) -> InvalidInput:
    """The error about an experiment, naming the axes that draw settings of it."""
    axes = [axis for axis in sweep.axes if axis.name.startswith(f"{EXPERIMENT}.")]
    if not axes:
        return error
    places = " and ".join(f"{axis.place} draws {axis.name} ({axis.distribution})" for axis in axes)
    return InvalidInput(f"{error}; {places}")


def _missing(
    task: Task, store: Store, done: Collection[str], retry: Collection[str]
) -> Task | None:
    """The task, if it is to be done."""
    if task.run_id not in done:
        return task
    if retry and store.row(task.run_id)["status"] in retry:
        return replace(task, replaces=store.written(task.run_id))
    return None


def write_index(plan: Plan) -> None:
    """Write runs.parquet: the plan's finished runs in order.

    Runs of other plans stay in the directory, for whoever resumes those, and are not listed.
    """
    done = plan.shared.store.finished()
    ordered = [run_id for run_id in plan.run_ids if run_id in done]
    unlisted = sorted(done.difference(ordered))
    if done:
        described = about(plan.scenario, plan.shared.varied)
        sweep = {"planned": len(plan.run_ids), "seed": plan.shared.seed, "unlisted": unlisted}
        plan.shared.store.compact(ordered, {**described, "sweep": sweep, "verification": {}})
