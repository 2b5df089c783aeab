"""The loop over time: a fixed step, or steps chosen by a tolerance; both land on jumps.

The state of the coupling is a value in these loops. A trial of a step returns a new one; where the
step is taken back, the new one is dropped and the FMUs are restored.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import AdaptiveStepper, Coupling, Stepper, Trial
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.experiment import step_count
from congelation.cosim.recording import Rows
from congelation.cosim.result import RunEnded, Statistics, Status
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["Progress", "Session", "StepSize", "run_adaptive", "run_fixed"]

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


ORDER_HELD = 2
"""Of the couplings with inputs held at their mean: the error of one step falls with one power
more."""


SHARES = 2.0
"""Errors of steps are in part opposite, so their sum may be allowed so many tolerances."""

LEAST_SHARE = 1e-2
"""The lasting error that any step may have, as a share of the tolerance: where a solution is not
smooth, as after a blow, steps are few and tiny, and their shares would be out of reach."""

PASSING_SHARE = 0.3
"""The error that a step may have where it does not last, as a share of the tolerance."""

PROBED = 8
"""Accepted steps from one look at how much of the error lasts to the next: it costs two passes."""

FLOOR_EXPONENT = 0.25
"""An error that falls by less than this power of the step does not come from the step."""


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
        self._rows = tuple(rows)
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
        for rows in self._rows:
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
        for rows in self._rows:
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
        for rows in self._rows:
            rows.after_jump(after)
        self._count(after)
        return state

    def record(self, time: float) -> None:
        """Check and record what was read at a communication point."""
        self.ensemble.check(time)
        for rows in self._rows:
            rows.point(time)
        self._count(time)

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

    def report(self, fraction: float) -> None:
        """Report progress, if anyone listens."""
        if self._progress is not None:
            self._progress(fraction)
            self._next_report = clock.monotonic() + PROGRESS_PERIOD

    def finish(self, *, completed: bool) -> None:
        """Record what is still to be recorded."""
        if self._is_initialised:
            for rows in self._rows:
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
        )


def just_before(event: float) -> float:
    """The point of time that counts as before a jump.

    A few units in the last place earlier: with one alone, an FMU that computes its own time with
    a rounding error would already be past the jump.
    """
    return event - UNITS_BEFORE * math.ulp(event)


def run_fixed(session: Session, state: Any, step: float) -> None:
    """Step at t_0 + k h; the last step ends at the stop time exactly.

    Where a component announces a jump inside a step, the step is divided there.
    """
    start, stop = session.start, session.stop
    advance, record = session.stepper.advance, session.record
    count = step_count(start, stop, step)
    near = EVENT_ROUNDING * min(step, stop - start)
    event = session.next_event(start)
    time = start
    for k in range(1, count + 1):
        end = stop if k == count else start + k * step
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
    while time < session.stop:
        event = session.next_event(time)
        target = min(session.stop, just_before(event))
        while time < target:
            ensemble.save()
            refused: tuple[float, float] | None = None
            while True:
                end = _end(time, size.length, target)
                trial, error = _tried(session, stepper, state, time, end, tolerance, halving)
                if trial is not None and error <= 1.0:
                    size = size.accepted(error, end - time, trial.order)
                    break
                if trial is not None and stepper.halves:
                    found = halving.found
                    if refused is not None and _is_floor(refused, end - time, found, tolerance):
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
            trial = _halved(session, stepper, state, time, end, halving)
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


@dataclass
class Halving:
    """What is remembered of steps that were made whole and in halves.

    Parameters
    ----------
    sizes : array, shape (L,)
        The largest that each link has been so far.
    lasting : array, shape (L,)
        The part of the difference of whole and halves that lasts, when it was looked at last.
    left : int
        Accepted steps until it is looked at again.
    found : float
        Error of the last step tried, the largest of all links, relative to nominal value plus size.
    """

    sizes: Floats
    lasting: Floats
    left: int
    found: float = 0.0

    def accepted(self, values: Floats) -> Halving:
        """After a step that ends with these values of the links, shape (L,)."""
        left = PROBED if self.left == 0 else self.left - 1
        return Halving(np.maximum(self.sizes, np.abs(values)), self.lasting, left)


def _halved(
    session: Session,
    stepper: AdaptiveStepper[Any],
    state: Any,
    time: float,
    end: float,
    halving: Halving,
) -> Trial[Any]:
    """A step made whole, and again in two halves, which are kept; the difference is its error.

    With an error of c h^3 for a step of h, the halves are off by a quarter of that together, and
    differ from the whole by three times as much (Hairer, Norsett, Wanner, Solving Ordinary
    Differential Equations I, section II.4). It sees whatever the FMUs make of held inputs, from the
    first step on.

    Such errors last, and add up where nothing damps them: that of a step may be the share of the
    tolerance that the step is of the horizon, or a small one if that is larger. Another part of the
    difference is in proportion to h and passes with the step: outputs that an FMU has computed with
    the held input rather than with its value at the end. The first half once more in halves tells
    the two apart.

    Returns
    -------
    Trial
        Its error is relative to nominal value plus size, and over the share of the tolerance that
        it may have.
    """
    ensemble = session.ensemble
    middle = time + (end - time) / 2.0

    def made(state: Any, start: float, stop: float) -> Trial[Any]:
        trial = stepper.attempt(state, start, stop)
        ensemble.check(stop)
        return trial

    def in_halves(state: Any, start: float, stop: float) -> tuple[Trial[Any], Floats]:
        """The last trial of two, and the links' values after the first."""
        between = start + (stop - start) / 2.0
        first = made(state, start, between)
        values = ensemble.Y[ensemble.source]
        if not math.isfinite(first.error):
            return first, values
        ensemble.copy_discrete()
        ensemble.level = 1
        try:
            ensemble.save()
            return made(first.state, between, stop), values
        finally:
            ensemble.level = 0

    whole = made(state, time, end)
    at_end = ensemble.Y[ensemble.source]
    if not math.isfinite(whole.error):
        return whole
    at_middle = None
    if halving.left == 0:
        ensemble.restore()
        quarters, _ = in_halves(state, time, middle)
        if math.isfinite(quarters.error):
            at_middle = ensemble.Y[ensemble.source]
    ensemble.restore()
    rest, first_half = in_halves(state, time, end)
    if not at_end.size or not math.isfinite(rest.error):
        return rest
    found = ensemble.Y[ensemble.source]
    difference = found - at_end
    if at_middle is not None:
        # a h + b h^3 over the step, a h/2 + b h^3/8 over its half.
        lasting = np.abs(difference - 2.0 * (at_middle - first_half)) * (4.0 / 3.0)
        size = np.abs(difference)
        halving.lasting = np.divide(lasting, size, out=np.ones(len(size)), where=size > lasting)
    scale = ensemble.nominal + np.maximum(halving.sizes, np.abs(found))
    relative = np.abs(difference) / (2.0**ORDER_HELD - 1.0) / scale
    halving.found = float(relative.max())
    share = max(SHARES * (end - time) / (session.stop - session.start), LEAST_SHARE)
    allowed = np.maximum(relative * halving.lasting / share, relative / PASSING_SHARE)
    worst = int(allowed.argmax())
    order = ORDER_HELD + 1 if share == LEAST_SHARE else ORDER_HELD
    return Trial(rest.state, float(allowed[worst]), order, worst)


