"""Jumps that an FMU makes when its next step begins, from its inputs at the end of the last one.

They are late by as much as the last step was too long, and no estimate of its error sees it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from congelation.cosim.coupling import AdaptiveStepper
from congelation.cosim.exchange import settle_discrete
from congelation.cosim.session import Session
from congelation.fmi.slave import SlaveTerminated, StepDiscarded

__all__ = ["JUMPED", "jump_ahead", "jumped"]

JUMPED = 10.0
"""Error, in tolerances, beyond which the values before a step say nothing of those after it."""


def jump_ahead(session: Session, state: Any, time: float, length: float, tolerance: float) -> float:
    """Relative size of the jump in a step of that length, in seconds, from `time`, where the FMUs
    are left and the coupling has this state; 0 where there is none."""
    ensemble = session.ensemble
    if time + length > session.stop:
        return 0.0
    Y = ensemble.Y.copy()
    ensemble.level = 1
    try:
        ensemble.save()
        settle_discrete(ensemble, time)
        _stepper(session).attempt(state, time, time + length)
        missed = _missed(session, state, length)
        return missed if missed > JUMPED * tolerance else 0.0
    except (StepDiscarded, SlaveTerminated):
        return 0.0  # the next step will say what is wrong
    finally:
        ensemble.restore()
        ensemble.level = 0
        ensemble.Y[:] = Y


def jumped(session: Session, state: Any, length: float, tolerance: float) -> bool:
    """Whether a step of that length from `state` has led where its start does not explain."""
    return _missed(session, state, length) > JUMPED * tolerance


def _missed(session: Session, state: Any, length: float) -> float:
    """How far the links are, at the end of a step, from where their derivatives at its start lead:
    the largest distance relative to nominal value plus size."""
    ensemble = session.ensemble
    value, slope = _stepper(session).points(state).now
    values = ensemble.Y[ensemble.source]
    missed = np.abs(values - value - length * slope)
    relative = missed / (ensemble.nominal + np.maximum(np.abs(value), np.abs(values)))
    return float(relative.max(initial=0.0))


def _stepper(session: Session) -> AdaptiveStepper[Any]:
    assert isinstance(session.stepper, AdaptiveStepper)  # as a tolerance is given
    return session.stepper
