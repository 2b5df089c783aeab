"""CoFmuPy's coordinator, Jacobi.

It resets its FMUs after it has set their start values, so it runs them with their own only. Its
first inputs are zero, and the row labelled t holds the outputs at t + h.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from pathlib import Path

from cofmupy import Coordinator

from benchmarks.engines.base import Engine, Run
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch

__all__ = ["Cofmupy"]


class Cofmupy(Engine):
    """Every run is a coordinator of its own."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        given = [f"{c.name}.{name}" for c in loop.components for name in c.start]
        if given:
            raise ValueError(f"start values cannot be given: {', '.join(given)}")
        self._folder = tempfile.TemporaryDirectory()
        self._file = Path(self._folder.name) / "loop.json"
        self._file.write_text(json.dumps(_configuration(loop, self._folder.name)), "utf-8")

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Rows are recorded in any case; loading is left out of the time."""
        coordinator = Coordinator()
        with contextlib.redirect_stdout(io.StringIO()):
            coordinator.start(str(self._file))
        watch = Stopwatch()
        for _ in range(steps):
            coordinator.do_step(step)
        seconds = watch.seconds()
        if not keep_rows:
            return Run(seconds)
        results = coordinator.get_results()
        columns = [results[owner, name] for owner, name in self.loop.record]
        return Run(
            seconds,
            [[(n + 1) * step, *(float(c[n]) for c in columns)] for n in range(steps)],
        )


def _configuration(loop: Loop, folder: str) -> dict[str, object]:
    return {
        "root": folder,
        "edge_sep": " -> ",
        "cosim_method": "jacobi",
        "iterative": False,
        "fmus": [
            {"id": c.name, "name": c.name, "path": c.fmu, "initialization": {}}
            for c in loop.components
        ],
        "connections": [
            {"source": {"id": a, "variable": y}, "target": {"id": b, "variable": u}}
            for a, y, b, u in loop.connections
        ],
    }
