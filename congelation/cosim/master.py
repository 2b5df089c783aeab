"""The master: runs a coupled system from its start time to its stop time."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import Coupling, Stepper, make_coupling
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.pool import SlavePool
from congelation.cosim.recorder import Recorder
from congelation.cosim.result import Result, RunEnded, Statistics, Status
from congelation.cosim.system import System
from congelation.errors import InvalidInput, SlaveError

__all__ = ["simulate"]

Floats = npt.NDArray[np.float64]
Progress = Callable[[float], None]

PROGRESS_PERIOD = 0.1
"""Seconds between reports of progress."""

GRID_ROUNDING = 1e-12
"""A horizon this near to a whole number of steps, relative, is taken to be one."""


def simulate(
    system: System,
    *,
    start_time: float = 0.0,
    stop_time: float,
    step: float | None = None,
    coupling: str | Coupling = "derivative",
    options: Mapping[str, object] | None = None,
    record: Sequence[str] | None = None,
    slave_tolerance: float | None = None,
    progress: Progress | None = None,
    pool: SlavePool | None = None,
) -> Result:
    """Run a coupled system.

    Parameters
    ----------
    system : System
    start_time, stop_time : float
        Seconds. The last step is shortened to end at `stop_time` exactly.
    step : float
        Communication step h in seconds: communication points are t_0 + k h.
    coupling : str or Coupling
        A name in COUPLINGS, or an instance.
    options : mapping, optional
        Options of a coupling given by its name.
    record : sequence of str, optional
        "component.variable"; a vector's name stands for all of its elements. By default every
        number among the outputs, der(.) and next_event left out.
    slave_tolerance : float, optional
        Relative tolerance given to the FMUs (fmi2SetupExperiment).
    progress : callable, optional
        Called with the fraction done, from 0 to 1, about ten times a second.
    pool : SlavePool, optional
        Lends the instances, and keeps them for the next run.

    Returns
    -------
    Result
        A failing FMU and a diverging run are statuses; every row up to there is kept.

    Raises
    ------
    InvalidInput
        The system, the times or the coupling are wrong.
    """
    step = _checked_step(start_time, stop_time, step)
    begin = clock.perf_counter()
    resolved = system.resolve()
    chosen = make_coupling(coupling, options) if isinstance(coupling, str) else coupling
    recorded = resolved.recorded(record)
    blocks: list[Floats] = []
    recorder = Recorder(len(recorded), blocks.append)
    run = _Run(start_time, stop_time, step, chosen, recorder, _Throttled(progress))
    with ExitStack() as stack:
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        try:
            slaves = stack.enter_context(lender.lend(resolved.members))
            ensemble = Ensemble(
                resolved,
                slaves,
                recorded,
                derivatives=chosen.needs_derivatives,
                events=chosen.lands_on_events,
            )
            run.initialise(ensemble, slave_tolerance)
            run.advance()
            status, message = Status.COMPLETED, Status.COMPLETED.value
        except RunEnded as end:
            status, message = end.status, end.message
        except SlaveError as error:
            status, message = Status.SLAVE_FAILED, str(error)
        statistics = run.statistics(clock.perf_counter() - begin)
    recorder.finish()
    rows = np.concatenate(blocks)
    return Result(
        status, message, rows[:, 0], tuple(item.name for item in recorded), rows[:, 1:], statistics
    )


def _checked_step(start_time: float, stop_time: float, step: float | None) -> float:
    if not (math.isfinite(start_time) and math.isfinite(stop_time) and stop_time > start_time):
        raise InvalidInput(
            f"stop_time {stop_time:g} must be finite and after start_time {start_time:g}"
        )
    if step is None:
        raise InvalidInput("give a communication step")
    if not (math.isfinite(step) and step > 0.0):
        raise InvalidInput(f"step {step:g} must be positive, in seconds")
    return step


def number_of_steps(start_time: float, stop_time: float, step: float) -> int:
    """Steps of length `step` from start to stop, the last one possibly shorter."""
    ratio = (stop_time - start_time) / step
    nearest = round(ratio)
    if nearest >= 1 and abs(ratio - nearest) <= GRID_ROUNDING * ratio:
        return nearest
    return math.ceil(ratio)


class _Throttled:
    """Reports progress now and then."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._next = 0.0

    def __call__(self, fraction: float) -> None:
        if self._progress is not None and clock.monotonic() >= self._next:
            self._progress(fraction)
            self._next = clock.monotonic() + PROGRESS_PERIOD

    def finish(self) -> None:
        if self._progress is not None:
            self._progress(1.0)


class _Run:
    """One run under way."""

    def __init__(
        self,
        start_time: float,
        stop_time: float,
        step: float,
        coupling: Coupling,
        recorder: Recorder,
        progress: _Throttled,
    ) -> None:
        self._start, self._stop, self._step = start_time, stop_time, step
        self._coupling = coupling
        self._recorder = recorder
        self._progress = progress
        self._steps = self._events = 0
        self._ensemble: Ensemble
        self._exchange: Exchange
        self._stepper: Stepper
        self._started = False

    def initialise(self, ensemble: Ensemble, slave_tolerance: float | None) -> None:
        """Start values, then outputs and inputs made to agree in initialisation mode."""
        self._ensemble, self._exchange = ensemble, Exchange(ensemble)
        for member, slave in zip(ensemble.system.members, ensemble.slaves, strict=True):
            slave.setup(self._start, self._stop, slave_tolerance)
            slave.set_values(member.start)
            slave.require_no_error()
        for slave in ensemble.slaves:
            slave.enter_initialization()
            slave.require_no_error()
        self._exchange.settle(self._start)
        for slave in ensemble.slaves:
            slave.exit_initialization()
            slave.require_no_error()
        ensemble.read_all()
        ensemble.check(self._start)
        self._exchange.calls = 0
        self._stepper = self._coupling.stepper(ensemble, self._exchange)
        self._stepper.start(self._start)
        self._started = True
        ensemble.fill(self._recorder.row(self._start))

    def advance(self) -> None:
        """From the start time to the stop time."""
        count = number_of_steps(self._start, self._stop, self._step)
        time = self._start
        for k in range(1, count + 1):
            end = self._stop if k == count else self._start + k * self._step
            self._macro_step(time, end)
            time = end
            self._progress((time - self._start) / (self._stop - self._start))
        self._progress.finish()

    def _macro_step(self, time: float, end: float) -> None:
        self._stepper.advance(time, end)
        self._ensemble.check(end)
        self._ensemble.fill(self._recorder.row(end))
        self._steps += 1

    def statistics(self, wall_time: float) -> Statistics:
        """What the run took."""
        if not self._started:
            return Statistics(wall_time=wall_time)
        self._stepper.finish()
        return Statistics(
            macro_steps=self._steps,
            sweeps=self._stepper.sweeps,
            fmi_calls=self._stepper.calls,
            events=self._events,
            estimated_error=self._stepper.estimated_error,
            wall_time=wall_time,
        )
