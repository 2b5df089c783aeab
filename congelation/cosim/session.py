"""One run under way: the FMUs made ready, jumps crossed, rows recorded, steps counted."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from congelation.cosim.columns import Columns
from congelation.cosim.compiled import (
    CHUNK,
    CompiledHeld,
    CompiledIntegrator,
    CompiledPolynomials,
    Loop,
)
from congelation.cosim.coupling import Coupling, Stepper
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.recording import Rows
from congelation.cosim.result import RunEnded, Statistics, Status
from congelation.cosim.system import ResolvedSystem
from congelation.errors import counted

__all__ = ["NOTICE", "Notice", "Progress", "Session"]

Progress = Callable[[float], None]

PROGRESS_PERIOD = 0.1
"""Seconds between reports of progress."""

LOOK_PERIOD = 2.0
"""Seconds over which the pace of a run is measured."""

FIRST_CHUNK = 16
"""Steps that the compiled loop makes before progress is looked at for the first time."""

COLLAPSED = 1e5
"""Remaining steps above which the steps of a run count as collapsed."""

LONG = 30.0
"""Remaining time, in seconds, above which collapsed steps are reported."""

UNITS_BEFORE = 8.0
"""Units in the last place within which two times are the same."""

GAP = 1e-9
"""Part of the horizon between an announced jump and the point that counts as before it. Sources
that compare with a margin (``t >= 0.35 - 1e-12``) have jumped a little before the time announced.
Inputs are held over the gap, which costs half of their rate times its square."""


@dataclass
class Notice:
    """A message about the steps of the current run of this process.

    `line` is empty if there is none; the process that reports progress takes it by `taken`.
    """

    line: str = ""

    def taken(self) -> str:
        """Return the line and empty it."""
        line, self.line = self.line, ""
        return line


NOTICE = Notice()


class Session:
    """One run under way: what both loops share. It can be kept for further runs that differ in
    start values alone; see `begin`.

    Parameters
    ----------
    ensemble : Ensemble
    coupling : Coupling
    columns : Columns
        What is recorded.
    start, stop : float
        Seconds.
    tolerance : float or None
        For the step control.
    max_steps : int or None

    Attributes
    ----------
    stepper : Stepper
        There once `initialise` is done.
    compiled : object
        What makes the steps in C, or None; there once it was asked for, see `stepping`.
    integrator : CompiledIntegrator
        The same of `model_exchange`, see `integration`.
    steps, rejected, events, largest_error
        As in Statistics, `largest_error` for steps that are chosen by a tolerance.
    exchange : Exchange
    lands : bool
        Whether communication points are placed on announced jumps.
    floors : int
        Steps whose error comes from the FMUs rather than from the step.
    kept : int
        Steps that were kept although their error was above the tolerance.
    missed : int
        Steps within which a discrete value changed, and that could not be shortened to where.
    repeats : bool
        Whether steps of given length are made again from saved states.
    takes_back : bool
        Whether all FMUs can save their state, so that a step can be taken back.
    """

    stepper: Stepper[Any]
    compiled: CompiledHeld | CompiledPolynomials | None
    integrator: CompiledIntegrator
    rows: tuple[Rows, ...]

    def __init__(
        self,
        ensemble: Ensemble,
        coupling: Coupling,
        columns: Columns,
        start: float,
        stop: float,
        tolerance: float | None,
        max_steps: int | None,
    ) -> None:
        self.ensemble = ensemble
        self.columns = columns
        self.start, self.stop = start, stop
        self.exchange = Exchange(ensemble)
        self._coupling = coupling
        self._tolerance = tolerance
        self._max_steps = math.inf if max_steps is None else max_steps
        self.repeats = coupling.rolls_back
        self.takes_back = all(m.description.can_get_and_set_state for m in ensemble.system.members)
        # A point on a jump makes a step of another length.
        self.lands = coupling.lands_on_events and all(
            member.description.can_vary_step for member in ensemble.system.members
        )

    def begin(
        self, system: ResolvedSystem, rows: Sequence[Rows], progress: Progress | None
    ) -> None:
        """Get ready for a run.

        Parameters
        ----------
        system : ResolvedSystem
            That of the ensemble, perhaps with other start values.
        rows : sequence of Rows
        progress : callable or None
            Called with the fraction done, about ten times a second.
        """
        self.ensemble.begin(system)
        self.steps = self.rejected = self.events = self.floors = self.kept = self.missed = 0
        self.largest_error = 0.0
        self.rows = tuple(rows)
        self._time = self.start
        self._progress = progress
        self._next_report = 0.0
        NOTICE.line = ""
        self._begun = clock.monotonic()
        self._looked = self._begun, 0, self.start
        self._next_look = math.inf if self._tolerance is None else self._looked[0] + LOOK_PERIOD
        self._is_initialised = False

    def initialise(self, slave_tolerance: float | None) -> Any:
        """Start values, then outputs and inputs made to agree in initialisation mode.

        Returns
        -------
        state
            Of the coupling, at the start time.

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
            slave.set_start(member.start)
            slave.require_no_error()
        for slave in ensemble.slaves:
            slave.enter_initialization()
            slave.require_no_error()
        self.exchange.settle(self.start)
        for slave in ensemble.slaves:
            slave.require_no_error()
            slave.exit_initialization()
            slave.require_no_error()
        ensemble.stepping = True
        if ensemble.moves_derivatives:
            self.exchange.run(self.start)
        ensemble.read_all()
        ensemble.check(self.start)
        ensemble.calls = 0
        if "stepper" in vars(self):
            self.stepper.renew()
        else:
            self.stepper = self._coupling.stepper(ensemble, self.exchange, self._tolerance)
        state = self.stepper.start(self.start, None)
        self._is_initialised = True
        for rows in self.rows:
            rows.start(self.start)
        return state

    def next_event(self, time: float) -> float:
        """The first announced jump after `time` on which a communication point is placed.

        It is at most the stop time, or infinite; within rounding of the stop time it is there.
        """
        event = self.ensemble.next_event(time) if self.lands else math.inf
        if event > self.stop:
            return math.inf
        return event if event < just_before(self.stop) else self.stop

    def before(self, event: float) -> float:
        """The point of time that counts as before an announced jump."""
        return event - max(UNITS_BEFORE * math.ulp(event), GAP * (self.stop - self.start))

    def cross(self, state: Any, before: float, after: float) -> Any:
        """Step over a jump that lies between two neighbouring points of time.

        Before it, derivatives are those of the left; after it, of the right, and outputs and
        inputs are made to agree anew.

        Returns
        -------
        state
            Of the coupling, after the jump.
        """
        ensemble = self.ensemble
        self.leave(before)
        ensemble.C[0] = ensemble.Y[ensemble.source]
        ensemble.C[1:] = 0.0
        for write in ensemble.write:
            write()
        for slave in ensemble.slaves:
            slave.step(before, after - before)
        ensemble.calls += sum(ensemble.write_calls) + len(ensemble.slaves)
        self.exchange.run(after)
        state = self.stepper.start(after, state)
        self.arrive(after)
        return state

    def leave(self, time: float) -> None:
        """Check and record what was read before a jump."""
        self.ensemble.check(time)
        for rows in self.rows:
            rows.before_jump(time)

    def arrive(self, time: float) -> None:
        """Check and record what was read after a jump."""
        self.events += 1
        self.ensemble.check(time)
        for rows in self.rows:
            rows.after_jump(time)
        self._count(time)

    def record(self, time: float) -> None:
        """Check and record what was read at a communication point."""
        self.ensemble.check(time)
        for rows in self.rows:
            rows.point(time)
        self._count(time)

    def unresolved(self, time: float) -> float:
        """Whether the step to `time` is too long for what is recorded in it; above 1 it is."""
        return max((rows.unresolved(time) for rows in self.rows), default=0.0)

    def _count(self, time: float) -> None:
        length, self._time = time - self._time, time
        self.steps += 1
        if self.steps + self.rejected >= self._max_steps and time < self.stop:
            raise RunEnded(
                Status.TOO_MANY_STEPS,
                f"{counted(self.steps, 'step')} (and {self.rejected} taken back) reached "
                f"t = {time:.9g} of {self.stop:.9g}; the last one was {length:.3g} s long",
            )
        if self._progress is not None and (now := clock.monotonic()) >= self._next_report:
            if now >= self._next_look:
                self._look(now)
            self.report((time - self.start) / (self.stop - self.start))

    def _look(self, now: float) -> None:
        """Leave a notice, once per run, if the steps are so short that the rest takes long."""
        before, steps, time = self._looked
        self._looked = now, self.steps, self._time
        self._next_look = now + LOOK_PERIOD
        length = (self._time - time) / max(self.steps - steps, 1)
        left = (self.stop - self._time) / max(length, math.ulp(self._time), math.ulp(0.0))
        seconds = left * (now - before) / max(self.steps - steps, 1)
        if left > COLLAPSED and seconds > LONG:
            duration = f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.3g} min"
            NOTICE.line = (
                f"at t = {self._time:.6g} of {self.stop:.6g} s the steps are {length:.2g} s long: "
                f"if they stay so, the rest takes {left:.1g} steps and about {duration}; a larger "
                "tolerance makes them longer, max_steps or --timeout ends the run"
            )
            self._next_look = math.inf

    def took(self, loop: Loop) -> None:
        """Count what the compiled loop did.

        Raises
        ------
        RunEnded
            TOO_MANY_STEPS.
        """
        self.rejected += loop.rejected
        self.events += loop.events_crossed
        self.floors += loop.floors
        self.ensemble.calls += loop.calls
        self.stepper.iterations += loop.passes
        self.largest_error = max(self.largest_error, loop.largest_error)
        if loop.steps:
            if loop.steps > 1:
                self._time = loop.counted_before
            self.steps += loop.steps - 1
            self._count(loop.counted)

    @property
    def most(self) -> int:
        """Steps that the compiled loop may make at once, those taken back included."""
        left = self._max_steps - self.steps - self.rejected
        # Few at first: where each step takes long, progress is to be known soon.
        chunk = FIRST_CHUNK
        if self.steps:  # then as many as are likely to be made in a period of reports
            spent = clock.monotonic() - self._begun
            chunk = max(chunk, int(min(CHUNK, self.steps * PROGRESS_PERIOD / max(spent, 1e-9))))
        return int(max(1, min(CHUNK, left, chunk)))

    def report(self, fraction: float) -> None:
        """Report progress, if anyone listens."""
        if self._progress is not None:
            self._progress(fraction)
            self._next_report = clock.monotonic() + PROGRESS_PERIOD

    def finish(self, *, completed: bool) -> None:
        """Record what is still to be recorded; fmi2Terminate is due after a completed run."""
        if self._is_initialised:
            for rows in self.rows:
                rows.finish(self._time, completed=completed)
        if completed:
            for slave in self.ensemble.slaves:
                slave.complete()

    def statistics(self, wall_time: float) -> Statistics:
        """What the run took."""
        if not self._is_initialised:
            return Statistics(wall_time=wall_time)
        stepper = self.stepper
        return Statistics(
            macro_steps=self.steps,
            rejected=self.rejected,
            iterations=stepper.iterations,
            fmi_calls=self.ensemble.calls + stepper.iterations * stepper.calls_per_iteration,
            events=self.events,
            floors=self.floors,
            warnings=sum(slave.log.warnings for slave in self.ensemble.slaves),
            estimated_error=max(self.largest_error, stepper.largest_error()),
            wall_time=wall_time,
            order=stepper.order,
            parts=2 if self._tolerance is not None and stepper.halves else 1,
        )


def just_before(event: float) -> float:
    """The last point of time that cannot be told from that of a jump: an FMU may compute its own
    time with a rounding error."""
    return event - UNITS_BEFORE * math.ulp(event)
