"""The loop over time: a fixed step, or steps chosen by a tolerance; both land on jumps.

The state of the coupling is a value in these loops. A trial of a step returns a new one; where the
step is taken back, the new one is dropped and the FMUs are restored.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.abilities import REPEATED, ROUNDING
from congelation.cosim.compiled import (
    DONE,
    FULL,
    NOT_FINITE,
    UNUSUAL,
    CompiledHeld,
    CompiledPolynomials,
    available,
    fits,
)
from congelation.cosim.coupling import AdaptiveStepper, Trial
from congelation.cosim.coupling.derivative import DerivativeStepper
from congelation.cosim.coupling.held import GaussSeidelStepper, JacobiStepper
from congelation.cosim.coupling.hermite import HermiteStepper
from congelation.cosim.exchange import settle_discrete
from congelation.cosim.grid import GivenPoints, Grid
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.session import Session, just_before
from congelation.cosim.step_control import Halving, Pace, StepSize, halved, is_floor
from congelation.errors import SlaveError
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["run_adaptive", "run_fixed"]

Floats = npt.NDArray[np.float64]

STRETCH = 1.1
"""A step is stretched by so much to reach its target, rather than leave a tiny one."""

FIRST_SHARE = 1e-2
"""Longest first step, as a part of the horizon."""

SHORTEST_KEPT = 1e-6
"""Longest step, as a part of the horizon, that is kept whatever its error by couplings that pass
over jumps that no FMU announces. First steps are no shorter unless one is given."""

JUMPED = 10.0
"""Error, in tolerances, beyond which the values before a kept step say nothing of those to come."""

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

MOST_IN_A_ROW = 8
"""Located changes of discrete values in so many steps, one right after the other, from which on
they are not located: such a value does not stay constant between events."""

TRIED = 1e-3
"""Length, as a part of the horizon, of the step that is made twice to see whether states are
restored."""

SMALLEST_STEP = 16.0
"""Smallest step, in units in the last place of the time: time does not resolve a shorter one."""

SMALLEST_SHARE = 1e-15
"""The same as a part of the horizon, for t near 0, where doubles resolve times of no meaning."""


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
    if session.repeats and len(ends := points.after(0, 1)):
        first = min(float(ends[0]), just_before(event)) - session.start
        _require_restored(session, state, first)
    compiled = _compiled(session, None)
    time, k = session.start, 0
    while len(ends := points.after(k, session.most)):
        if compiled is not None:
            # Up to the point that a jump comes before.
            until = int(np.searchsorted(ends + near, event))
            state, made, code = _made(session, compiled, state, time, ends[:until])
            k += made
            if made:
                time = float(ends[made - 1])
            if code == UNUSUAL or made == until < len(ends):
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


def _made(
    session: Session,
    compiled: CompiledHeld | CompiledPolynomials,
    state: Any,
    time: float,
    ends: Floats,
) -> tuple[Any, int, int]:
    """The state after steps by the compiled loop, how many it made, up to all of `ends`, and why it
    ended.

    Raises
    ------
    RunEnded, SlaveError, SlaveTerminated
        What ended the run; Python says which value it is, or what an FMU has said.
    """
    if not len(ends):
        return state, 0, DONE
    if isinstance(compiled, CompiledHeld):
        code = compiled.run(time, ends)
    else:
        code, state = compiled.fixed(state, time, ends)
    made = compiled.loop.steps
    at = float(ends[made - 1]) if made else time
    if made and isinstance(session.stepper, DerivativeStepper):
        session.stepper.watch.passed(at, state.now)
    session.took(compiled.loop)
    if code == NOT_FINITE:
        session.record(float(ends[made]))
        made += 1
    elif code not in (DONE, FULL, UNUSUAL):
        compiled.raise_for(code, float(ends[made]))
    return state, made, code


def run_adaptive(
    session: Session,
    state: Any,
    tolerance: float,
    first_step: float | None,
) -> None:
    """Step from start to stop with the estimated error of each step below `tolerance`.

    Steps land on every announced jump. A step that is too inaccurate, whose iterations do not
    converge, that overflows or that an FMU discards is taken back and tried again shorter. Where
    FMUs cannot take it back, an inaccurate step is kept, and the next one is shorter.

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
    halving = Halving(np.abs(ensemble.Y[ensemble.judged]), np.ones(len(ensemble.judged)), 0)
    pace = Pace(np.abs(ensemble.Y[ensemble.source]))
    shortest = _shortest_kept(session, tolerance)
    guess = max(SHORTEST_KEPT * horizon, min(stepper.first_step(state), FIRST_SHARE * horizon))
    size = StepSize(first_step if first_step is not None else guess)
    time = session.start
    late = 0
    event = session.next_event(time)
    switches = bool(ensemble.system.discrete_links)
    sent = ensemble.discrete_values() if switches else []
    longest = _longest(session, tolerance) if switches else math.inf
    streak = 0
    _require_restored(session, state, min(TRIED * horizon, (event - time) / 4.0))
    compiled = _compiled(session, tolerance)
    assert not isinstance(compiled, CompiledHeld)  # which takes no tolerance
    while time < session.stop:
        if compiled is not None:
            code, state, size, time, event = compiled.adaptive(
                state, size, time, event, halving, session.most
            )
            session.took(compiled.loop)
            compiled.raise_for(code, event)
            if code != UNUSUAL:
                continue
        target = min(session.stop, just_before(event))
        if time < target:
            if session.takes_back:
                ensemble.save()
            refused = None if compiled is None else compiled.refused
            before = ensemble.Y[ensemble.source]
            while True:
                end = _end(time, min(size.length, longest), target)
                trial, error = _tried(session, stepper, state, time, end, tolerance, halving, pace)
                order = trial.order if trial is not None else 1
                if stepper.predicts and trial is not None:
                    predicted, order = error, order + pace.order
                    change = ensemble.Y[ensemble.source] - before
                    lag = pace.lag(change, ensemble.nominal, end - time)
                    error = pace.weighed(predicted, lag, time, end - time, order)
                if error <= 1.0:
                    # A step may be good for the loop and too long for what is recorded in it.
                    error = max(error, session.unresolved(end))
                    refused = None
                if (
                    trial is not None
                    and switches
                    and session.takes_back
                    and streak < MOST_IN_A_ROW
                    and end - time > shortest
                    and ensemble.discrete_values() != sent
                ):
                    # A discrete value has changed somewhere in the step: bisection finds where.
                    ensemble.restore()
                    session.rejected += 1
                    size = replace(size, length=(end - time) / 2.0, rejected=True)
                    continue
                if trial is not None and error <= 1.0:
                    late = 0
                    begins = stepper.predicts and not pace.decided
                    follow = size.begun if begins else size.accepted
                    size = follow(error, end - time, order)
                    break
                if (
                    trial is not None
                    and stepper.keeps
                    and (not session.takes_back or end - time <= shortest)
                ):
                    session.kept += trial.error > tolerance
                    jumped = trial.error > JUMPED * tolerance
                    if jumped and not session.takes_back and late < LATE:
                        late += 1
                        size = size.restarted(end - time)
                        break
                    size = size.refused(error, end - time, order)
                    if jumped:
                        trial = trial._replace(state=stepper.start(end, trial.state))
                    size = replace(size, length=max(size.length, shortest))
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
                size = size.refused(error, end - time, order)
            settle_discrete(ensemble, end)
            state = trial.state
            switched = switches and (values := ensemble.discrete_values()) != sent
            stated = halving.estimate if stepper.halves else trial.error
            session.largest_error = max(session.largest_error, stated)
            if stepper.halves:
                halving = halving.accepted(ensemble.Y[ensemble.judged])
            if stepper.predicts:
                pace = pace.followed(predicted, lag, time, end - time, ensemble.Y[ensemble.source])
            if switched:
                sent = values
                streak += 1
                # It is late by so much at most.
                late_by = (end - time) / horizon
                session.largest_error = max(session.largest_error, late_by)
                session.missed += end - time > shortest
                session.exchange.run(end)
                state = stepper.start(end, state)
                size = size.restarted(min(longest, stepper.first_step(state) or shortest))
                session.leave(time)
                session.arrive(end)
                time = end
                continue
            streak = 0
            time = end
            if time < target or math.isinf(event):
                session.record(time)
        else:
            state = session.cross(state, time, event)
            sent = ensemble.discrete_values() if switches else []
            time = event
            size = size.restarted(min(size.length, stepper.first_step(state) or shortest))
            event = session.next_event(time)


