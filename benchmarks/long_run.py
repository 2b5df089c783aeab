"""A run of ten million macro steps, recorded to disk, with an eye on the memory.

As a program, ``python -m benchmarks.long_run STEPS EVERY``, it makes the run.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import process_time

from benchmarks.cases import figure, native
from benchmarks.engines.ours import coupled_system
from benchmarks.markdown import duration, table, verdict
from benchmarks.sweep_job import Cost, measured, resident

__all__ = ["LongRun", "long_run_table", "measure"]

STEP = 1e-4
"""Communication step in seconds, that of scenarios/fig2.toml."""
MARKS = (0.01, 0.1, 0.25, 0.5, 0.75, 1.0)
"""Parts of the run after which memory is printed."""
MEMORY_GOAL = 1.01
"""Memory at the end over that after the first mark."""


@dataclass(frozen=True)
class LongRun:
    """A long run.

    Parameters
    ----------
    steps, every : int
        Macro steps, and every how many of them a row was recorded.
    cost : Cost
    """

    steps: int
    every: int
    cost: Cost


def measure(steps: int, every: int) -> LongRun:
    """Fig. 2, Controller 1, native FMUs, held inputs, in a process of its own."""
    return LongRun(steps, every, measured("benchmarks.long_run", str(steps), str(every)))


def long_run_table(found: LongRun) -> list[str]:
    """Memory along the run, and what the run took."""
    answer = found.cost.answer
    memory = answer["memory"]
    rows = [
        (
            f"{mark['done'] * found.steps:,.0f}",
            f"{mark['memory'] / 1e6:.1f} MB",
            duration(mark["used"]),
        )
        for mark in memory
    ]
    growth = memory[-1]["memory"] / memory[0]["memory"]
    return [
        *table(("macro steps", "resident memory", "processor time"), rows),
        "",
        f"Goal: memory grows by at most {100.0 * (MEMORY_GOAL - 1.0):.0f} % after the first: "
        f"{verdict(growth <= MEMORY_GOAL)}. Every {found.every}th step was recorded: "
        f"{answer['rows']:,} rows of {answer['columns']} columns, {answer['size'] / 1e6:.0f} MB of "
        f"Parquet. The run took {duration(answer['wall_time'])}, "
        f"{memory[-1]['used'] / found.steps * 1e6:.1f} µs of processor time per macro step, and "
        f"ended {answer['status']}.",
    ]


def _run(steps: int, every: int, file: Path) -> dict[str, object]:
    # Here, so that the tables can be made without loading the master.
    from pyarrow.parquet import read_metadata

    from congelation.cosim import Output, ParquetFile, simulate

    loop = native(figure("fig2")).loop
    memory: list[dict[str, float]] = []
    begin = process_time()

    def watch(done: float) -> None:
        if len(memory) < len(MARKS) and done >= MARKS[len(memory)]:
            used = process_time() - begin
            memory.append({"done": done, "memory": resident(os.getpid()), "used": used})

    result = simulate(
        coupled_system(loop),
        stop_time=steps * STEP,
        step=STEP,
        coupling="jacobi",
        record=[f"{owner}.{name}" for owner, name in loop.record],
        output=Output(every=every, sink=ParquetFile(file)),
        progress=watch,
    )
    written = read_metadata(file)
    return {
        "status": result.status.name,
        "wall_time": result.statistics.wall_time,
        "rows": written.num_rows,
        "columns": written.num_columns,
        "size": file.stat().st_size,
        "memory": memory,
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(_run(int(sys.argv[1]), int(sys.argv[2]), Path(folder) / "run.parquet")))
