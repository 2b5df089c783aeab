"""The engine of studies: runs handed to workers, their records committed in batches.

`run` and `sweep` are the same work: a plan, workers, a store. Whatever ends, a study goes on from
what the store holds: a run whose worker ended is tried once more, alone, and one that ends its
worker again is a record that says so; after the death of this process, `resume` does what is
missing.
"""

from __future__ import annotations

import itertools
import sys
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from congelation.arguments import checked
from congelation.errors import DesignWarning, InvalidInput, counted
from congelation.places import StoreError, name_of
from congelation.results.record import RunRecord
from congelation.results.results import Results
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.sweep.cluster import Cluster
from congelation.sweep.execute import REFUSED, Task
from congelation.sweep.local import Local
from congelation.sweep.plan import Plan, plan_study
from congelation.sweep.workers import Finished, Lost, Progress, Remark, Workers
from congelation.verify.scenario_assumptions import scenario_warnings, sweep_warnings

__all__ = ["Listener", "Tally", "carry_out", "read", "result_folder", "run", "sweep"]

BATCH, PERIOD = 1000, 1.0
"""Records, and seconds, after which they are committed: what a killed process repeats at most."""

TASK_SECONDS = 0.05
"""Time that a task with several short runs may take: handing one out costs about a millisecond."""

MEMORY_PERIOD = 0.5
"""Seconds between two looks at the memory of the workers."""

NOTEBOOK_PERIOD = 0.2
"""Seconds between two changes of what a notebook shows."""


@dataclass(frozen=True)
class Tally:
    """How far a study is.

    Parameters
    ----------
    done, total : int
        Runs.
    failed : int
        Those done by this call that did not reach their stop time.
    memory : int
        Bytes that the workers take together.
    under_way : float
        Sum of the fractions done of the runs that are under way.
    notices : tuple of str
        What there is to tell since the last call: a line for each run whose steps have collapsed,
        and for each FMU that fails in fmi2Terminate.
    """

    done: int
    total: int
    failed: int = 0
    memory: int = 0
    under_way: float = 0.0
    notices: tuple[str, ...] = ()


Listener = Callable[[Tally], None]
"""Called whenever some runs are done or have gone on."""


@checked
def run(
    scenario: Scenario | Path | str,
    *,
    out: Path | str | None = None,
    workers: int = 1,
    verify: bool = False,
    trust: bool | str = False,
    timeout: float | None = None,
    progress: Listener | None = None,
) -> Results:
    """Run all variants of a scenario, in worker processes, and store them.

    Parameters
    ----------
    scenario : Scenario or path
        A scenario, or the file of one (.toml, .ssp).
    out : path, optional
        The result directory, by default ``results/<scenario>``, of a ``scenario.toml``
        ``results/<its folder>``. Runs of the same scenario are done
        again; those of an earlier state of it are kept.
    workers : int
        Number of processes.
    verify : bool
        Whether each run that reached its stop time is compared with the monolithic solution.
    trust : bool or str
        Whether runs get error bars, as in `congelation.simulate`.
    timeout : float, optional
        Seconds that a run may take.
    progress : callable, optional
        Called with a `Tally`; in a notebook a bar is shown by default.

    Raises
    ------
    InvalidInput
        If the scenario is wrong, no run of it can begin, or the directory cannot be used.
    StoreError
        If results cannot be written.

    Warns
    -----
    DesignWarning
        For each assumption of the theorem that a variant breaks.
    UserWarning
        For what may be a mistake: a forgotten connection, units that cannot be compared.

    Examples
    --------
    >>> results = cg.run("scenarios/scalar.toml", out=folder / "scalar")
    >>> [run.variant for run in results.runs]
    ['Controller 1', 'Controller 2']
    """
    options = {"swept": False, "verify": verify, "trust": trust, "timeout": timeout}
    return _study(scenario, Local(workers), out, progress, options)


