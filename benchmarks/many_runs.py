"""A study of a million planned runs: what its plan, its records and its resumption take.

``python -m benchmarks.many_runs [PLANNED EXECUTED]`` plans that many runs of the scalar loop,
executes a part of them by a stub in worker processes, ends as if killed, and plans anew.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from congelation.results.record import Outcome
from congelation.results.results import Results
from congelation.scenario.axes import RandomAxis, Sweep
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import Tally, carry_out
from congelation.sweep.execute import Job, Task
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study

__all__ = ["measure"]

SCENARIO = Path(__file__).absolute().parent.parent / "scenarios" / "scalar.toml"


class _EnoughError(Exception):
    """As many runs as asked for are done."""


def stub(
    job: Job, task: Task, pool: object, progress: Callable[[float], None]
) -> tuple[Outcome, bytes | None]:
    """A run that takes no time."""
    return Outcome("COMPLETED", "", wall_time=0.0, metrics={"peak_x": 1.0}), None


def measure(planned: int, executed: int) -> dict[str, float]:
    """Seconds and peak memory of the planning process, in MB."""
    fig = load_scenario(SCENARIO)
    axis = RandomAxis("controller.epsilon", "uniform", (0.2, 1.0))
    samples = planned // len(fig.variants)
    scenario = replace(fig, sweep=Sweep(axes=(axis,), samples=samples))
    found: dict[str, float] = {"planned": samples * len(fig.variants)}

    def enough(tally: Tally) -> None:
        if tally.done >= executed:
            raise _EnoughError

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        begin = time.perf_counter()
        plan = plan_study(scenario, out, swept=True)
        found["planning"] = time.perf_counter() - begin
        found["memory after planning"] = _peak()
        begin = time.perf_counter()
        with suppress(_EnoughError):
            carry_out(plan, Local(2, stub), enough)  # type: ignore[arg-type]
        found["executing"] = time.perf_counter() - begin
        found["executed"] = len(Results(out).runs)
        found["memory"] = _peak()
        begin = time.perf_counter()
        again = plan_study(scenario, out, swept=True, resume=True)
        next(again.tasks())
        found["resuming"] = time.perf_counter() - begin
        found["left"] = len(again.missing)
        found["size of runs.sqlite"] = again.store.database.stat().st_size / 1e6
        again.store.close()
    return found


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    from benchmarks.many_runs import measure  # workers find the stub there, not in this script

    sizes = [int(word) for word in sys.argv[1:]] or [1_000_000, 100_000]
    print(json.dumps(measure(*sizes)))
