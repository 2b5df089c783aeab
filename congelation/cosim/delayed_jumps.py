"""Jumps of values and of slopes that an FMU makes late, as it looks at its inputs only when a step
begins.

They come by as much too late as a step was too long, and no estimate of its error sees it. What
shows is that a step has a jump in it however short it is (`jump_ahead`), or that one half of a step
has all of the change of a link (`step_size.jump_within`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import AdaptiveStepper
from congelation.cosim.exchange import settle_discrete
from congelation.cosim.session import Session
from congelation.cosim.step_size import in_proportion
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["JUMPED", "KINKED", "JumpDelayed", "jump_ahead", "jumped"]

Floats = npt.NDArray[np.float64]

JUMPED = 10.0
"""Error, in tolerances, beyond which the values before a step say nothing of those after it."""

KINKED = 3.0
"""Error, in tolerances, that a jump of a slope may leave in a link by coming a step late."""

SUDDEN = 10.0
"""So many times what the step before has left unexplained is more than slopes that are not exact
make of it."""


class JumpDelayed(Exception):
    """A step has delayed a jump: the run is to be made again, and look ahead."""


def jump_ahead(
    session: Session, state: Any, time: float, shortest: float, tolerance: float
) -> float:
    """What it makes of the links, relative to their sizes, that an FMU jumps when its step from
    `time` begins, where the FMUs are left and the coupling has this state; 0 if none does.

    Parameters
    ----------
    state
        It has been at two points at least.
    shortest : float
        Step within which a value has to jump, in seconds.
    """
    found = _missed_by(session, state, time, shortest)
    if found > JUMPED * tolerance:
        return found
    points = _stepper(session).points(state)
    last = points.distance(1)
    usual = _relative(session, points.at(1), points.now[0], last)
    whole = _missed_by(session, state, time, last)
    if whole <= max(KINKED * tolerance, SUDDEN * usual):
        return 0.0
    half, quarter = (_missed_by(session, state, time, k * last) for k in (0.5, 0.25))
    # A fast motion, whose slope is not known well, does not go on in proportion.
    return whole if in_proportion(half, whole) and in_proportion(quarter, half) else 0.0


def jumped(session: Session, state: Any, length: float, tolerance: float) -> bool:
    """Whether a step of that length from `state` has led where its start does not explain."""
    return _missed(session, state, length) > JUMPED * tolerance


def _missed_by(session: Session, state: Any, time: float, length: float) -> float:
    """`_missed` of a step that is made for a trial; 0 where it cannot be made."""
    ensemble = session.ensemble
    if time + length > session.stop:
        return 0.0
    Y = ensemble.Y.copy()
    ensemble.level = 1
    try:
        ensemble.save()
        settle_discrete(ensemble, time)
        _stepper(session).attempt(state, time, time + length)
        return _missed(session, state, length)
    except (StepDiscarded, SlaveTerminated):
        return 0.0  # the next step will say what is wrong
    finally:
        ensemble.restore()
        ensemble.level = 0
        ensemble.Y[:] = Y


def _missed(session: Session, state: Any, length: float) -> float:
    """How far the links are, at the end of a step, from where their derivatives at its start lead:
    the largest distance relative to nominal value plus size."""
    now = _stepper(session).points(state).now
    return _relative(session, now, session.ensemble.Y[session.ensemble.source], length)


def _relative(session: Session, now: Floats, values: Floats, length: float) -> float:
    """The same of values, shape (L,), a step after values and derivatives `now`, shape (2, L)."""
    value, slope = now
    missed = np.abs(values - value - length * slope)
    relative = missed / (session.ensemble.nominal + np.maximum(np.abs(value), np.abs(values)))
    return float(relative.max(initial=0.0))


def _stepper(session: Session) -> AdaptiveStepper[Any]:
    assert isinstance(session.stepper, AdaptiveStepper)  # as a tolerance is given
    return session.stepper