@checked
def sweep(
    scenario: Scenario | Path | str,
    *,
    out: Path | str | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    ship: bool = False,
    resume: bool = False,
    retry: Collection[str] = (),
    verify: bool = False,
    timeout: float | None = None,
    progress: Listener | None = None,
) -> Results:
    """Run all variants of a scenario at every point of its sweep, and store them.

    Parameters
    ----------
    scenario, out, workers, verify, timeout, progress
        As for `run`.
    scheduler : str, optional
        Address of a dask scheduler, whose workers do the runs instead.
    ship : bool
        Whether FMUs are sent to these workers, and trajectories taken from them.
    resume : bool
        Whether the directory may have finished runs, which are not done again.
    retry : collection of str
        Resume, and do runs that ended with such a status again.

    Raises
    ------
    InvalidInput
        If the scenario is wrong, no run of it can begin, or the directory cannot be used.
    StoreError
        If results cannot be written.

    Warns
    -----
    DesignWarning
        For each assumption of the theorem that a variant, or points of the sweep, break.
    UserWarning
        For what may be a mistake: a forgotten connection, units that cannot be compared.

    Examples
    --------
    >>> starter = cg.new("flap", folder)
    >>> fmus = cg.build(starter / "spec.toml", out=starter / "fmus")
    >>> len(cg.sweep(starter / "scenario.toml", out=folder / "swept").runs)
    12
    """
    place = Local(workers) if scheduler is None else Cluster(scheduler, ship=ship)
    again = {"resume": resume or bool(retry), "retry": retry}
    options = {"swept": True, **again, "verify": verify, "timeout": timeout}
    return _study(scenario, place, out, progress, options)


def read(scenario: Scenario | Path | str) -> Scenario:
    """A scenario, or the one that a file describes."""
    return scenario if isinstance(scenario, Scenario) else load_scenario(scenario)


def _study(
    scenario: Scenario | Path | str,
    workers: Workers,
    out: Path | str | None,
    progress: Listener | None,
    options: Mapping[str, Any],
) -> Results:
    """Plan a study, with `options` of `plan_study`, and carry it out; warn as the commands do."""
    found = read(scenario)
    # The caller is that of `run` or `sweep`.
    for line in found.warnings:
        warnings.warn(line, UserWarning, stacklevel=3)
    of_points = sweep_warnings(found) if options["swept"] else ()
    for line in (*scenario_warnings(found), *of_points):
        warnings.warn(line, DesignWarning, stacklevel=3)
    plan = plan_study(found, result_folder(found, out), **options)
    return carry_out(plan, workers, progress or _notebook_progress())


def result_folder(scenario: Scenario, out: Path | str | None) -> Path:
    """Where results go."""
    if out is not None:
        if not str(out):
            raise InvalidInput("out = '' names no folder; give one, '.' being this one")
        return Path(out)
    if scenario.file is None:
        raise InvalidInput("a scenario without a file has no folder for its results; give out")
    return Path("results") / name_of(scenario.file)


def _notebook_progress() -> Listener | None:
    """What shows progress in the notebook that runs this process; None where there is none."""
    if "ipykernel" not in sys.modules:
        return None
    from IPython import get_ipython  # there with every kernel
    from IPython.display import HTML, display

    if get_ipython() is None:  # the kernel's package is there, but runs nothing here
        return None

    handle = display(HTML(""), display_id=True)
    shown = -NOTEBOOK_PERIOD

    def show(tally: Tally) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < NOTEBOOK_PERIOD and tally.done < tally.total:
            return
        shown = now
        part = tally.done + tally.under_way
        text = f"{tally.done} of {counted(tally.total, 'run')}, {tally.failed} failed"
        handle.update(HTML(f'<progress value="{part}" max="{tally.total}"></progress> {text}'))

    return show


def carry_out(plan: Plan, workers: Workers, progress: Listener | None = None) -> Results:
    """Do what is missing of a study.

    Raises
    ------
    InvalidInput
        If not one run could begin; their records say why.
    StoreError
        If results cannot be written.
    KeyboardInterrupt
        On Ctrl-C, after the workers have stopped; what is finished is stored.
    """
    engine = _Engine(plan, workers, progress)
    try:
        engine.work()
    except StoreError:
        with suppress(StoreError):  # of two complaints about the disk, the first is to be seen
            engine.commit()
        raise
    except BaseException:
        engine.commit()
        raise
    else:
        engine.commit()
    finally:
        with suppress(StoreError):
            plan.store.close()
    plan.store.export()
    if engine.refused and engine.refused[0] == plan.total:
        raise InvalidInput(f"{plan.scenario.place}: {engine.refused[1]}")
    return Results(plan.store.root, plan.job.study)


