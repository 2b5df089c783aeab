"""One step of a run with a tolerance: it is tried until it fits, or is kept as it is.

`fitting_step` tries, and `take` goes on from the step that is kept. What becomes of a step that was
tried is an `Outcome`, and so is, through `resized`, the length of the next one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import AdaptiveStepper, Trial
from congelation.cosim.delayed_jumps import JUMPED, JumpDelayed, jump_ahead, jumped
from congelation.cosim.exchange import settle_discrete
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.session import Session
from congelation.cosim.step_size import (
    SMALLEST_ERROR,
    Halving,
    Pace,
    StepSize,
    compared,
    halved,
    is_floor,
)
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["Outcome", "Rules", "RunState", "Tried", "fitting_step", "outcome_of", "resized", "take"]

Floats = npt.NDArray[np.float64]

STRETCH = 1.1
"""A step is stretched by so much to reach its target, rather than leave a tiny one."""

SHORTEST_KEPT = 1e-6
"""Longest step, as a part of the horizon, that is kept whatever its error by couplings that pass
over jumps that no FMU announces. First steps are no shorter unless one is given."""

KEPT_SHARE = 1e-2
"""The same as a part of the horizon and of the tolerance: to find a jump more closely costs steps,
and makes the run no more accurate than the tolerance has the time of the jump."""

LATE = 3
"""Steps that keep their length from a jump on that no FMU announces, where steps cannot be taken
back. The jump is late by half a step on average. The parabola through the last three values goes on
to rise by 3/4 of the jump in the middle of the next step, and falls short by 1/4 in the one after
that, which makes up for the half step; only values that are equally far apart do so."""

LONGEST_BETWEEN = 1e-2
"""Longest step, as a part of the horizon, where a connection is discrete: a value that changes and
changes back within one step is not seen."""

LEAST_BETWEEN = 1e-3
"""The same for FMUs that cannot be set back, where it is the tolerance if that is larger: changes
are late by up to a step."""

LONGEST_AT_REST = 2e-2
"""The same after a step without an error, where an FMU does not announce when its outputs jump:
nothing has moved, so steps would grow, and not see what begins and ends within one."""

DELAYED = 10.0
"""A jump right at the start of a step comes from what happened in the one before, and was delayed
by it, where that one is more than so many times as long as the shortest."""

AT_ONCE = 1e-2
"""And it is right at the start where so much of the shortest step has it."""

UNSEEN = 0.1
"""Error, in tolerances, below which a step does not show what a jump in it does."""

MOST_IN_A_ROW = 8
"""Located changes in so many steps, one right after the other, from which on they are not located:
such a value does not stay constant between events."""

SMALLEST_STEP = 16.0
"""Smallest step, in units in the last place of the time: time does not resolve a shorter one."""

SMALLEST_SHARE = 1e-15
"""The same as a part of the horizon, for t near 0, where doubles resolve times of no meaning."""


@dataclass(frozen=True)
class Rules:
    """What holds for all steps of a run with a tolerance.

    Parameters
    ----------
    tolerance : float
    horizon : float
        From start to stop, in seconds.
    takes_back : bool
        Whether all FMUs can save their state, so that a step can be taken back.
    switches : bool
        Whether connections are discrete.
    announced : bool
        Whether all FMUs announce when their outputs jump.
    keeps, halves, predicts : bool
        As of the stepper.
    """

    tolerance: float
    horizon: float
    takes_back: bool
    switches: bool
    announced: bool
    keeps: bool
    halves: bool
    predicts: bool

    @classmethod
    def of(cls, session: Session, tolerance: float) -> Rules:
        """Those of a session."""
        stepper = session.stepper
        return cls(
            tolerance,
            session.stop - session.start,
            session.takes_back,
            bool(session.ensemble.system.discrete_links),
            all(member.description.announces for member in session.ensemble.system.members),
            stepper.keeps,
            stepper.halves,
            stepper.predicts,
        )

    @property
    def shortest(self) -> float:
        """Longest step, in seconds, that is kept whatever its error."""
        return max(SHORTEST_KEPT, KEPT_SHARE * self.tolerance) * self.horizon

    @property
    def longest(self) -> float:
        """Longest step, in seconds: discrete values may change within it."""
        if not self.switches:
            return math.inf
        share = LONGEST_BETWEEN if self.takes_back else max(self.tolerance, LEAST_BETWEEN)
        return share * self.horizon

    @property
    def delays(self) -> bool:
        """Whether steps may be accepted that have delayed a jump."""
        return self.takes_back and not self.announced and (self.keeps or self.halves)

    @property
    def longest_at_rest(self) -> float:
        """Longest step, in seconds, after one without an error."""
        return math.inf if self.announced else LONGEST_AT_REST * self.horizon


@dataclass
class RunState:
    """Where a run with a tolerance is, and what its steps so far say of the next one.

    Parameters
    ----------
    coupling
        State of the coupling.
    time, event : float
        Now and the next announced jump, in seconds; infinity where there is none.
    size : StepSize
    halving : Halving
    pace : Pace
    sent : list
        What discrete connections carry.
    streak : int
        Steps up to now, one right after the other, in which a discrete value changed, or a jump
        was seen to follow.
    late : int
        Steps that have kept their length because of a jump that no FMU announced.
    looks_ahead : bool
        Whether steps are to end before jumps that FMUs make when their next step begins.
    """

    coupling: Any
    time: float
    event: float
    size: StepSize
    halving: Halving
    pace: Pace
    sent: list[float | int | bool | str]
    streak: int = 0
    late: int = 0
    looks_ahead: bool = False


class Tried(NamedTuple):
    """A step that was tried.

    Parameters
    ----------
    end, length : float
        Seconds.
    trial : Trial or None
        None where the step could not be made.
    error : float
        In tolerances, with all that counts; infinity where the step could not be made.
    order : int
        The error falls with this power of the step.
    fits : bool
        Whether the step is good for the connections, be it too long for what is recorded.
    found : float
        Error of the halves, without the weight of time.
    predicted, lag : float
        Error of the inputs as they were predicted, in tolerances, and lag of the step, see `Pace`.
    switched : bool
        Whether a discrete value changed somewhere in the step, or a jump follows from it, and is to
        be located.
    delayed : float
        Relative size of a jump that comes from the step before, and that this one has delayed.
    """

    end: float
    length: float
    trial: Trial[Any] | None = None
    error: float = math.inf
    order: int = 1
    fits: bool = False
    found: float = 0.0
    predicted: float = 0.0
    lag: float = 0.0
    switched: bool = False
    delayed: float = 0.0

    def exceeds(self, tolerance: float) -> bool:
        """Whether the step was made, with an error of the connections above this."""
        return self.trial is not None and self.trial.error > tolerance


class Outcome(Enum):
    """What becomes of a step that was tried."""

    ACCEPTED = "It is within the tolerance."
    KEPT = "It is not, and is kept: it cannot be taken back, or is as short as steps may be."
    LATE = "It is kept with a jump in it; a few more of its length make up for the delay."
    FLOOR = "It is kept: its error comes from the FMUs, as a longer step had hardly more of it."
    SHORTEN = "It is taken back: its error is too large, or it could not be made."
    BISECT = "It is taken back: a discrete value changed somewhere in it, or a jump is due."

    @property
    def is_taken_back(self) -> bool:
        """Whether another step is to be tried in its place."""
        return self in (Outcome.SHORTEN, Outcome.BISECT)


def outcome_of(
    tried: Tried, rules: Rules, late: int, refused: tuple[float, float] | None
) -> Outcome:
    """What becomes of a step that was tried.

    Parameters
    ----------
    tried : Tried
    rules : Rules
    late : int
        As in `RunState`.
    refused : tuple of float, or None
        Length and error of a longer step from the same time, whose halves differed by too much.
    """
    if tried.trial is None:
        return Outcome.SHORTEN
    if tried.switched:
        return Outcome.BISECT
    if tried.error <= 1.0:
        return Outcome.ACCEPTED
    is_short = tried.length <= rules.shortest and math.isfinite(tried.error)
    if rules.keeps and (is_short or not rules.takes_back):
        waits = tried.exceeds(JUMPED * rules.tolerance) and not rules.takes_back and late < LATE
        return Outcome.LATE if waits else Outcome.KEPT
    if (
        refused is not None
        and tried.exceeds(rules.tolerance)
        and is_floor(refused, tried.length, tried.found, rules.tolerance)
    ):
        return Outcome.FLOOR
    return Outcome.SHORTEN


def resized(
    size: StepSize,
    outcome: Outcome,
    tried: Tried,
    rules: Rules,
    pace: Pace,
    refused: tuple[float, float] | None,
) -> StepSize:
    """The step after one that was tried, with arguments as in `outcome_of`."""
    length = tried.length
    match outcome:
        case Outcome.ACCEPTED:
            begins = rules.predicts and not pace.decided
            follow = size.begun if begins else size.accepted
            size = follow(tried.error, length, tried.order)
            if tried.error <= SMALLEST_ERROR:
                size = replace(size, length=min(size.length, rules.longest_at_rest))
            return size
        case Outcome.LATE:
            return size.restarted(length)
        case Outcome.KEPT:
            shorter = size.refused(tried.error, length, tried.order)
            return replace(shorter, length=max(shorter.length, rules.shortest))
        case Outcome.FLOOR:
            # The longer step would have done as well.
            assert refused is not None
            return replace(size, length=refused[0], rejected=True)
        case Outcome.BISECT:
            return replace(size, length=length / 2.0, rejected=True)
        case Outcome.SHORTEN:
            return size.refused(tried.error, length, tried.order)


def fitting_step(
    session: Session,
    rules: Rules,
    run: RunState,
    target: float,
    refused: tuple[float, float] | None,
) -> tuple[Tried, Outcome]:
    """Make a step from `run.time` towards `target`, of whatever length has an outcome with which it
    is not taken back; `run.size` is then the next one.

    Parameters
    ----------
    refused : tuple of float, or None
        As in `outcome_of`, if the compiled loop has tried a step from here.

    Raises
    ------
    RunEnded
        STEP_TOO_SMALL or NOT_CONVERGED, which name the connection, or what the smallest step
        ended with.
    SlaveError
    """
    ensemble = session.ensemble
    if rules.takes_back:
        ensemble.save()
    before = ensemble.Y[ensemble.source]
    delayed = None if _may_delay(session, rules, run) else 0.0
    while True:
        if delayed is None and run.size.rejected:
            delayed = _delayed(session, rules, run)
        tried = _tried(session, rules, run, target, before)
        kinked = tried.fits and run.halving.kink > JUMPED * rules.tolerance
        if kinked and delayed is None:
            ensemble.restore()
            delayed = _delayed(session, rules, run) or 0.0
            continue  # and make it again
        tried = tried._replace(delayed=delayed or 0.0)
        if tried.fits:
            refused = None
        outcome = outcome_of(tried, rules, run.late, refused)
        run.size = resized(run.size, outcome, tried, rules, run.pace, refused)
        if not outcome.is_taken_back:
            return tried, outcome
        if outcome is Outcome.SHORTEN and rules.halves and tried.exceeds(rules.tolerance):
            refused = compared(refused, tried.length, tried.found)
        ensemble.restore()
        session.rejected += 1


def _may_delay(session: Session, rules: Rules, run: RunState) -> bool:
    """Whether jumps may come late, and slopes are known, which they are not right after a jump."""
    assert isinstance(session.stepper, AdaptiveStepper)
    return rules.delays and len(session.stepper.points(run.coupling).times) > 1


def _delayed(session: Session, rules: Rules, run: RunState) -> float | None:
    """What it makes of the links that the step before has delayed a jump at the start of this one;
    0 where it has not, None where it need not be looked at yet."""
    stepper = session.stepper
    assert isinstance(stepper, AdaptiveStepper)
    # Where slopes are exact, a jump at the start is refused down to far shorter steps.
    length = (
        rules.shortest if rules.halves or rules.predicts else max(run.size.length, rules.shortest)
    )
    if stepper.points(run.coupling).distance(1) <= DELAYED * length:
        return None
    at_once = rules.shortest * AT_ONCE
    return jump_ahead(session, run.coupling, run.time, at_once, rules.tolerance)


def _tried(session: Session, rules: Rules, run: RunState, target: float, before: Floats) -> Tried:
    """A step for a trial, from links' values `before`, shape (L,)."""
    ensemble = session.ensemble
    end = _end(run.time, min(run.size.length, rules.longest), target)
    length = end - run.time
    trial, error = attempted(session, rules, run, end)
    if trial is None:
        return Tried(end, length)
    order, predicted, lag = trial.order, error, 0.0
    if rules.predicts:
        order += run.pace.order
        lag = run.pace.lag(ensemble.Y[ensemble.source] - before, ensemble.nominal, length)
        error = run.pace.weighed(predicted, lag, run.time, length, order)
    fits = error <= 1.0
    if fits:
        error = max(error, session.unresolved(end))
    found = run.halving.found
    switched = (
        rules.takes_back
        and run.streak < MOST_IN_A_ROW
        and length > rules.shortest
        and (
            (rules.switches and ensemble.discrete_values() != run.sent)
            or (error <= 1.0 and _jumps(session, rules, run, trial.state, end, error))
        )
    )
    return Tried(end, length, trial, error, order, fits, found, predicted, lag, switched)


