"""One sweep in a process of its own: ``python -m benchmarks.sweep_job FOLDER JOB``.

It prints what it has to tell as a line of JSON; time and processor time are measured from outside,
so everything counts, Python's start as well.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from benchmarks.phases import Timers, read_runs, timed_execute
from congelation.scenario.axes import RandomAxis, Sweep
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.sweep.engine import Tally, carry_out
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study

__all__ = ["FRESH", "SWEEP", "Cost", "Job", "do", "elsewhere", "measured", "resident"]

ROOT = Path(__file__).absolute().parent.parent

SWEEP = "sweep"
FRESH = "fresh FMPy instances"

TIMED = "timed.jsonl"
"""In the folder of a job: what each run took, by phase."""
RESULTS = "results"
"""In the folder of a job: what a sweep wrote."""

SEED = 20180627


@dataclass(frozen=True)
class Job:
    """A sweep of Fig. 2 over epsilon.

    Parameters
    ----------
    points : int
        Runs of each variant.
    experiment : mapping
        Keys that replace those of scenarios/fig2.toml; None removes one.
    variants : tuple of str
    program : str
        SWEEP or FRESH.
    workers : int
        Processes of the sweep.
    phases : bool
        Whether to measure where the time goes.
    marks : tuple of int
        Memory is printed after so many runs.
    """

    points: int
    experiment: Mapping[str, float | str | None] = field(default_factory=dict)
    variants: tuple[str, ...] = ("Controller 1", "Controller 2")
    program: str = SWEEP
    workers: int = 1
    phases: bool = False
    marks: tuple[int, ...] = ()

    @property
    def runs(self) -> int:
        """Their number."""
        return self.points * len(self.variants)

    def scenario(self) -> Scenario:
        """Fig. 2 as this job changes it."""
        fig2 = load_scenario(ROOT / "scenarios" / "fig2.toml")
        return fig2.changed(
            experiment=replace(fig2.experiment, **self.experiment),
            variants=tuple(v for v in fig2.variants if v.name in self.variants),
            sweep=Sweep(
                axes=(RandomAxis("controller.epsilon", "uniform", (0.25, 0.35)),),
                samples=self.points,
                seed=SEED,
            ),
        )


@dataclass(frozen=True)
class Cost:
    """What a process took, with those that it started.

    Parameters
    ----------
    elapsed : float
        Seconds.
    used : float
        Seconds of processor time.
    others : float or None
        Seconds of processor time that everything else on the machine took meanwhile, all of its
        processors together; None where the system does not tell.
    answer : mapping
        What it printed.
    """

    elapsed: float
    used: float
    others: float | None
    answer: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        """As `benchmarks.timing` counts: processor time, or elapsed time where that is less."""
        return min(self.elapsed, self.used)


def elsewhere(job: Job, folder: Path) -> Cost:
    """Do a job in a process of its own; what it writes goes to a folder."""
    return measured("benchmarks.sweep_job", str(folder), json.dumps(asdict(job)))


def measured(module: str, *arguments: str) -> Cost:
    """Run a module in a process of its own; its last line of output is its answer, if JSON."""
    busy, used, begin = _busy(), _children(), perf_counter()
    ended = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=ROOT,
    )
    elapsed, used = perf_counter() - begin, _children() - used
    now = _busy()
    others = None if busy is None or now is None else max(0.0, now - busy - used)
    line = ended.stdout.splitlines()[-1] if ended.stdout else ""
    return Cost(elapsed, used, others, json.loads(line) if line.startswith("{") else {})


def _children() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _busy() -> float | None:
    """Seconds that all processors have been busy or taken away, where the system tells."""
    file = Path("/proc/stat")
    if not file.is_file():
        return None
    user, nice, system, _, _, irq, softirq, steal = file.read_text().split()[1:9]
    ticks = sum(int(value) for value in (user, nice, system, irq, softirq, steal))
    return ticks / os.sysconf("SC_CLK_TCK")


def do(job: Job, folder: Path) -> dict[str, Any]:
    """Do a job in this process; returns what there is to tell."""
    if job.program == FRESH:
        from benchmarks import fresh_fmpy  # here, as it imports what a sweep does without

        return {"runs": fresh_fmpy.sweep(job.scenario(), folder / "runs.csv")}
    begin = perf_counter()
    plan = plan_study(job.scenario(), folder / RESULTS, swept=True)
    planned = perf_counter()
    timers = Timers()
    timers.install("congelation.results.store", "Store.export", "index")
    watch = _Watch(job.marks)
    carry_out(plan, _workers(job, folder), watch)
    return {
        "runs": plan.total,
        "failed": watch.failed,
        "planning": planned - begin,
        "sweep": perf_counter() - planned,
        "index": timers.seconds["index"],
        "parent": process_time(),
        "phases": read_runs(folder / TIMED) if job.phases else [],
        "memory": watch.memory,
        "workers": len(watch.seen),
    }


def _workers(job: Job, folder: Path) -> Local:
    if not job.phases:
        return Local(job.workers)
    return Local(job.workers, partial(timed_execute, folder / TIMED))


class _Watch:
    """Follows the progress of a sweep, and the resident memory of its processes."""

    def __init__(self, marks: tuple[int, ...]) -> None:
        self.failed = 0
        self.memory: list[dict[str, int]] = []
        self.seen: set[int] = set()
        self._marks = list(marks)
        self._largest = 0

    def __call__(self, tally: Tally) -> None:
        self.failed = tally.failed
        if not self._marks:
            return
        children = [child.pid for child in multiprocessing.active_children() if child.pid]
        self.seen.update(children)
        self._largest = max([self._largest, *map(resident, children)])
        while self._marks and tally.done >= self._marks[0]:
            self.memory.append(
                {
                    "runs": self._marks.pop(0),
                    "parent": resident(os.getpid()),
                    "worker": self._largest,
                }
            )


def resident(process: int) -> int:
    """Bytes; 0 where the process has ended or the system does not tell."""
    try:
        pages = Path(f"/proc/{process}/statm").read_text().split()[1]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    given = json.loads(sys.argv[2])
    job = Job(**{**given, "variants": tuple(given["variants"]), "marks": tuple(given["marks"])})
    print(json.dumps(do(job, Path(sys.argv[1]))))