class _Engine:
    """The runs of a plan on their way: waiting, under way, ended and not yet committed."""

    def __init__(self, plan: Plan, workers: Workers, progress: Listener | None) -> None:
        self.plan = plan
        self.workers = workers
        self.progress = progress
        self.refused: tuple[int, str] = (0, "")
        self._waiting = plan.tasks()
        self._again: deque[Task] = deque()  # their worker ended before they began
        self._alone: deque[Task] = deque()  # their worker ended while they were under way
        self._under_way: dict[str, Task] = {}
        self._fractions: dict[str, float] = {}
        self._notices: list[str] = []
        self._remarks: set[str] = set()
        self._deaths: Counter[str] = Counter()
        self._records: list[RunRecord] = []
        self._committed = time.monotonic()
        self._done = plan.total - len(plan.missing)
        self._failed = 0
        self._seconds = TASK_SECONDS  # of a run, by the latest ones
        self._memory, self._looked = 0, 0.0

    def work(self) -> None:
        """Do all missing runs."""
        if not self.plan.missing:
            return
        with self.workers.running(self.plan.job):
            while self._submit() or self._under_way:
                for event in self.workers.events():
                    if isinstance(event, Remark):
                        self._remark(event)
                        continue
                    task = self._under_way[event.run_id]
                    if isinstance(event, Progress):
                        self._fractions[event.run_id] = event.fraction
                        if event.notice:
                            self._notices.append(f"{task.variant}: {event.notice}")
                        continue
                    del self._under_way[event.run_id]
                    self._fractions.pop(event.run_id, None)
                    if isinstance(event, Finished):
                        if event.trajectory is not None:
                            self.plan.store.write_trajectory(event.run_id, event.trajectory)
                        self._end(task, self.plan.record(task, event.outcome))
                    elif isinstance(event, Lost):
                        record = self.plan.record(task, event.outcome)
                        self._lost(task, record, final=event.outcome.cause == "time limit")
                    else:
                        self._again.append(task)
                if self._records and (
                    len(self._records) >= BATCH or time.monotonic() > self._committed + PERIOD
                ):
                    self.commit()
                self._tell()
            self.commit()
            for remark in self.workers.finish():
                self._remark(remark)
            if self._notices:
                self._tell()

    def commit(self) -> None:
        """Store the records of the runs that have ended."""
        if self._records:
            self.plan.store.add(self._records)
            self._records = []
        self._committed = time.monotonic()

    def _submit(self) -> bool:
        """Hand out runs: enough that no worker waits, few enough to start again."""
        left = len(self.plan.missing) // (4 * self.workers.size)
        size = max(1, min(self.workers.most, left, int(TASK_SECONDS / max(self._seconds, 1e-6))))
        submitted = False
        while len(self._under_way) < 2 * self.workers.size * size:
            if self._alone:
                tasks = [self._alone.popleft()]
            elif self._again:
                tasks = [self._again.popleft() for _ in range(min(size, len(self._again)))]
            else:
                tasks = list(itertools.islice(self._waiting, size))
            if not tasks:
                break
            self._under_way.update({task.run_id: task for task in tasks})
            self.workers.submit(tasks)
            submitted = True
        return submitted

    def _lost(self, task: Task, record: RunRecord, *, final: bool) -> None:
        """A run ended its worker: it is tried again, unless it did so before or was out of time."""
        self._deaths[task.run_id] += 1
        if final or self._deaths[task.run_id] > 1:
            self.plan.store.trajectory_file(task.run_id).unlink(missing_ok=True)
            self._end(task, record)
        else:
            self._alone.append(task)

    def _remark(self, remark: Remark) -> None:
        """Tell what is the same in all runs once."""
        if remark.line not in self._remarks:
            self._remarks.add(remark.line)
            self._notices.append(remark.line)

    def _end(self, task: Task, record: RunRecord) -> None:
        self._records.append(record)
        self._done += 1
        self._failed += record.failed
        if record.status == REFUSED:
            count, first = self.refused
            self.refused = (count + 1, first or f"{task.variant}: {record.message}")
        if record.wall_time is not None:
            self._seconds += 0.2 * (record.wall_time - self._seconds)

    def _tell(self) -> None:
        if self.progress is None:
            return
        now = time.monotonic()
        if now > self._looked + MEMORY_PERIOD or self._done == self.plan.total:
            self._memory, self._looked = self.workers.memory or self._memory, now
        under_way = sum(self._fractions.values())
        notices, self._notices = tuple(self._notices), []
        self.progress(
            Tally(self._done, self.plan.total, self._failed, self._memory, under_way, notices)
        )
