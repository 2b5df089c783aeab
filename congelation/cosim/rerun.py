"""Makes a run again with other steps, here or in a process of its own.

A process gets the system, the experiment and the file for its rows, pickled, on its standard input,
leaves how the run ended beside the rows, and ends when its input does: it never outlives the run
that it belongs to.
"""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from congelation.cosim.choice import Lack, without
from congelation.cosim.coupling import Coupling, Hermite
from congelation.cosim.coupling.interpolant import HIGH, LOW
from congelation.cosim.experiment import Experiment, slave_tolerance, step_count
from congelation.cosim.recording import Output
from congelation.cosim.result import Result, Statistics
from congelation.cosim.sinks import Memory, Sink
from congelation.cosim.system import MAX_DERIVATIVE, System

__all__ = ["Again", "Ahead", "At", "divided"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TIGHTER = 0.03
"""Tolerance of the iterations in the second run, relative to that of the first."""

TIGHTER_SLAVES = 0.01
"""Tolerance of the FMUs in the second run, relative to that of the first."""

NEAR = 1e-9
"""Rows of two runs are of the same time if they differ by less, relative to the shortest step."""

WORTH = 2.0
"""Seconds that a run must have left for a second process to be worth its start."""

LOOKED_AT = 0.05
"""Seconds of steps after which the length of a run is estimated."""

PROCESSORS = 2
"""Processors that two runs at once need."""

MODULE = "congelation.cosim.rerun"

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

    def abandon(self) -> None:
        """Leave what is there."""
        self._file.close()


class At(Sink):
    """Keeps the rows at some times.

    Parameters
    ----------
    times : array, shape (N,), or None
        Increasing; None: the times of all rows are kept, and no values.
    near : float
        Rows this near count, in seconds.
    """

    def __init__(self, times: Floats | None, near: float = 0.0) -> None:
        self._times, self._near = times, near
        self._kept = Memory()

    def open(self, columns: Sequence[str]) -> None:
        """Begin with nothing."""
        self._kept.open(columns if self._times is not None else columns[:1])

    def write(self, block: Floats) -> None:
        """Keep what is wanted of a block."""
        if self._times is None:
            self._kept.write(block[:, :1].copy())
        else:
            distance = np.abs(self._times[_nearest(self._times, block[:, 0])] - block[:, 0])
            self._kept.write(block[distance <= self._near])

    def close(self) -> None:
        """Nothing is left to do."""

    def abandon(self) -> None:
        """Nothing is left to do."""

    def times(self) -> Floats:
        """Of all rows, shape (N,)."""
        return self._kept.rows()[:, 0]

    def values(self) -> Floats:
        """The values at each of the times, shape (N, M); nan where there is no row."""
        assert self._times is not None
        rows = self._kept.rows()
        found = np.full((len(self._times), rows.shape[1] - 1), math.nan)
        if len(rows):
            found[_nearest(self._times, rows[:, 0])] = rows[:, 1:]
        return found


def _nearest(times: Floats, wanted: Floats) -> Indices:
    """The places in increasing times that are nearest to those wanted."""
    after = np.searchsorted(times, wanted).clip(1, len(times) - 1)
    return np.asarray(after - (wanted - times[after - 1] < times[after] - wanted), dtype=np.intp)


class Again:
    """Makes a run again, with other steps.

    Parameters
    ----------
    run : callable
        Performs an experiment.
    experiment : Experiment
        Of the run.
    statistics : Statistics
    points : array, shape (P,)
        Its communication points, the start time among them.
    table : array, shape (N, 1 + M)
        Its rows.
    interval : float or None
        Of its rows, where they have one of their own.
    ahead : Ahead
        May have made the run with halved steps already.
    """

    def __init__(
        self,
        run: Callable[..., Result],
        experiment: Experiment,
        statistics: Statistics,
        points: Floats,
        table: Floats,
        interval: float | None,
        ahead: Ahead,
    ) -> None:
        self._run, self._ahead = run, ahead
        self._interval = interval
        self.experiment, self.statistics = experiment, statistics
        self.points = points
        self.time, self.values = table[:, 0], table[:, 1:]
        self.steps = 0

    def halved(self, progress: Callable[[float], None] | None) -> tuple[Result, Floats]:
        """The run with every one of its steps halved, as `at` returns it."""
        if self._ahead.started:
            kept = At(self.time, NEAR * float(np.diff(self.points).min()) / 2.0)
            result = self._ahead.ended(kept)
            if result is not None:  # else its process has died, and it is made here
                self.steps += result.statistics.macro_steps
                return result, kept.values()
        points = halved_grid(self.experiment)
        if points is None:
            points = divided(self.points, 2 * self.statistics.parts)
        return self.at(points, progress)

    def at(
        self, points: Floats, progress: Callable[[float], None] | None = None
    ) -> tuple[Result, Floats]:
        """Another run over other communication points, shape (P,), tightened inside; and its values
        at the times of the rows, shape (N, M), nan where it has none."""
        lengths = np.diff(points)
        experiment = replace(
            tightened(self.experiment, self.statistics.order),
            stop_time=float(points[-1]),
            step=float(lengths.max()),
        )
        kept = At(self.time, NEAR * float(lengths.min()))
        result = self._run(
            experiment,
            [Output(interval=self._interval, sink=kept)],
            points=points[1:].tolist(),
            progress=progress,
        )
        self.steps += result.statistics.macro_steps
        return result, kept.values()


def tightened(experiment: Experiment, order: int) -> Experiment:
    """An experiment with the accuracy inside that a second run has: iterations that end closer to
    their solution, FMUs of a smaller tolerance, the highest order. Its steps are to be given.

    Parameters
    ----------
    experiment : Experiment
        Of the first run.
    order : int
        Of its coupling at work; LOW where inputs follow polynomials through exact derivatives.
    """
    coupling: Coupling = experiment.chosen_coupling
    if isinstance(coupling, Hermite):
        accuracy = min(coupling.tolerance, experiment.tolerance or coupling.tolerance)
        coupling = replace(
            coupling,
            order=HIGH if order == LOW else coupling.order,
            # One iteration takes no step back, which FMUs may not be able to.
            iterations=1 if coupling.iterations == 1 else None,
            tolerance=TIGHTER * accuracy,
        )
    slaves = slave_tolerance(experiment)
    return replace(
        experiment,
        step=experiment.step or experiment.stop_time - experiment.start_time,
        tolerance=None,
        coupling=coupling,
        options={},
        slave_tolerance=None if slaves is None else TIGHTER_SLAVES * slaves,
        output_interval=None,
        output_every=None,
        max_steps=None,
    )


def divided(points: Floats, parts: int) -> Floats:
    """Points, shape (P,), with each interval divided into so many; they stay what they are."""
    shares = np.arange(parts) / parts
    finer = points[:-1, None] + np.diff(points)[:, None] * shares
    return np.append(finer.reshape(-1), points[-1])


def halved_grid(experiment: Experiment) -> Floats | None:
    """The points t_0 + k h / 2 up to the stop time; None where steps are chosen.

    Jumps come besides, as in the first run.
    """
    start, stop, step = experiment.start_time, experiment.stop_time, experiment.step
    if step is None or experiment.tolerance is not None:
        return None
    count = step_count(start, stop, step)
    return divided(np.append(start + step * np.arange(count), stop), 2)


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
        """How the run in the process ended, its rows given to `kept`; None where it did not."""
        assert self._process is not None
        assert self._folder is not None
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
