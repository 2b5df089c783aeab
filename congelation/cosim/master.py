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
from congelation.cosim.rows import Rows, Several
from congelation.cosim.session import Progress, Session
from congelation.cosim.states import require_states
from congelation.cosim.system import ResolvedSystem, System
from congelation.errors import InvalidInput, SlaveError

__all__ = ["simulate"]

SLAVE_SHARE = 0.1
"""Of the tolerance of a run, the part given to the FMUs' own integration."""

RESOLVED = 16.0
"""Units in the last place of time that the shortest period takes."""

MOST_POINTS = 1e12
"""Of one kind in a run: so many take months."""


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
    output: Output | Sequence[Output] | None = None,
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
    output : Output or sequence of Output, optional
        Which rows are recorded, and where to; by default every communication point, in memory. Of
        several, the first makes the result, and each other one has a sink of its own.
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
    outputs = _outputs(output)
    chosen = _coupling(coupling, options)
    _check_times(start_time, stop_time, step, tolerance)
    _check_periods(start_time, stop_time, step, chosen, outputs)
    resolved = system.resolve()
    _check_abilities(resolved, chosen, (start_time, stop_time), step, tolerance)
    recorded = resolved.recorded(record)
    names = tuple(item.name for item in recorded)
    memory = Memory()
    outcome, statistics = (Status.COMPLETED, Status.COMPLETED.value), Statistics()
    with ExitStack() as stack:
        recorders = [
            stack.enter_context(Recorder(names, output.sink or memory)) for output in outputs
        ]
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        try:
            ensemble = Ensemble(
                resolved,
                stack.enter_context(lender.lend(resolved.members)),
                recorded,
                derivatives=chosen.needs_derivatives,
                slopes=any(output.interval is not None for output in outputs),
                events=chosen.lands_on_events,
            )
            rows = _rows(ensemble, outputs, recorders)
            session = Session(ensemble, chosen, start_time, stop_time, tolerance, rows, progress)
            outcome = _outcome(session, step, tolerance, slave_tolerance)
            statistics = session.statistics(clock.perf_counter() - begin)
        except SlaveError as error:
            outcome = (Status.SLAVE_FAILED, str(error))
    in_memory = outputs[0].sink is None
    table = memory.rows() if in_memory else recorders[0].last.reshape(-1, 1 + len(names))
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
    if not (math.isfinite(stop_time - start_time) and stop_time > start_time):
        raise InvalidInput(
            f"stop_time {stop_time:g} must be finite and after start_time {start_time:g}"
        )
    if step is None and tolerance is None:
        raise InvalidInput("give a communication step or a tolerance")
    if tolerance is not None and not 0.0 < tolerance < 1.0:
        raise InvalidInput(f"tolerance {tolerance:g} must lie between 0 and 1")


def _check_periods(
    start_time: float,
    stop_time: float,
    step: float | None,
    coupling: Coupling,
    outputs: Sequence[Output],
) -> None:
    """Refuse what would make more points than a run can have, or than times can tell apart."""
    periods = [("step", step), *coupling.periods.items()]
    periods += [("output interval", output.interval) for output in outputs]
    for name, period in periods:
        if period is not None:
            _check_period(name, period, start_time, stop_time)


def _check_period(name: str, period: float, start_time: float, stop_time: float) -> None:
    if not (math.isfinite(period) and period > 0.0):
        raise InvalidInput(f"{name} {period:g} must be positive and finite, in seconds")
    smallest = max(
        RESOLVED * math.ulp(max(abs(start_time), abs(stop_time))),
        (stop_time - start_time) / MOST_POINTS,
    )
    if period < smallest:
        raise InvalidInput(
            f"{name} {period:g} is too small from {start_time:g} to {stop_time:g}; it is at least "
            f"{smallest:.2g} there, in seconds"
        )


def _outputs(output: Output | Sequence[Output] | None) -> tuple[Output, ...]:
    if output is None or isinstance(output, Output):
        return (output or Output(),)
    if not output or any(further.sink is None for further in output[1:]):
        raise InvalidInput("of several outputs, all but the first need a sink")
    return tuple(output)


def _rows(ensemble: Ensemble, outputs: Sequence[Output], recorders: Sequence[Recorder]) -> Rows:
    """What takes the points of a run and hands rows to every recorder."""
    pairs = zip(outputs, recorders, strict=True)
    parts = [output.rows(ensemble, recorder) for output, recorder in pairs]
    return parts[0] if len(parts) == 1 else Several(parts)


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
    varies = tolerance is not None or (
        step is not None and not _one_length(*horizon, step, coupling)
    )
    for member in system.members:
        if varies and not member.description.can_vary_step:
            raise InvalidInput(
                f"component '{member.name}': {member.description.path.name} takes steps of one "
                "length only; give no tolerance, and a step that divides the horizon and whatever "
                "the coupling samples"
            )


def _one_length(start: float, stop: float, step: float, coupling: Coupling) -> bool:
    """Whether all steps have the same length: none is cut at the end, or by the coupling."""
    periods = coupling.periods.values()
    return divides(start, stop, step) and all(
        divides(0.0, max(step, period), min(step, period)) for period in periods
    )