def _longest(session: Session, tolerance: float) -> float:
    """Longest step, in seconds, where discrete links may change within it."""
    share = LONGEST_BETWEEN if session.takes_back else max(tolerance, LEAST_BETWEEN)
    return share * (session.stop - session.start)


def _shortest_kept(session: Session, tolerance: float) -> float:
    """Longest step, in seconds, that is kept whatever its error."""
    return max(SHORTEST_KEPT, KEPT_SHARE * tolerance) * (session.stop - session.start)


def _require_restored(session: Session, state: Any, length: float) -> None:
    """Make a first step of about `length` twice, where steps are to be taken back: an FMU that does
    not restore its state would go on from elsewhere, and no number would tell. Looked at once in a
    process for each FMU; nothing of it counts.

    Raises
    ------
    SlaveError
        The second one ends elsewhere than the first, by more than a share of what that changed.
    """
    ensemble, stepper = session.ensemble, session.stepper
    hashes = {member.description.sha256 for member in ensemble.system.members}
    if not session.takes_back or hashes <= _RESTORED:
        return
    assert isinstance(stepper, AdaptiveStepper)
    counts = ensemble.calls, stepper.iterations, [slave.log.warnings for slave in ensemble.slaves]
    before, ends = ensemble.Y.copy(), []
    ensemble.save()
    try:
        for _ in range(2):
            stepper.attempt(state, session.start, session.start + length)
            ends.append(ensemble.Y.copy())
            ensemble.restore()
            ensemble.Y[:] = before
    except (RunEnded, StepDiscarded, SlaveTerminated):
        ensemble.restore()  # the run will say what it is, or take a shorter step
        ensemble.Y[:] = before
    ensemble.forget_states()
    ensemble.calls, stepper.iterations = counts[:2]
    for slave, warnings in zip(ensemble.slaves, counts[2], strict=True):
        slave.log.warnings = warnings
    if len(ends) < 2:
        return
    first, again = ends
    off, change = np.abs(again - first), np.abs(first - before)
    wrong = off > np.maximum(REPEATED * change, ROUNDING * (1.0 + np.abs(first)))
    if wrong.any():
        place = int(wrong.argmax())
        name, _, variable = ensemble.read_names[place].partition(".")
        raise SlaveError(
            name,
            session.start,
            "it declares states that can be saved and restored, but a step from a restored one "
            f"ends with {variable} = {again[place]:.6g} in place of {first[place]:.6g}; coupling "
            "'auto' does without",
        )
    _RESTORED.update(hashes)


