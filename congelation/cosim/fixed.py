"""Stepping at a fixed communication step."""

from __future__ import annotations

import math

from congelation.cosim.session import Session, just_before

__all__ = ["divides", "number_of_steps", "run_fixed"]

GRID_ROUNDING = 1e-12
"""A horizon this near to a whole number of steps, relative, is taken to be one."""

EVENT_ROUNDING = 1e-9
"""A jump this near to a grid point, in steps, is taken to lie on it."""


def number_of_steps(start: float, stop: float, step: float) -> int:
    """Steps of length `step` from start to stop, the last one possibly shorter."""
    ratio = (stop - start) / step
    return round(ratio) if divides(start, stop, step) else math.ceil(ratio)


def divides(start: float, stop: float, step: float) -> bool:
    """Whether the horizon is a whole number of steps, up to rounding."""
    ratio = (stop - start) / step
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= GRID_ROUNDING * ratio


def run_fixed(session: Session, step: float) -> None:
    """Step at t_0 + k h; the last step ends at the stop time exactly.

    Where a component announces a jump inside a step, the step is divided there.
    """
    start, stop = session.start, session.stop
    advance, record = session.stepper.advance, session.record
    count = number_of_steps(start, stop, step)
    near = EVENT_ROUNDING * min(step, stop - start)
    event = session.next_event(start)
    time = start
    for k in range(1, count + 1):
        end = stop if k == count else start + k * step
        while event <= end + near:
            time = _land(session, time, event, end, near)
            event = session.next_event(time)
        if time < end:
            # In double precision time + (end - time) is end, so the slaves' own times do not
            # drift from the grid.
            advance(time, end)
            record(end)
            time = end


def _land(session: Session, time: float, event: float, end: float, near: float) -> float:
    """Step to a jump and over it; returns the time after it."""
    before = min(just_before(event), end)
    after = max(event, end) if abs(end - event) <= near else event
    if before > time:
        session.stepper.advance(time, before)
    else:
        before = time
    session.cross(before, after)
    return after
