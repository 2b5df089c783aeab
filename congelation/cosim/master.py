"""The master: runs a coupled system from its start time to its stop time."""

from __future__ import annotations

import os
import time as clock
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np

from congelation.arguments import checked
from congelation.cosim.choice import Lack, chosen, without
from congelation.cosim.columns import Columns
from congelation.cosim.coupling import Auto, Coupling, ModelExchange
from congelation.cosim.coupling.model_exchange import Smooth
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.error_bars import trusted
from congelation.cosim.experiment import (
    Experiment,
    require_abilities,
    require_resolved_periods,
    slave_tolerance,
)
from congelation.cosim.grid import GivenPoints, Grid
from congelation.cosim.integration import integrate
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.result import Result, RunEnded, Statistics, Status
from congelation.cosim.session import Progress, Session
from congelation.cosim.sinks import Memory, Recorder
from congelation.cosim.stepping import run_adaptive, run_fixed
from congelation.cosim.system import Recorded, ResolvedSystem, System
from congelation.errors import InvalidInput, SlaveError
from congelation.fmi.slave import Slave, SlaveTerminated

__all__ = ["perform", "simulate"]


@checked
def simulate(
    system: System,
    *,
    start_time: float = 0.0,
    stop_time: float,
    step: float | None = None,
    tolerance: float | None = None,
    coupling: str | Coupling | Auto = Auto.name,
    options: Mapping[str, object] | None = None,
    record: Sequence[str] | None = None,
    output: Output | Sequence[Output] | None = None,
    slave_tolerance: float | None = None,
    max_steps: int | None = None,
    progress: Progress | None = None,
    pool: SlavePool | None = None,
    trust: bool | str = False,
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
        A name in COUPLINGS, or an instance such as ``Hermite(order=6)``. "auto" stands for the most
        accurate one that the FMUs allow, which a short trial finds, see
        `congelation.cosim.choice`; `Result.choice` says which it was, and why.
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
    max_steps : int, optional
        The run ends after so many steps, those taken back included.
    progress : callable, optional
        Called with the fraction done, from 0 to 1, about ten times a second.
    pool : SlavePool, optional
        Lends the instances, and keeps them for the next run.
    trust : bool or str, optional
        True: the run is made again with every step halved, and each recorded variable gets an
        error bar: columns ``error(component.variable)`` and `Result.trust`. "order": a run with
        doubled steps as well, which shows whether errors fall with the step as they should.
        "probe": the beginning with far shorter steps as well, which finds an FMU that steps
        inside on a grid of its own.

    Returns
    -------
    Result
        A failing FMU and a diverging run are statuses; every row up to there is kept. The message
        of a completed run names connections whose units cannot be compared.

    Raises
    ------
    InvalidInput
        The system, the times, the coupling or what is asked of trust are wrong.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> result = cg.simulate(system, stop_time=1.0, tolerance=1e-6, coupling="hermite")
    >>> result.status is cg.Status.COMPLETED
    True
    """
    experiment = Experiment(
        stop_time=stop_time,
        record=None if record is None else tuple(record),
        start_time=start_time,
        step=step,
        tolerance=tolerance,
        coupling=coupling,
        options={} if options is None else options,
        slave_tolerance=slave_tolerance,
        max_steps=max_steps,
    )
    if trust is False or trust is None:
        result = perform(system, experiment, output=output, progress=progress, pool=pool)
    else:
        result = trusted(
            perform, system, experiment, trust, output=output, progress=progress, pool=pool
        )
    # A scenario says so before it runs; a system composed in Python has only this place.
    resolved = system.resolve()
    doubts = [
        f"Connection '{link.name}': {link.doubt}."
        for link in (*resolved.links, *resolved.discrete_links)
        if link.doubt
    ]
    if not doubts or not result.completed:
        return result
    return replace(result, message=" ".join([result.message, *doubts]))


def perform(
    system: System,
    experiment: Experiment,
    *,
    output: Output | Sequence[Output] | None = None,
    progress: Progress | None = None,
    pool: SlavePool | None = None,
    points: Sequence[float] | None = None,
    lacks: Sequence[Lack] = (),
) -> Result:
    """Run a coupled system as an experiment says.

    Parameters
    ----------
    system : System
    experiment : Experiment
    output : Output or sequence of Output, optional
        As in `simulate`; by default what the experiment says.
    progress, pool
        As in `simulate`.
    points : sequence of float, optional
        Communication points after the start time, in seconds, the last being the stop time, in
        place of the experiment's steps.
    lacks : sequence of Lack
        Abilities that FMUs declare and are to be taken not to have.

    Returns
    -------
    Result
        As in `simulate`.

    Raises
    ------
    InvalidInput
        As in `simulate`.
    """
    if isinstance(experiment.given_coupling, Auto):
        choice = chosen(system, experiment, pool)
        given = experiment.output if output is None else output
        run = partial(perform, progress=progress, pool=pool, points=points, lacks=choice.lacks)
        return choice.added_to(run(system, choice.experiment, output=given))
    begin = clock.perf_counter()
    folder = os.getcwd()
    wanted = output if output is not None else experiment.output or Output()
    outputs = (wanted,) if isinstance(wanted, Output) else wanted
    if not outputs or any(further.sink is None for further in outputs[1:]):
        raise InvalidInput("of several outputs, all but the first need a sink")
    require_resolved_periods(experiment, outputs)
    coupling = experiment.chosen_coupling
    exchange = isinstance(coupling, ModelExchange)
    # What holds its inputs sends no derivatives but those that are connected explicitly.
    resolved = without(system.resolve(held=not (exchange or coupling.needs_derivatives)), lacks)
    require_abilities(resolved, experiment)
    recorded = resolved.recorded(experiment.record)
    names = tuple(item.name for item in recorded)
    kinds = tuple((output.every, output.interval) for output in outputs)
    memory = Memory()
    status, message, statistics = Status.COMPLETED, Status.COMPLETED.value, Statistics()
    with ExitStack() as stack:
        recorders = [stack.enter_context(Recorder(names, one.sink or memory)) for one in outputs]
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        try:
            slaves = stack.enter_context(lender.lend(resolved.members, exchange=exchange))
            session = lender.session(
                # Runs that agree in this differ in start values alone.
                (resolved.names, system.connections, experiment, kinds, tuple(lacks)),
                slaves,
                partial(_set_up, resolved, slaves, recorded, experiment, kinds),
            )
            pairs = zip(outputs, recorders, strict=True)
            rows = [one.rows(session.columns, to, visits=exchange) for one, to in pairs]
            session.begin(resolved, rows, progress)
            status, message = _ended(session, experiment, points)
            statistics = session.statistics(clock.perf_counter() - begin)
            if status is Status.COMPLETED:
                renewed = (f"{k}." for k in lender.renewed(resolved.members))
                message = " ".join([message, *session.ensemble.strays.values(), *renewed])
        except SlaveError as error:
            status, message = Status.SLAVE_FAILED, str(error)
    if status is Status.COMPLETED and experiment.tolerance is not None and not exchange:
        peaks = dict(zip(names, recorders[0].peaks[1:].tolist(), strict=True))
        faint = _faint(resolved, peaks, outputs[0], experiment, experiment.tolerance)
        message = " ".join(filter(None, [message, faint]))
    if os.getcwd() != folder:
        os.chdir(folder)  # an FMU had left it, which would move what the caller writes next
    last = recorders[0].last.reshape(-1, 1 + len(names))
    table = memory.rows() if outputs[0].sink is None else last
    return Result(
        status, message, table[:, 0], names, table[:, 1:], statistics, None, coupling.name
    )


def _faint(
    system: ResolvedSystem,
    peaks: Mapping[str, float],
    output: Output,
    experiment: Experiment,
    tolerance: float,
) -> str:
    """That all connected values are too small for the tolerance to mean anything; empty where they
    are not, or where too few rows of them were recorded to be certain.

    An error is relative to nominal value plus size, so that one as large as the value itself is
    admitted where the value stays below the nominal value times the tolerance.
    """
    interval, horizon = output.interval or 0.0, experiment.stop_time - experiment.start_time
    if output.every > 1 or interval > CERTAIN * horizon:
        return ""
    shares = []
    for link in system.links:
        name = link.name.partition(" -> ")[0]
        if name not in peaks:
            return ""
        shares.append((peaks[name] / link.output.nominal, name))
    share, name = max(shares, default=(0.0, ""))
    if not ROUNDING < share < tolerance:
        return ""
    smaller = tolerance * share
    return (
        "Every connected value stays below tolerance x nominal value, so that errors as large as "
        f"the values are admitted ({name} is the largest, {peaks[name]:.2g} at most): let the FMUs "
        "state the size of their outputs as 'nominal'"
        + (f", or give a tolerance below {smaller:.0e}." if smaller > ROUNDING else ".")
    )


ROUNDING = 1e-13
"""Values below so many nominal values may be the rounding errors of a system at rest."""

CERTAIN = 1e-2
"""Longest interval of recorded rows, as a part of the horizon, whose peaks are taken for those of
the run."""


def _set_up(
    system: ResolvedSystem,
    slaves: Sequence[Slave],
    recorded: Sequence[Recorded],
    experiment: Experiment,
    kinds: Sequence[tuple[int, float | None]],
) -> Session:
    """The buffers, plans and bound calls of a run; start values have no part in it."""
    coupling = experiment.chosen_coupling
    exchange = isinstance(coupling, ModelExchange)
    ensemble = Ensemble(
        system,
        slaves,
        recorded,
        derivatives=coupling.needs_derivatives,
        slopes=any(interval is not None for _, interval in kinds) and not exchange,
        events=coupling.lands_on_events,
        exchange=exchange,
    )
    return Session(
        ensemble,
        coupling,
        Columns(ensemble, recorded, latched=coupling.latches),
        experiment.start_time,
        experiment.stop_time,
        experiment.tolerance,
        experiment.max_steps,
    )


def _ended(
    session: Session, experiment: Experiment, points: Sequence[float] | None
) -> tuple[Status, str]:
    """Run a session to its end, whatever that is."""
    tolerance, step = experiment.tolerance, experiment.step
    # Overflow and nan are looked for after every step, and end the run with a name.
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            state = session.initialise(slave_tolerance(experiment))
            if isinstance(state, Smooth):
                assert tolerance is not None  # as require_abilities has seen
                integrate(session, state, tolerance, step)
            elif points is not None:
                run_fixed(session, state, GivenPoints(points, experiment.start_time))
            elif tolerance is not None:
                run_adaptive(session, state, tolerance, step)
            elif step is not None:
                run_fixed(session, state, Grid(session.start, session.stop, step))
            session.finish(completed=True)
            session.report(1.0)
        except RunEnded as end:
            session.finish(completed=False)
            return end.status, end.message
        except SlaveTerminated as end:
            session.finish(completed=True)
            return Status.TERMINATED, str(end)
        except SlaveError as error:
            session.finish(completed=False)
            return Status.SLAVE_FAILED, str(error)
    if session.floors:
        return Status.COMPLETED, (
            f"{Status.COMPLETED.value} In {session.floors} of {session.steps} steps the accuracy "
            "of the FMUs, not the step, limited the error: loosen the tolerance, or make the FMUs "
            "more accurate (slave_tolerance, or their own parameters)."
        )
    if session.missed:
        return Status.COMPLETED, (
            f"{Status.COMPLETED.value} In {session.missed} of {session.steps} steps a discrete "
            "value changed at a time that could not be located: not all FMUs can save states, or "
            "it changes all the time; what follows from it is late by up to a step."
        )
    if session.kept:
        return Status.COMPLETED, (
            f"{Status.COMPLETED.value} {session.kept} of {session.steps} steps were kept although "
            "their error was above the tolerance: they cannot be taken back, or hold a jump that "
            "no FMU announces."
        )
    return Status.COMPLETED, Status.COMPLETED.value