_RESTORED: set[str] = set()
"""Hashes of the FMUs whose states were found to be restored."""


def _compiled(
    session: Session, tolerance: float | None
) -> CompiledHeld | CompiledPolynomials | None:
    """The compiled loop, if this is a run that it makes; kept from run to run."""
    if not available():
        return None
    if "compiled" not in vars(session):
        session.compiled = _new_compiled(session, tolerance)
    elif session.compiled is not None:
        session.compiled.renew(session.rows)
    return session.compiled


def _new_compiled(
    session: Session, tolerance: float | None
) -> CompiledHeld | CompiledPolynomials | None:
    stepper, ensemble, rows, exchange = (
        session.stepper,
        session.ensemble,
        session.rows,
        session.exchange,
    )
    if not fits(ensemble, session.columns):
        return None
    if isinstance(stepper, JacobiStepper | GaussSeidelStepper):
        return CompiledHeld(ensemble, rows, exchange, sequential=stepper.sequential)
    if not isinstance(stepper, HermiteStepper | DerivativeStepper):
        return None
    if tolerance is not None and (stepper.predicts or not session.takes_back):
        return None
    return CompiledPolynomials(
        ensemble,
        rows,
        exchange,
        session.lands,
        stepper.plan(),
        1.0 if tolerance is None else tolerance,
        stepper.first_change,
        _shortest_kept(session, tolerance) if stepper.keeps and tolerance is not None else 0.0,
        session.start,
        session.stop,
    )


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
    pace: Pace,
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
            ensemble = session.ensemble
            trial = pace.judged(trial, ensemble.Y[ensemble.source], ensemble.nominal)
        session.ensemble.check(end)
    except (RunEnded, StepDiscarded, SlaveTerminated):
        if end - time <= smallest or not session.takes_back:
            raise
        return None, math.inf
    error = trial.error / tolerance
    keeps = stepper.keeps and math.isfinite(error)
    if not error <= 1.0 and end - time <= smallest and not keeps:
        status = Status.STEP_TOO_SMALL if math.isfinite(error) else Status.NOT_CONVERGED
        raise RunEnded(
            status,
            f"at t = {time:.9g} a step of {end - time:.3g} s is still too long for the connection "
            f"{session.ensemble.links[trial.worst].name}",
        )
    return trial, error