def _is_floor(refused: tuple[float, float], length: float, error: float, tolerance: float) -> bool:
    """Whether a shorter step than the one refused, (length, error), has hardly less of an error,
    and one that the run can bear."""
    ratio = length / refused[0]
    return (
        error <= PASSING_SHARE * tolerance
        and ratio <= 0.5
        and error > refused[1] * ratio**FLOOR_EXPONENT
    )


SAFETY = 0.9
LARGEST_CHANGE = 4.0
SMALLEST_CHANGE = 0.2
"""Bounds and margin as usual: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I,
section II.4."""

PROPORTIONAL, INTEGRAL = 0.4, 0.7
"""Exponents of the PI controller, to be divided by the order: K. Gustafsson, M. Lundh,
G. Soderlind, A PI stepsize control for the numerical solution of ordinary differential equations,
BIT 28 (1988); Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.2."""

SMALLEST_ERROR = 1e-4
"""Floor of the scaled error: below it the step grows by the largest change anyway."""


@dataclass(frozen=True)
class StepSize:
    """The step to try, and what the step control remembers.

    Parameters
    ----------
    length : float
        Seconds.
    error_before : float
        Scaled error (1 is the tolerance) of the last accepted step.
    rejected : bool
        Whether the last trial was rejected; the step does not grow right after.
    """

    length: float
    error_before: float = 1.0
    rejected: bool = False

    def accepted(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` with scaled error `error` <= 1, which falls with the power
        `order` of the step."""
        error = max(error, SMALLEST_ERROR)
        change = SAFETY * error ** (-INTEGRAL / order) * self.error_before ** (PROPORTIONAL / order)
        largest = 1.0 if self.rejected else LARGEST_CHANGE
        change = min(largest, max(SMALLEST_CHANGE, change))
        return replace(self, length=length * change, error_before=error, rejected=False)

    def refused(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` that was taken back; `error` may be infinite."""
        change = SMALLEST_CHANGE
        if math.isfinite(error):
            change = min(SAFETY, max(SMALLEST_CHANGE, SAFETY * error ** (-1.0 / order)))
        return replace(self, length=length * change, rejected=True)

    def restarted(self, length: float) -> StepSize:
        """After a jump: what was before says nothing."""
        return replace(self, length=length, error_before=1.0, rejected=False)
