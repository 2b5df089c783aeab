"""The loop over time: a fixed step, or steps chosen by a tolerance; both land on jumps.

The state of the coupling is a value in these loops. A trial of a step returns a new one; where the
step is taken back, the new one is dropped and the FMUs are restored.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.abilities import require_restored
from congelation.cosim.adaptive_step import (
    SHORTEST_KEPT,
    Rules,
    RunState,
    fitting_step,
    take,
)
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
from congelation.cosim.coupling import AdaptiveStepper
from congelation.cosim.coupling.derivative import DerivativeStepper
from congelation.cosim.coupling.held import GaussSeidelStepper, JacobiStepper
from congelation.cosim.coupling.hermite import HermiteStepper
from congelation.cosim.grid import GivenPoints, Grid
from congelation.cosim.session import Session
from congelation.cosim.step_size import Halving, Pace, StepSize

__all__ = ["run_adaptive", "run_fixed"]

Floats = npt.NDArray[np.float64]

FIRST_SHARE = 1e-2
"""Longest first step, as a part of the horizon."""

TRIED = 1e-3
"""Length, as a part of the horizon, of the step that is made twice to see whether states are
restored."""


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
    if session.repeats and session.takes_back and len(ends := points.after(0, 1)):
        first = min(float(ends[0]), session.before(event)) - session.start
        if first > 0.0:  # else a jump follows at once
            require_restored(session.ensemble, session.stepper, state, session.start, first)
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
                before = min(session.before(event), end)
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
    *,
    looks_ahead: bool,
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
    JumpDelayed
        The run is to be made again, with `looks_ahead`: whether steps are to end before jumps that
        FMUs make when their next step begins.
    SlaveError
    """
    rules = Rules.of(session, tolerance)
    run = _begun(session, rules, state, first_step)
    run.looks_ahead = looks_ahead
    if rules.takes_back:
        length = min(TRIED * rules.horizon, (run.event - run.time) / 4.0)
        require_restored(session.ensemble, session.stepper, state, run.time, length)
    compiled = _compiled(session, rules)
    assert not isinstance(compiled, CompiledHeld)  # which takes no tolerance
    while run.time < session.stop:
        refused = None
        if compiled is not None and not looks_ahead:
            code, run.coupling, run.size, run.time, run.event = compiled.adaptive(
                run.coupling, run.size, run.time, run.event, run.halving, session.most
            )
            session.took(compiled.loop)
            compiled.raise_for(code, run.event)
            if code != UNUSUAL:
                continue
            refused = compiled.refused
        target = min(session.stop, session.before(run.event))
        if run.time < target:
            tried, outcome = fitting_step(session, rules, run, target, refused)
            take(session, rules, run, tried, outcome, target)
        else:
            _cross(session, rules, run)


def _begun(session: Session, rules: Rules, state: Any, first_step: float | None) -> RunState:
    """At the start time, with a first step over which inputs change little."""
    ensemble, stepper, horizon = session.ensemble, session.stepper, rules.horizon
    assert isinstance(stepper, AdaptiveStepper)  # as a tolerance is given
    guess = max(SHORTEST_KEPT * horizon, min(stepper.first_step(state), FIRST_SHARE * horizon))
    return RunState(
        state,
        session.start,
        session.next_event(session.start),
        StepSize(first_step if first_step is not None else guess),
        Halving(np.abs(ensemble.Y[ensemble.judged]), np.ones(len(ensemble.judged)), 0),
        Pace(np.abs(ensemble.Y[ensemble.source])),
        ensemble.discrete_values() if rules.switches else [],
    )


def _cross(session: Session, rules: Rules, run: RunState) -> None:
    """Step over an announced jump, from the point just before it."""
    stepper = session.stepper
    assert isinstance(stepper, AdaptiveStepper)
    run.coupling = session.cross(run.coupling, run.time, run.event)
    run.sent = session.ensemble.discrete_values() if rules.switches else []
    run.time = run.event
    first = stepper.first_step(run.coupling) or rules.shortest
    run.size = run.size.restarted(min(run.size.length, first))
    run.event = session.next_event(run.time)


def _compiled(session: Session, rules: Rules | None) -> CompiledHeld | CompiledPolynomials | None:
    """The compiled loop, if this is a run that it makes; kept from run to run."""
    if not available():
        return None
    if "compiled" not in vars(session):
        session.compiled = _new_compiled(session, rules)
    elif session.compiled is not None:
        session.compiled.renew(session.rows)
    return session.compiled


def _new_compiled(
    session: Session, rules: Rules | None
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
    if rules is not None and (rules.predicts or not rules.takes_back):
        return None
    return CompiledPolynomials(
        ensemble,
        rows,
        exchange,
        session.lands,
        stepper.plan(),
        1.0 if rules is None else rules.tolerance,
        stepper.first_change,
        rules.shortest if rules is not None and rules.keeps else 0.0,
        math.inf if rules is None else rules.longest_at_rest,
        session.start,
        session.stop,
    )
