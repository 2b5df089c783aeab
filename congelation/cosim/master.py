"""The master: runs a coupled system from its start time to its stop time."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Mapping, Sequence
from contextlib import ExitStack

import numpy as np

from congelation.cosim.adaptive import run_adaptive
from congelation.cosim.coupling import AdaptiveStepper, Coupling, make_coupling
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.fixed import divides, run_fixed
from congelation.cosim.output import Output
from congelation.cosim.pool import SlavePool
from congelation.cosim.recorder import Memory, Recorder
from congelation.cosim.result import Result, RunEnded, Statistics, Status
from congelation.cosim.session import Progress, Session
from congelation.cosim.states import require_states
from congelation.cosim.system import ResolvedSystem, System
from congelation.errors import InvalidInput, SlaveError

__all__ = ["simulate"]

SLAVE_SHARE = 0.1
"""Of the tolerance of a run, the part given to the FMUs' own integration."""


def simulate(
    system: System,
    *,
    start_time: float = 0.0,
    stop_time: float,
    step: float | None = None,
    tolerance: float | None = None,
    coupling: str | Coupling = "derivative",
    options: Mapping[str, object] | None = None,
    record: Sequence[str] | None = None,
    output: Output | None = None,
    slave_tolerance: float | None = None,
    progress: Progress | None = None,
    pool: SlavePool | None = None,
) -> Result:
    """Run a coupled system.

    Parameters
    ----------
    system : System
    start_time, stop_time : float
        Seconds. The last step is shortened to end at `stop_time` exactly.
    step : float, optional
        Communication step h in seconds: communication points are t_0 + k h. With a tolerance it is
        the first step that is tried.
    tolerance : float, optional
        Steps are chosen so that, while a slave steps, each of its inputs stays this near to the
        output that drives it, relative to the output's nominal value plus its size. The error of
        the run is of that order times what the loop makes of it.
    coupling : str or Coupling
        A name in COUPLINGS, or an instance.
    options : mapping, optional
        Options of a coupling given by its name.
    record : sequence of str, optional
        "component.variable"; a vector's name stands for all of its elements. By default every
        number among the outputs, der(.) and next_event left out.
    output : Output, optional
        Which rows are recorded, and where to; by default every communication point, in memory.
    slave_tolerance : float, optional
        Relative tolerance given to the FMUs (fmi2SetupExperiment). By default a tenth of
        `tolerance`, and without one that of the FMUs.
    progress : callable, optional
        Called with the fraction done, from 0 to 1, about ten times a second.
    pool : SlavePool, optional
        Lends the instances, and keeps them for the next run.

    Returns
    -------
    Result
        A failing FMU and a diverging run are statuses; every row up to there is kept.

    Raises
    ------
    InvalidInput
        The system, the times or the coupling are wrong.
    """
    begin = clock.perf_counter()
    _check_times(start_time, stop_time, step, tolerance)
    output = output or Output()
    chosen = _coupling(coupling, options)
    resolved = system.resolve()
    _check_abilities(resolved, chosen, (start_time, stop_time), step, tolerance)
    recorded = resolved.recorded(record)
    names = tuple(item.name for item in recorded)
    memory = Memory()
    recorder = Recorder(names, output.sink or memory)
    outcome, statistics = (Status.COMPLETED, Status.COMPLETED.value), Statistics()
    with ExitStack() as stack:
        stack.enter_context(recorder)
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        try:
            ensemble = Ensemble(
                resolved,
                stack.enter_context(lender.lend(resolved.members)),
                recorded,
                derivatives=chosen.needs_derivatives,
                slopes=output.interval is not None,
                events=chosen.lands_on_events,
            )
            rows = output.rows(ensemble, recorder)
            session = Session(ensemble, chosen, start_time, stop_time, tolerance, rows, progress)
            outcome = _outcome(session, step, tolerance, slave_tolerance)
            statistics = session.statistics(clock.perf_counter() - begin)
        except SlaveError as error:
            outcome = (Status.SLAVE_FAILED, str(error))
    table = memory.rows() if output.sink is None else recorder.last.reshape(-1, 1 + len(names))
    return Result(*outcome, table[:, 0], names, table[:, 1:], statistics)


def _outcome(
    session: Session, step: float | None, tolerance: float | None, slave_tolerance: float | None
) -> tuple[Status, str]:
    """Run a session to its end, whatever that is."""
    # Overflow and nan are looked for after every step, and end the run with a name.
    with np.errstate(over="ignore", invalid="ignore"):
        return _advanced(session, step, tolerance, slave_tolerance)


def _advanced(
    session: Session, step: float | None, tolerance: float | None, slave_tolerance: float | None
) -> tuple[Status, str]:
    try:
        if slave_tolerance is None and tolerance is not None:
            slave_tolerance = SLAVE_SHARE * tolerance
        session.initialise(slave_tolerance)
        stepper = session.stepper
        if tolerance is not None and isinstance(stepper, AdaptiveStepper):
            run_adaptive(session, stepper, tolerance, step)
        elif step is not None:
            run_fixed(session, step)
        session.finish(completed=True)
        session.report(1.0)
    except (RunEnded, SlaveError) as error:
        session.finish(completed=False)
        if isinstance(error, RunEnded):
            return error.status, error.message
        return Status.SLAVE_FAILED, str(error)
    return Status.COMPLETED, Status.COMPLETED.value


def _check_times(
    start_time: float, stop_time: float, step: float | None, tolerance: float | None
) -> None:
    if not (math.isfinite(start_time) and math.isfinite(stop_time) and stop_time > start_time):
        raise InvalidInput(
            f"stop_time {stop_time:g} must be finite and after start_time {start_time:g}"
        )
    if step is None and tolerance is None:
        raise InvalidInput("give a communication step or a tolerance")
    if step is not None and not (math.isfinite(step) and step > 0.0):
        raise InvalidInput(f"step {step:g} must be positive, in seconds")
    if tolerance is not None and not 0.0 < tolerance < 1.0:
        raise InvalidInput(f"tolerance {tolerance:g} must lie between 0 and 1")


def _coupling(coupling: str | Coupling, options: Mapping[str, object] | None) -> Coupling:
    if isinstance(coupling, str):
        return make_coupling(coupling, options)
    if options:
        raise InvalidInput("options go with the name of a coupling; this one has its own already")
    return coupling


def _check_abilities(
    system: ResolvedSystem,
    coupling: Coupling,
    horizon: tuple[float, float],
    step: float | None,
    tolerance: float | None,
) -> None:
    """Refuse FMUs that cannot do what the run asks of them."""
    if tolerance is not None:
        require_states(system, "a tolerance (steps are taken back)")
    if coupling.rolls_back:
        require_states(system, f"the coupling '{coupling.name}' (steps are repeated)")
    varies = tolerance is not None or (step is not None and not divides(*horizon, step))
    for member in system.members:
        if varies and not member.description.can_vary_step:
            raise InvalidInput(
                f"component '{member.name}': {member.description.path.name} takes steps of one "
                "length only; give no tolerance, and a step that divides the horizon"
            )