def _jumps(
    session: Session, rules: Rules, run: RunState, state: Any, end: float, error: float
) -> bool:
    """Whether a step has a jump in it that its error, in tolerances, does not show, or one
    follows."""
    unseen = error < UNSEEN and run.halving.jump > JUMPED * rules.tolerance
    if unseen and _may_delay(session, rules, run):
        return True
    stepper = session.stepper
    assert isinstance(stepper, AdaptiveStepper)
    if not run.looks_ahead or len(stepper.points(state).times) < 2:
        return False
    return jump_ahead(session, state, end, rules.shortest, rules.tolerance) > 0.0


def _end(time: float, length: float, target: float) -> float:
    """Where a step of about `length` ends: at the target, or such that no tiny step is left."""
    left = target - time
    if left <= STRETCH * length:
        return target
    return time + (left / 2.0 if left < 2.0 * length else length)


def attempted(
    session: Session, rules: Rules, run: RunState, end: float
) -> tuple[Trial[Any] | None, float]:
    """A step for a trial, and its error in tolerances; None and infinity if it could not be made.

    Raises
    ------
    RunEnded, StepDiscarded, SlaveTerminated, SlaveError
        Where no other step can be tried.
    """
    ensemble, stepper, time = session.ensemble, session.stepper, run.time
    assert isinstance(stepper, AdaptiveStepper)  # as a tolerance is given
    smallest = max(
        SMALLEST_STEP * math.ulp(max(abs(time), abs(end))), SMALLEST_SHARE * rules.horizon
    )
    try:
        if rules.halves:
            trial = halved(ensemble, rules.horizon, stepper, run.coupling, time, end, run.halving)
        else:
            trial = stepper.attempt(run.coupling, time, end)
            trial = run.pace.judged(trial, ensemble.Y[ensemble.source], ensemble.nominal)
        ensemble.check(end)
    except (RunEnded, StepDiscarded, SlaveTerminated):
        if end - time <= smallest or not rules.takes_back:
            raise
        return None, math.inf
    error = trial.error / rules.tolerance
    keeps = rules.keeps and math.isfinite(error)
    if not error <= 1.0 and end - time <= smallest and not keeps:
        status = Status.STEP_TOO_SMALL if math.isfinite(error) else Status.NOT_CONVERGED
        raise RunEnded(
            status,
            f"at t = {time:.9g} a step of {end - time:.3g} s is still too long for the connection "
            f"{ensemble.links[trial.worst].name}",
        )
    return trial, error


