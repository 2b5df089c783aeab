"""The loop over time: a fixed step, or steps chosen by a tolerance; both land on jumps.

The state of the coupling is a value in these loops. A trial of a step returns a new one; where the
step is taken back, the new one is dropped and the FMUs are restored.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.compiled import (
    CHUNK,
    NOT_FINITE,
    REFUSED,
    UNUSUAL,
    CompiledHeld,
    CompiledPolynomials,
    Loop,
    fits,
)
from congelation.cosim.coupling import AdaptiveStepper, Coupling, Stepper, Trial
from congelation.cosim.coupling.derivative import DerivativeStepper
from congelation.cosim.coupling.held import GaussSeidelStepper, JacobiStepper
from congelation.cosim.coupling.hermite import HermiteStepper
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.experiment import step_count
from congelation.cosim.recording import Rows
from congelation.cosim.result import RunEnded, Statistics, Status
from congelation.cosim.step_control import Halving, StepSize, halved, is_floor
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["GivenPoints", "Grid", "Progress", "Session", "run_adaptive", "run_fixed"]

Floats = npt.NDArray[np.float64]
Progress = Callable[[float], None]

PROGRESS_PERIOD = 0.1
"""Seconds between reports of progress."""

UNITS_BEFORE = 8.0
"""Units in the last place between a jump and the point that counts as before it."""

EVENT_ROUNDING = 1e-9
"""A jump this near to a grid point, in steps, is taken to lie on it."""

STRETCH = 1.1
"""A step is stretched by so much to reach its target, rather than leave a tiny one."""

FIRST_SHARE = 1e-2
"""Of the horizon: the longest first step."""

SMALLEST_STEP = 16.0
"""In units in the last place of time: below it, time does not resolve a step."""

SMALLEST_SHARE = 1e-15
"""Of the horizon: the same near t = 0, where doubles resolve times of no meaning."""


class Session:
    """One run under way: what both loops share.

    Parameters
    ----------
    ensemble : Ensemble
    coupling : Coupling
    start, stop : float
        Seconds.
    tolerance : float or None
        For the step control.
    max_steps : int or None
    rows : sequence of Rows
    progress : callable or None
        Called with the fraction done, about ten times a second.

    Attributes
    ----------
    stepper : Stepper
        There once `initialise` is done.
    steps, rejected, events, largest_error
        As in Statistics, `largest_error` for steps that are chosen by a tolerance.
    floors : int
        Steps whose error comes from the FMUs rather than from the step.
    """

    stepper: Stepper[Any]

    def __init__(
        self,
        ensemble: Ensemble,
        coupling: Coupling,
        start: float,
        stop: float,
        tolerance: float | None,
        max_steps: int | None,
        rows: Sequence[Rows],
        progress: Progress | None,
    ) -> None:
        self.ensemble = ensemble
        self.start, self.stop = start, stop
        self.steps = self.rejected = self.events = self.floors = 0
        self.largest_error = 0.0
        self._exchange = Exchange(ensemble)
        self._coupling = coupling
        self._tolerance = tolerance
        self._max_steps = math.inf if max_steps is None else max_steps
        # A point on a jump makes a step of another length.
        self._lands = coupling.lands_on_events and all(
            member.description.can_vary_step for member in ensemble.system.members
        )
        self.rows = tuple(rows)
        self._time = start
        self._progress = progress
        self._next_report = 0.0
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
        ensemble.stepping = True
        if ensemble.moves_derivatives:
            self._exchange.run(self.start)
        ensemble.read_all()
        ensemble.check(self.start)
        ensemble.calls = 0
        self.stepper = self._coupling.stepper(ensemble, self._exchange, self._tolerance)
        state = self.stepper.start(self.start, None)
        self._is_initialised = True
        for rows in self.rows:
            rows.start(self.start)
        return state

    def next_event(self, time: float) -> float:
        """The first announced jump after `time` on which a communication point is placed.

        It is at most the stop time, or infinite; within rounding of the stop time it is there.
        """
        event = self.ensemble.next_event(time) if self._lands else math.inf
        if event > self.stop:
            return math.inf
        return event if event < just_before(self.stop) else self.stop

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
        ensemble.check(before)
        for rows in self.rows:
            rows.before_jump(before)
        ensemble.C[0] = ensemble.Y[ensemble.source]
        ensemble.C[1:] = 0.0
        for write in ensemble.write:
            write()
        for slave in ensemble.slaves:
            slave.step(before, after - before)
        ensemble.calls += sum(ensemble.write_calls) + len(ensemble.slaves)
        self._exchange.run(after)
        state = self.stepper.start(after, state)
        self.events += 1
        ensemble.check(after)
        for rows in self.rows:
            rows.after_jump(after)
        self._count(after)
        return state

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
                f"{self.steps} steps (and {self.rejected} taken back) reached t = {time:.9g} of "
                f"{self.stop:.9g}; the last one was {length:.3g} s long",
            )
        if self._progress is not None and clock.monotonic() >= self._next_report:
            self.report((time - self.start) / (self.stop - self.start))

    def took(self, loop: Loop, time: float) -> None:
        """Count what the compiled loop did, up to the communication point `time`.

        Raises
        ------
        RunEnded
            TOO_MANY_STEPS.
        """
        if loop.steps:
            self._time = loop.time  # where the last step began
            self.steps += loop.steps - 1
        self.rejected += loop.rejected
        self.stepper.iterations += loop.passes
        self.largest_error = max(self.largest_error, loop.largest_error)
        if loop.steps:
            self._count(time)

    @property
    def most(self) -> int:
        """Steps that the compiled loop may make at once, those taken back included."""
        return int(max(1, min(CHUNK, self._max_steps - self.steps - self.rejected)))

    def report(self, fraction: float) -> None:
        """Report progress, if anyone listens."""
        if self._progress is not None:
            self._progress(fraction)
            self._next_report = clock.monotonic() + PROGRESS_PERIOD

    def finish(self, *, completed: bool) -> None:
        """Record what is still to be recorded."""
        if self._is_initialised:
            for rows in self.rows:
                rows.finish(self._time, completed=completed)

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
    """The point of time that counts as before a jump.

    A few units in the last place earlier: with one alone, an FMU that computes its own time with
    a rounding error would already be past the jump.
    """
    return event - UNITS_BEFORE * math.ulp(event)


class Grid:
    """The points t_0 + k h for `run_fixed`, the last one at the stop time exactly."""

    def __init__(self, start: float, stop: float, step: float) -> None:
        self._start, self._stop, self._step = start, stop, step
        self._count = step_count(start, stop, step)
        self.near = EVENT_ROUNDING * min(step, stop - start)

    def __iter__(self) -> Iterator[float]:
        for k in range(1, self._count):
            yield self._start + k * self._step
        yield self._stop

    def after(self, k: int, most: int) -> Floats:
        """The points that follow the first k, at most so many of them."""
        last = min(self._count, k + most)
        points = np.arange(k + 1, last + 1, dtype=np.float64) * self._step + self._start
        if last == self._count:
            points[-1:] = self._stop
        return points


class GivenPoints:
    """Any other points for `run_fixed`, the last one the stop time."""

    def __init__(self, points: Sequence[float], start: float) -> None:
        self._points = np.asarray(points)
        self.near = EVENT_ROUNDING * float(np.diff(self._points, prepend=start).min())

    def __iter__(self) -> Iterator[float]:
        return iter(self._points.tolist())

    def after(self, k: int, most: int) -> Floats:
        """As of `Grid`."""
        found: Floats = self._points[k : k + most]
        return found


def run_fixed(session: Session, state: Any, points: Grid | GivenPoints) -> None:
    """Step from each communication point to the next; the last one is the stop time.

    Where a component announces a jump inside a step, the step is divided there.

    Parameters
    ----------
    session : Session
    state
        Of the coupling, at the start time.
    points : Grid or GivenPoints
        Communication points after the start, in seconds. A jump within `near` of one is taken to
        lie on it.
    """
    near, advance, record = points.near, session.stepper.advance, session.record
    event = session.next_event(session.start)
    compiled = _compiled_fixed(session)
    time, k = session.start, 0
    while len(ends := points.after(k, session.most)):
        if compiled is not None:
            # Up to the point that a jump comes before.
            until = int(np.searchsorted(ends + near, event))
            state, made = _made(session, compiled, state, time, ends[:until])
            k += made
            if made:
                time = float(ends[made - 1])
            if made == until < len(ends):
                ends = ends[made : made + 1]
            else:
                continue
        for end in ends.tolist():
            k += 1
            while event <= end + near:
                before = min(just_before(event), end)
                after = max(event, end) if abs(end - event) <= near else event
                if before > time:
                    state = advance(state, time, before)
                else:
                    before = time
                state = session.cross(state, before, after)
                time = after
                event = session.next_event(time)
            if time < end:
                # In double precision time + (end - time) is end, so the slaves' own times do not
                # drift from the grid.
                state = advance(state, time, end)
                record(end)
                time = end


def _compiled_fixed(session: Session) -> CompiledHeld | CompiledPolynomials | None:
    """The compiled loop for fixed steps, if this is a run that it makes."""
    stepper, ensemble, rows = session.stepper, session.ensemble, session.rows
    if not fits(ensemble, rows):
        return None
    if isinstance(stepper, JacobiStepper | GaussSeidelStepper):
        return CompiledHeld(ensemble, rows, sequential=stepper.sequential)
    if isinstance(stepper, DerivativeStepper) and (ahead := stepper.plan()) is not None:
        horizon = session.stop - session.start
        return CompiledPolynomials(ensemble, rows, ahead, 1.0, horizon)
    return None


def _made(
    session: Session,
    compiled: CompiledHeld | CompiledPolynomials,
    state: Any,
    time: float,
    ends: Floats,
) -> tuple[Any, int]:
    """The state after steps by the compiled loop, and how many it made, up to all of `ends`.

    Raises
    ------
    RunEnded, SlaveError, SlaveTerminated
        What ended the run; Python says which value it is, or what an FMU has said.
    """
    if not len(ends):
        return state, 0
    if isinstance(compiled, CompiledHeld):
        code = compiled.run(time, ends)
    else:
        code, state = compiled.fixed(state, time, ends)
    made = compiled.loop.steps
    at = float(ends[made - 1]) if made else time
    if made and isinstance(session.stepper, DerivativeStepper):
        session.stepper.watch.passed(at, state.now)
    session.took(compiled.loop, at)
    if code == REFUSED:
        compiled.refuse()
    if code == NOT_FINITE:
        session.record(float(ends[made]))
        made += 1
    return state, made


def run_adaptive(
    session: Session,
    state: Any,
    tolerance: float,
    first_step: float | None,
) -> None:
    """Step from start to stop with the estimated error of each step below `tolerance`.

    Steps land on every announced jump. A step that is too inaccurate, whose iterations do not
    converge, that overflows or that an FMU discards is taken back and tried again shorter.

    Raises
    ------
    RunEnded
        STEP_TOO_SMALL or NOT_CONVERGED, which name the connection, or what the smallest step
        ended with.
    SlaveError
    """
    stepper, ensemble = session.stepper, session.ensemble
    assert isinstance(stepper, AdaptiveStepper)  # as a tolerance is given
    horizon = session.stop - session.start
    halving = Halving(np.abs(ensemble.Y[ensemble.source]), np.ones(len(ensemble.links)), 0)
    guess = min(stepper.first_step(state), FIRST_SHARE * horizon)
    size = StepSize(first_step if first_step is not None else guess)
    time = session.start
    compiled = _compiled_adaptive(session, tolerance)
    while time < session.stop:
        event = session.next_event(time)
        target = min(session.stop, just_before(event))
        while time < target:
            if compiled is not None:
                code, state, size, time = compiled.adaptive(
                    state,
                    size,
                    time,
                    target,
                    most=session.most,
                    records_target=math.isinf(event),
                )
                session.took(compiled.loop, time)
                if code == REFUSED:
                    compiled.refuse()
                if code != UNUSUAL:
                    continue
            ensemble.save()
            refused: tuple[float, float] | None = None
            while True:
                end = _end(time, size.length, target)
                trial, error = _tried(session, stepper, state, time, end, tolerance, halving)
                if error <= 1.0:
                    # A step may be good for the loop and too long for what is recorded in it.
                    error = max(error, session.unresolved(end))
                    refused = None
                if trial is not None and error <= 1.0:
                    size = size.accepted(error, end - time, trial.order)
                    break
                if trial is not None and trial.error > tolerance and stepper.halves:
                    found = halving.found
                    if refused is not None and is_floor(refused, end - time, found, tolerance):
                        # What is left comes from the FMUs, whose accuracy no step betters.
                        session.floors += 1
                        size = replace(size, length=refused[0], rejected=True)
                        break
                    refused = end - time, found
                ensemble.restore()
                session.rejected += 1
                size = size.refused(error, end - time, trial.order if trial else 1)
            ensemble.copy_discrete()
            state = trial.state
            session.largest_error = max(session.largest_error, trial.error)
            if stepper.halves:
                halving = halving.accepted(ensemble.Y[ensemble.source])
            time = end
            if time < target or math.isinf(event):
                session.record(time)
        if math.isfinite(event):
            state = session.cross(state, time, event)
            time = event
            size = size.restarted(min(size.length, stepper.first_step(state)))


def _compiled_adaptive(session: Session, tolerance: float) -> CompiledPolynomials | None:
    """The compiled loop for steps chosen by a tolerance, if this is a run that it makes."""
    stepper, rows = session.stepper, session.rows
    if not isinstance(stepper, HermiteStepper | DerivativeStepper) or not fits(
        session.ensemble, rows
    ):
        return None
    plan = stepper.plan()
    if plan is None:
        return None
    horizon = session.stop - session.start
    return CompiledPolynomials(session.ensemble, rows, plan, tolerance, horizon)


def _end(time: float, length: float, target: float) -> float:
    """Where a step of about `length` ends: at the target, or such that no tiny step is left."""
    left = target - time
    if left <= STRETCH * length:
        return target
    return time + (left / 2.0 if left < 2.0 * length else length)


def _tried(
    session: Session,
    stepper: AdaptiveStepper[Any],
    state: Any,
    time: float,
    end: float,
    tolerance: float,
    halving: Halving,
) -> tuple[Trial[Any] | None, float]:
    """A step for a trial, and its scaled error; infinity where it could not be made."""
    smallest = max(
        SMALLEST_STEP * math.ulp(max(abs(time), abs(end))),
        SMALLEST_SHARE * (session.stop - session.start),
    )
    try:
        if stepper.halves:
            trial = halved(
                session.ensemble, session.stop - session.start, stepper, state, time, end, halving
            )
        else:
            trial = stepper.attempt(state, time, end)
        session.ensemble.check(end)
    except (RunEnded, StepDiscarded, SlaveTerminated):
        if end - time <= smallest:
            raise
        return None, math.inf
    error = trial.error / tolerance
    if not error <= 1.0 and end - time <= smallest:
        status = Status.STEP_TOO_SMALL if math.isfinite(error) else Status.NOT_CONVERGED
        raise RunEnded(
            status,
            f"at t = {time:.9g} a step of {end - time:.3g} s is still too long for the connection "
            f"{session.ensemble.links[trial.worst].name}",
        )
    return trial, error
