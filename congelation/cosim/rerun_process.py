"""The run with halved steps in a process of its own, beside the first one.

The process gets the system, the experiment and the file for its rows, pickled, on its standard
input, leaves how the run ended beside the rows, and ends when its input does: it never outlives the
run that it belongs to.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time as clock
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from congelation.cosim.choice import Lack, without
from congelation.cosim.coupling.interpolant import LOW
from congelation.cosim.experiment import Experiment
from congelation.cosim.recording import Output
from congelation.cosim.rerun import At, halved_grid, tightened
from congelation.cosim.result import Result
from congelation.cosim.sinks import Sink
from congelation.cosim.system import MAX_DERIVATIVE, System

__all__ = ["Ahead"]

Floats = npt.NDArray[np.float64]

WORTH = 2.0
"""Seconds that a run must have left for a second process to be worth its start."""

LOOKED_AT = 0.05
"""Seconds of steps after which the length of a run is estimated."""

PROCESSORS = 2
"""Processors that two runs at once need."""

MODULE = "congelation.cosim.rerun_process"

ROWS, ENDED = "rows", "ended"
"""What a process leaves in its folder."""

READ_AT_ONCE = 100_000
"""Rows of a process that are looked at in one piece."""


class _Doubles(Sink):
    """Writes rows to a file as they stand in memory, for another process of this machine.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def open(self, columns: Sequence[str]) -> None:
        """Create the file."""
        self._file = self._path.open("wb")

    def write(self, block: Floats) -> None:
        """Add the block."""
        block.tofile(self._file)

    def close(self) -> None:
        """Complete the file."""
        self._file.close()


class Ahead:
    """The run with halved steps in a process of its own, while the first one is under way.

    Fixed steps are known beforehand, and so are halved ones. Where a processor is free and enough
    is left to do, the second run starts with the first one's progress.

    Parameters
    ----------
    system : System
    experiment : Experiment
    output : Output
        Of the first run.
    progress : callable or None
        Called with the first run's progress.
    lacks : sequence of Lack
        As in `perform`.

    Attributes
    ----------
    started : bool
    """

    def __init__(
        self,
        system: System,
        experiment: Experiment,
        output: Output,
        progress: Callable[[float], None] | None,
        lacks: Sequence[Lack] = (),
    ) -> None:
        self._lacks = tuple(lacks)
        self._system, self._experiment, self._output = system, experiment, output
        self._listener = progress
        self._first: tuple[float, float] | None = None
        self._place = os.getcwd()  # an FMU may leave it
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        coupling = experiment.chosen_coupling
        self._possible = (
            experiment.tolerance is None
            and len(os.sched_getaffinity(0)) >= PROCESSORS
            # The process knows the classes of this package alone.
            and type(coupling).__module__.startswith("congelation.")
        )

    @property
    def started(self) -> bool:
        """Whether the process was started."""
        return self._process is not None

    def progress(self, fraction: float) -> None:
        """Take the first run's progress, and start the process once it is worth it."""
        if self._possible and not self.started:
            now = clock.perf_counter()
            if self._first is None:
                self._first = now, fraction
            begun, before = self._first
            elapsed, made = now - begun, fraction - before
            if made > 0.0 and elapsed >= LOOKED_AT and elapsed * (1.0 - fraction) >= WORTH * made:
                self._start()
        if self._listener is not None:
            self._listener(fraction)

    def _start(self) -> None:
        experiment = self._experiment
        self._folder = tempfile.TemporaryDirectory()
        rows = Path(self._folder.name, ROWS)
        request = (
            self._system,
            tightened(experiment, LOW if self._is_exact() else 1),
            Output(interval=self._output.interval, sink=_Doubles(rows)),
            experiment,  # of which the points are made there: the pipe holds few of them
            self._lacks,
            Path(self._folder.name, ENDED),
        )
        self._process = subprocess.Popen(
            [sys.executable, "-m", MODULE],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self._place,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        assert self._process.stdin is not None
        pickle.dump(request, self._process.stdin)
        self._process.stdin.flush()

    def _is_exact(self) -> bool:
        """Whether `hermite` has exact derivatives to follow in this system, and may follow them."""
        system = without(self._system.resolve(), self._lacks)
        return all(
            system.input_order(link) == MAX_DERIVATIVE and system.knows_derivative(link)
            for link in system.links
        )

    def ended(self, kept: At) -> Result | None:
        """How the run in the process ended, its rows given to `kept`; None where none was started,
        or it did not come to its end."""
        if self._process is None or self._folder is None:
            return None
        self._process.wait()
        ended, rows = Path(self._folder.name, ENDED), Path(self._folder.name, ROWS)
        if not ended.is_file():
            return None
        result: Result = pickle.loads(ended.read_bytes())
        columns = ["time", *result.names]
        table = np.memmap(rows, np.float64, "r").reshape(-1, len(columns))
        kept.open(columns)
        for begin in range(0, len(table), READ_AT_ONCE):
            kept.write(table[begin : begin + READ_AT_ONCE])
        return result

    def close(self) -> None:
        """End the process, and leave nothing."""
        if self._process is not None:
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
            if self._process.stdin is not None:
                self._process.stdin.close()
        if self._folder is not None:
            self._folder.cleanup()


def _serve() -> None:
    """What the process does."""
    from congelation.cosim.master import perform  # which knows this module

    system, experiment, output, first, lacks, ended = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_input, daemon=True).start()
    points = halved_grid(first)
    assert points is not None  # as there is no tolerance
    result = perform(system, experiment, output=output, points=points[1:].tolist(), lacks=lacks)
    part = ended.with_suffix(".part")
    part.write_bytes(pickle.dumps(result))
    part.replace(ended)
    # FMUs may crash a process that ends in the usual way.
    os._exit(0)


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    _serve()
