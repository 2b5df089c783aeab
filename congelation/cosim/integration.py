"""The loop over time of `model_exchange`: an integrator from one event to the next.

DOP853 is compiled, where the compiled loop is there; else, and for the other methods, SciPy's
solvers make the steps. Events are the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.compiled import available, fits
from congelation.cosim.compiled.base import CROSSED, FULL, TOO_SMALL
from congelation.cosim.compiled.model_exchange import CompiledIntegrator, CompiledRates
from congelation.cosim.coupling.model_exchange import ModelExchangeStepper, Smooth
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.session import Session

__all__ = ["integrate"]

Floats = npt.NDArray[np.float64]

RESOLVED = 4.0
"""Length of the interval in which an indicator's change of sign is found, in units in the last
place of the time."""


def integrate(session: Session, state: Smooth, tolerance: float, first_step: float | None) -> None:
    """Integrate from start to stop; steps land on time events and where indicators change sign.

    Parameters
    ----------
    session : Session
        Of the coupling `model_exchange`.
    state : Smooth
        At the start time.
    tolerance : float
        Of the integrator, relative to a state's nominal value plus its size.
    first_step : float or None
        In seconds; None: it is chosen.

    Raises
    ------
    RunEnded
        STEP_TOO_SMALL, LOOP_UNSOLVED, NON_FINITE, DIVERGED, TOO_MANY_STEPS.
    SlaveTerminated, SlaveError
    """
    stepper, ensemble = session.stepper, session.ensemble
    assert isinstance(stepper, ModelExchangeStepper)
    leg: Callable[..., tuple[float, bool]] = _by_solver
    makes: Any = stepper.rates
    if available() and not ensemble.system.discrete_links:
        if stepper.method == "DOP853" and fits(ensemble, session.columns):
            leg, makes = _compiled_leg, _compiled(session, tolerance)
        else:
            makes = CompiledRates(stepper)
    time = session.start
    while time < session.stop:
        time, is_event = leg(session, makes, state, time, tolerance, first_step)
        ensemble.calls += stepper.drive.calls
        stepper.drive.calls = 0
        if is_event:
            session.leave(time)
            state = stepper.start(time, state)
            ensemble.read_all()
            session.arrive(time)
        first_step = None


def _compiled(session: Session, tolerance: float) -> CompiledIntegrator:
    """The compiled integrator; kept from run to run."""
    stepper = session.stepper
    assert isinstance(stepper, ModelExchangeStepper)
    if "integrator" in vars(session):
        session.integrator.renew(session.rows)
    else:
        session.integrator = CompiledIntegrator(
            session.ensemble, session.rows, session.exchange, session.stop, stepper, tolerance
        )
    return session.integrator


def _compiled_leg(
    session: Session,
    compiled: CompiledIntegrator,
    state: Smooth,
    time: float,
    tolerance: float,
    first_step: float | None,
) -> tuple[float, bool]:
    """To the stop time, or to an event that is not announced: where that is, and which it is."""
    compiled.restart(state, first_step)
    code = FULL
    while code == FULL:
        code, time = compiled.integrate(time, session.most)
        session.took(compiled.loop)
        session.largest_error = max(session.largest_error, compiled.error * tolerance)
    if code == CROSSED:
        end = time
        return _at_change(session, state, compiled.started, end, lambda t: compiled.within(end, t))
    if code == TOO_SMALL:
        raise _too_small(time, compiled.length)
    compiled.ended(code, time)
    return time, False


def _by_solver(
    session: Session,
    rates: Callable[[float, Floats], Floats],
    state: Smooth,
    time: float,
    tolerance: float,
    first_step: float | None,
) -> tuple[float, bool]:
    """To the next event or the stop time by a solver of SciPy: where that is, and which it is."""
    from scipy import integrate

    stepper, ensemble = session.stepper, session.ensemble
    assert isinstance(stepper, ModelExchangeStepper)
    target = min(state.event, session.stop)
    solver = getattr(integrate, stepper.method)(
        rates,
        time,
        state.x,
        target,
        rtol=tolerance,
        atol=tolerance * stepper.nominal,
        first_step=None if first_step is None else min(first_step, target - time),
    )
    while True:
        before = solver.t
        solver.step()
        if solver.status == "failed":
            raise _too_small(solver.t, solver.step_size or 0.0)
        time = float(solver.t)
        stepper.go_to(time, solver.y)
        if stepper.crossed(state):
            return _at_change(session, state, before, time, solver.dense_output())
        _visit(session, time, solver.dense_output)
        stepper.go_to(time, solver.y)
        asks = stepper.completed(time)
        ensemble.read_all()
        ensemble.calls += sum(ensemble.read_calls)
        session.largest_error = max(session.largest_error, tolerance)
        if asks or (time >= target and state.event <= session.stop):
            return time, True
        session.record(time)
        if time >= target:
            return time, False


def _at_change(
    session: Session,
    state: Smooth,
    before: float,
    after: float,
    states: Callable[[float], Floats],
) -> tuple[float, bool]:
    """The end of the shortest interval found in which an indicator changes its sign, by bisection
    between two points; the FMUs are left there."""
    stepper, ensemble = session.stepper, session.ensemble
    assert isinstance(stepper, ModelExchangeStepper)
    while after - before > RESOLVED * math.ulp(after):
        middle = before + (after - before) / 2.0
        stepper.go_to(middle, states(middle))
        if stepper.crossed(state):
            after = middle
        else:
            before = middle
    _visit(session, after, lambda: states)
    stepper.go_to(after, states(after))
    stepper.completed(after)
    ensemble.read_all()
    return after, True


def _visit(session: Session, until: float, dense: Callable[[], Callable[[float], Floats]]) -> None:
    """Rows at the times before `until` at which they are asked for."""
    stepper, ensemble = session.stepper, session.ensemble
    assert isinstance(stepper, ModelExchangeStepper)
    states = None
    while times := sorted({t for rows in session.rows for t in rows.due(until, 1)}):
        states = states or dense()
        stepper.go_to(times[0], states(times[0]))
        ensemble.read_all()
        ensemble.calls += sum(ensemble.read_calls)
        ensemble.check(times[0])
        for rows in session.rows:
            rows.visit(times[0])


def _too_small(time: float, length: float) -> RunEnded:
    return RunEnded(
        Status.STEP_TOO_SMALL,
        f"at t = {time:.9g} a step of {length:.3g} s is still too long for the integrator",
    )
