"""One run under way: slaves initialised, steps made, rows recorded."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable

from congelation.cosim.coupling import Coupling, Stepper
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.result import Statistics
from congelation.cosim.rows import Rows

__all__ = ["Progress", "Session", "just_before"]

Progress = Callable[[float], None]

PROGRESS_PERIOD = 0.1
"""Seconds between reports of progress."""

UNITS_BEFORE = 8.0
"""Units in the last place between a jump and the point that counts as before it."""


class Session:
    """What the fixed and the adaptive stepping share.

    Parameters
    ----------
    ensemble : Ensemble
    coupling : Coupling
    start, stop : float
        Seconds.
    tolerance : float or None
        For the step control.
    rows : Rows
    progress : callable or None
        Called with the fraction done, about ten times a second.

    Attributes
    ----------
    stepper : Stepper
        There once `initialise` is done.
    steps, rejected, events : int
        As in Statistics.
    """

    stepper: Stepper

    def __init__(
        self,
        ensemble: Ensemble,
        coupling: Coupling,
        start: float,
        stop: float,
        tolerance: float | None,
        rows: Rows,
        progress: Progress | None,
    ) -> None:
        self.ensemble = ensemble
        self.start, self.stop = start, stop
        self.steps = self.rejected = self.events = 0
        self._exchange = Exchange(ensemble)
        self._coupling = coupling
        self._tolerance = tolerance
        # A point on a jump makes a step of another length.
        self._lands = coupling.lands_on_events and all(
            member.description.can_vary_step for member in ensemble.system.members
        )
        self._rows = rows
        self._time = start
        self._progress = progress
        self._next_report = 0.0
        self._crossing_calls = 0
        self._is_initialised = False

    def initialise(self, slave_tolerance: float | None) -> None:
        """Start values, then outputs and inputs made to agree in initialisation mode.

        Raises
        ------
        SlaveError
            An FMU refused a value; a message of status fmi2Error counts as refusal.
        RunEnded
            An algebraic loop without solution, or a value that is not finite.
        """
        ensemble = self.ensemble
        for member, slave in zip(ensemble.system.members, ensemble.slaves, strict=True):
            slave.setup(self.start, self.stop, slave_tolerance)
            slave.set_values(member.start)
            slave.require_no_error()
        for slave in ensemble.slaves:
            slave.enter_initialization()
            slave.require_no_error()
        self._exchange.settle(self.start)
        for slave in ensemble.slaves:
            slave.require_no_error()
            slave.exit_initialization()
            slave.require_no_error()
        ensemble.outputs.stepping = True
        if ensemble.moves_derivatives:
            self._exchange.run(self.start)
        ensemble.outputs.read_all()
        ensemble.outputs.check(self.start)
        self._exchange.calls = 0
        self.stepper = self._coupling.stepper(ensemble, self._exchange, self._tolerance)
        self.stepper.start(self.start)
        self._is_initialised = True
        self._rows.start(self.start)

    def next_event(self, time: float) -> float:
        """The first announced jump after `time` on which a communication point is placed.

        It is at most the stop time, or infinite; within rounding of the stop time it is there.
        """
        event = self.ensemble.outputs.next_event(time) if self._lands else math.inf
        if event > self.stop:
            return math.inf
        return event if event < just_before(self.stop) else self.stop

    def cross(self, before: float, after: float) -> None:
        """Step over a jump that lies between two neighbouring points of time.

        Before it, derivatives are those of the left; after it, of the right, and outputs and
        inputs are made to agree anew.
        """
        ensemble = self.ensemble
        ensemble.outputs.check(before)
        self._rows.before_jump(before)
        ensemble.inputs.C[0] = ensemble.outputs.Y[ensemble.inputs.source]
        ensemble.inputs.C[1:] = 0.0
        for write in ensemble.inputs.write:
            write()
        for slave in ensemble.slaves:
            slave.step(before, after - before)
        self._crossing_calls += sum(ensemble.inputs.write_calls) + len(ensemble.slaves)
        self._exchange.run(after)
        self.stepper.start(after)
        self.events += 1
        ensemble.outputs.check(after)
        self._rows.after_jump(after)
        self._count(after)

    def record(self, time: float) -> None:
        """Check and record what was read at a communication point."""
        self.ensemble.outputs.check(time)
        self._rows.point(time)
        self._count(time)

    def finish(self, *, completed: bool) -> None:
        """Record what is still to be recorded."""
        if self._is_initialised:
            self._rows.finish(self._time, completed=completed)

    def _count(self, time: float) -> None:
        self._time = time
        self.steps += 1
        if self._progress is not None and clock.monotonic() >= self._next_report:
            self.report((time - self.start) / (self.stop - self.start))

    def report(self, fraction: float) -> None:
        """Report progress, if anyone listens."""
        if self._progress is not None:
            self._progress(fraction)
            self._next_report = clock.monotonic() + PROGRESS_PERIOD

    def statistics(self, wall_time: float) -> Statistics:
        """What the run took."""
        if not self._is_initialised:
            return Statistics(wall_time=wall_time)
        self.stepper.finish()
        return Statistics(
            macro_steps=self.steps,
            rejected=self.rejected,
            sweeps=self.stepper.sweeps,
            fmi_calls=self.stepper.calls + self._crossing_calls,
            events=self.events,
            estimated_error=self.stepper.estimated_error,
            wall_time=wall_time,
        )


def just_before(event: float) -> float:
    """The point of time that counts as before a jump.

    A few units in the last place earlier: with one alone, an FMU that computes its own time with
    a rounding error would already be past the jump.
    """
    return event - UNITS_BEFORE * math.ulp(event)
