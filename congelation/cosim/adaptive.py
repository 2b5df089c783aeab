"""Stepping to a tolerance: macro steps chosen, taken back, and placed on jumps."""

from __future__ import annotations

import math

from congelation.cosim.coupling import AdaptiveStepper
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.session import Session, just_before
from congelation.cosim.slave import StepDiscarded
from congelation.cosim.step_size import StepSize

__all__ = ["run_adaptive"]

STRETCH = 1.1
"""A step is stretched by so much to reach its target, rather than leave a tiny one."""

FIRST_SHARE = 1e-2
"""Of the horizon: the longest first step."""

SMALLEST_STEP = 16.0
"""In units in the last place of time: below it, time does not resolve a step."""


def run_adaptive(
    session: Session, stepper: AdaptiveStepper, tolerance: float, first_step: float | None
) -> None:
    """Step from start to stop with the estimated error of each step below `tolerance`.

    Steps land on every announced jump. A step that is too inaccurate, whose sweeps do not
    converge, that overflows or that an FMU discards is taken back and tried again shorter.

    Raises
    ------
    RunEnded
        STEP_TOO_SMALL, or what the smallest step ended with.
    SlaveError
    """
    horizon = session.stop - session.start
    guess = min(stepper.first_step(), FIRST_SHARE * horizon)
    size = StepSize(first_step if first_step is not None else guess, stepper.order)
    time = session.start
    while time < session.stop:
        event = session.next_event(time)
        target = min(session.stop, just_before(event))
        while time < target:
            end = _end(time, size.length, target)
            error = _tried(session, stepper, time, end, tolerance)
            if error <= 1.0:
                stepper.accept()
                size = size.accepted(error, end - time)
                time = end
                if time < target or event > session.stop:
                    session.record(time)
            else:
                stepper.reject()
                session.rejected += 1
                size = size.refused(error, end - time)
        if event <= session.stop:
            session.cross(time, event)
            time = event
            size = size.restarted(min(size.length, stepper.first_step()))


def _end(time: float, length: float, target: float) -> float:
    """Where a step of about `length` ends: at the target, or such that no tiny step is left."""
    left = target - time
    if left <= STRETCH * length:
        return target
    return time + (left / 2.0 if left < 2.0 * length else length)


def _tried(
    session: Session, stepper: AdaptiveStepper, time: float, end: float, tolerance: float
) -> float:
    """The scaled error of a step; infinity where it could not be made."""
    smallest = SMALLEST_STEP * math.ulp(max(abs(time), abs(end)))
    try:
        error = stepper.attempt(time, end) / tolerance
        session.ensemble.outputs.check(end)
    except (RunEnded, StepDiscarded):
        if end - time <= smallest:
            raise
        return math.inf
    if error > 1.0 and end - time <= smallest:
        raise RunEnded(
            Status.STEP_TOO_SMALL,
            f"at t = {time:.9g} a step of {end - time:.3g} s still misses the tolerance",
        )
    return error
