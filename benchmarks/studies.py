"""Studies of short runs: how many runs of Fig. 2 per second, in one process and by workers.

``python -m benchmarks.studies [RUNS]`` prints a table. The FMUs are the native ones (fmus/native),
the tolerance is 1e-6, no trajectory is kept, and each run has five metrics.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from benchmarks.markdown import table
from congelation.cosim import master
from congelation.cosim.pool import SlavePool
from congelation.scenario.axes import RandomAxis, Sweep
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.sweep.engine import carry_out
from congelation.sweep.execute import execute
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study

__all__ = ["in_one_process", "measure", "study", "swept"]

ROOT = Path(__file__).absolute().parent.parent
SEED = 20180627
WARM = 20
"""Runs before the clock starts: they load the FMUs and import what metrics need."""


def study(runs: int) -> Scenario:
    """Controller 1 of Fig. 2 over epsilon, rows at communication points alone."""
    fig2 = load_scenario(ROOT / "scenarios" / "fig2.toml")
    components = tuple(
        replace(c, fmu=ROOT / "fmus" / "native" / Path(c.fmu).name) for c in fig2.system.components
    )
    record = ("plant.x[1]", "plant.x[2]", "controller.u")
    return fig2.changed(
        system=replace(fig2.system, components=components),
        experiment=replace(fig2.experiment, output_interval=None, record=record),
        measured=record,
        variants=fig2.variants[:1],
        sweep=Sweep(
            axes=(RandomAxis("controller.epsilon", "uniform", (0.25, 0.35)),),
            samples=runs,
            seed=SEED,
            trajectories=False,
        ),
    )


def in_one_process(runs: int) -> tuple[float, float]:
    """Seconds per run, and those of them outside `perform`'s stepping, by the processor's clock."""
    with tempfile.TemporaryDirectory() as folder, SlavePool() as pool:
        plan = plan_study(study(WARM + runs), Path(folder) / "out", swept=True)
        with closing(plan.store):
            tasks = list(plan.tasks())
            for task in tasks[:WARM]:
                execute(plan.job, task, pool, _ignore)
            with _timed_stepping() as spent:
                begin = process_time()
                for task in tasks[WARM:]:
                    outcome, _ = execute(plan.job, task, pool, _ignore)
                    assert outcome.status == "COMPLETED", outcome
                whole = process_time() - begin
    return whole / runs, (whole - sum(spent)) / runs


def swept(runs: int, workers: int) -> tuple[float, float]:
    """Seconds per run of a whole sweep by the clock, and by the processors: the plan, the start of
    the workers and the records included."""
    with tempfile.TemporaryDirectory() as folder:
        used, begin = _used(), perf_counter()
        plan = plan_study(study(runs), Path(folder) / "out", swept=True)
        results = carry_out(plan, Local(workers))
        elapsed, used = perf_counter() - begin, _used() - used
        assert all(run.status == "COMPLETED" for run in results.runs)
    return elapsed / runs, used / runs


def measure(runs: int) -> str:
    """The table."""
    whole, outside = in_one_process(runs)
    rows = [["one process", f"{1 / whole:.0f}", f"{1e3 * whole:.2f}", f"{1e3 * outside:.2f}"]]
    for workers in (1, 2):
        elapsed, used = swept(runs, workers)
        name = f"`sweep`, {workers} worker{'s' * (workers > 1)}"
        rows.append([name, f"{1 / elapsed:.0f}", f"{1e3 * used:.2f}", ""])
    heads = ["", "runs per second", "processor time per run, ms", "of it outside the stepping, ms"]
    return "\n".join(table(heads, rows))


@contextmanager
def _timed_stepping() -> Iterator[list[float]]:
    """Meanwhile the processor time of each run's stepping is noted."""
    spent: list[float] = []
    inner = master.run_adaptive

    def timed(*arguments: Any, **named: Any) -> None:
        begin = process_time()
        try:
            inner(*arguments, **named)
        finally:
            spent.append(process_time() - begin)

    master.run_adaptive = timed
    try:
        yield spent
    finally:
        master.run_adaptive = inner


def _ignore(fraction: float) -> None:
    pass


def _used() -> float:
    """Processor time of this process and its children that have ended, in seconds."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


if __name__ == "__main__":
    print(measure(int(sys.argv[1]) if len(sys.argv) > 1 else 1000))
