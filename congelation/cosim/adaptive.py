"""Stepping to a tolerance: macro steps chosen, taken back, and placed on jumps."""

from __future__ import annotations

import math

from congelation.cosim.coupling import AdaptiveStepper
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.session import Session, just_before
from congelation.cosim.step_size import StepSize
from congelation.fmi.slave import StepDiscarded

__all__ = ["run_adaptive"]

STRETCH = 1.1
"""A step is stretched by so much to reach its target, rather than leave a tiny one."""

FIRST_SHARE = 1e-2
"""Of the horizon: the longest first step."""

SMALLEST_STEP = 16.0
"""In units in the last place of time: below it, time does not resolve a step."""

SMALLEST_SHARE = 1e-15
"""Of the horizon: the same near t = 0, where doubles resolve times of no meaning."""


def run_adaptive(
    session: Session, stepper: AdaptiveStepper, tolerance: float, first_step: float | None
) -> None:
    """Step from start to stop with the estimated error of each step below `tolerance`.

    Steps land on every announced jump. A step that is too inaccurate, whose sweeps do not
    converge, that overflows or that an FMU discards is taken back and tried again shorter.

    Raises
    ------
    RunEnded
        STEP_TOO_SMALL or NOT_CONVERGED, which name the connection, or what the smallest step
        ended with.
    SlaveError
    """
    horizon = session.stop - session.start
    guess = min(stepper.first_step(), FIRST_SHARE * horizon)
    size = StepSize(first_step if first_step is not None else guess)
    time = session.start
    while time < session.stop:
        event = session.next_event(time)
        target = min(session.stop, just_before(event))
        while time < target:
            end = _end(time, size.length, target)
            error = _tried(session, stepper, time, end, tolerance)
            if error <= 1.0:
                stepper.accept()
                size = size.accepted(error, end - time, stepper.order)
                time = end
                if time < target or math.isinf(event):
                    session.record(time)
            else:
                stepper.reject()
                session.rejected += 1
                size = size.refused(error, end - time, stepper.order)
        if math.isfinite(event):
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
    smallest = max(
        SMALLEST_STEP * math.ulp(max(abs(time), abs(end))),
        SMALLEST_SHARE * (session.stop - session.start),
    )
    try:
        error = stepper.attempt(time, end) / tolerance
        session.ensemble.outputs.check(end)
    except (RunEnded, StepDiscarded):
        if end - time <= smallest:
            raise
        return math.inf
    if error > 1.0 and end - time <= smallest:
        status = Status.STEP_TOO_SMALL if math.isfinite(error) else Status.NOT_CONVERGED
        raise RunEnded(
            status,
            f"at t = {time:.9g} a step of {end - time:.3g} s is still too long for the connection "
            f"{stepper.worst()}",
        )
    return error