def take(
    session: Session, rules: Rules, run: RunState, tried: Tried, outcome: Outcome, target: float
) -> None:
    """Go on from a step that is not taken back, and record its end.

    A point at `target` that lies just before a jump is recorded together with the jump.

    Raises
    ------
    JumpDelayed
    """
    ensemble, stepper, trial, end = session.ensemble, session.stepper, tried.trial, tried.end
    assert trial is not None  # what cannot be made is taken back
    assert isinstance(stepper, AdaptiveStepper)
    state = trial.state
    if outcome is Outcome.ACCEPTED:
        run.late = 0
    elif outcome is Outcome.FLOOR:
        session.floors += 1
    else:
        session.kept += tried.exceeds(rules.tolerance)
        if outcome is Outcome.LATE:
            run.late += 1
        elif tried.exceeds(JUMPED * rules.tolerance):
            state = stepper.start(end, state)
    settle_discrete(ensemble, end)
    values = ensemble.discrete_values() if rules.switches else []
    stated = run.halving.estimate if rules.halves else trial.error
    session.largest_error = max(session.largest_error, stated, tried.delayed)
    if tried.delayed:
        if not run.looks_ahead:
            raise JumpDelayed
        session.kept += outcome is Outcome.ACCEPTED
    if rules.halves:
        jumps = rules.delays and run.halving.jump > JUMPED * rules.tolerance
        run.halving = run.halving.accepted(ensemble.Y[ensemble.judged])
    else:
        jumps = run.looks_ahead and jumped(session, run.coupling, tried.length, rules.tolerance)
    # Right after a jump that was located, no slope is known, and the step says nothing of others.
    known = not run.looks_ahead or len(stepper.points(run.coupling).times) > 1
    if rules.predicts and known:
        now = ensemble.Y[ensemble.source]
        run.pace = run.pace.followed(tried.predicted, tried.lag, run.time, tried.length, now)
    begin, run.time, run.coupling = run.time, end, state
    if values == run.sent:
        run.streak = run.streak + 1 if jumps else 0
        if end < target or math.isinf(run.event):
            session.record(end)
        return
    # A discrete value has changed in a step that cannot be shortened to when: a jump at its end.
    run.sent = values
    run.streak += 1
    session.largest_error = max(session.largest_error, tried.length / rules.horizon)
    session.missed += tried.length > rules.shortest
    session.exchange.run(end)
    run.coupling = stepper.start(end, state)
    first = stepper.first_step(run.coupling) or rules.shortest
    run.size = run.size.restarted(min(rules.longest, first))
    session.leave(begin)  # recorded already; no row is interpolated across the jump
    session.arrive(end)
