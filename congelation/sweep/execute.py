"""One run: simulated, measured, and reported with its trajectory. Called in worker processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from congelation.cosim.bands import variable_of
from congelation.cosim.error_bars import trusted
from congelation.cosim.experiment import Experiment
from congelation.cosim.master import perform
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.result import Result
from congelation.errors import CongelationError, InvalidInput
from congelation.fmi.calls import CALLS
from congelation.fmi.description import Description, describe
from congelation.fmi.library import KEPT
from congelation.results.identity import NUMERICS_VERSION
from congelation.results.record import Outcome, Steps, Trajectory
from congelation.results.store import Store
from congelation.results.trajectory_file import trajectory_bytes
from congelation.scenario.parts import Settings
from congelation.scenario.scenario import Case, Scenario
from congelation.verify.measure import Points, judged, measure, unresolved

__all__ = [
    "ERROR",
    "REFUSED",
    "TIMED_OUT",
    "WORKER_DIED",
    "Job",
    "Task",
    "execute",
]

REFUSED = "REFUSED"
"""Status of a run that could not begin; its message is that of the InvalidInput."""

ERROR = "ERROR"
"""Status of a run that ended with an error of the program, or of a metric's."""

TIMED_OUT = "TIMED_OUT"
"""Status of a run that was ended because it took longer than it may."""

WORKER_DIED = "WORKER_DIED"
"""Status of a run that ended its worker process twice."""


@dataclass(frozen=True)
class Task:
    """A run to do, small enough to send.

    `number` is its place in the plan. `fraction` is the part of it to do: less than 1 in order to
    estimate what it takes, and nothing is kept then.
    """

    run_id: str
    number: int
    variant: str
    settings: Settings
    replicate: int | None = None
    fraction: float = 1.0


@dataclass(frozen=True)
class Job:
    """What all runs of a study share.

    Parameters
    ----------
    study : str
    scenario : Scenario
        Without its sweep and its text, which no worker needs.
    folder : Path or None
        The result directory, absolute; None where it cannot be reached, and trajectories are
        returned.
    trajectories : bool
        Whether they are kept.
    verify : bool
        Whether runs are compared with the monolithic solution.
    timeout : float, optional
        Seconds that a run may take.
    swept : bool
        Whether the study has the points of the sweep.
    fmus : mapping
        SHA-256 of each component's FMU.
    numerics : int
        Version of the numerics that the study was planned with.
    trust : bool or str
        Whether runs get error bars, as in `congelation.cosim.simulate`.
    fmu_log : Path, optional
        Takes what the FMUs log, a line for each message.
    """

    study: str
    scenario: Scenario
    folder: Path | None
    trajectories: bool
    verify: bool
    timeout: float | None
    swept: bool
    fmus: Mapping[str, str]
    numerics: int
    trust: bool | str = False
    fmu_log: Path | None = None

    def recorded(self, experiment: Experiment) -> Experiment:
        """An experiment of one of its runs, which records no more than is kept or measured."""
        measured = self.scenario.measured
        if self.trajectories or measured is None:
            return experiment
        if experiment is self.scenario.experiment:  # as in nearly all runs
            return self._recorded
        return replace(experiment, record=measured)

    @cached_property
    def _recorded(self) -> Experiment:
        return replace(self.scenario.experiment, record=self.scenario.measured)


def execute(
    job: Job, task: Task, pool: SlavePool, progress: Callable[[float], None]
) -> tuple[Outcome, bytes | None]:
    """Do a run, and write its trajectory if it is kept and the folder can be reached.

    Parameters
    ----------
    job : Job
    task : Task
    pool : SlavePool
        Lends the FMU instances.
    progress : callable
        Called now and then with the fraction done.

    Returns
    -------
    outcome : Outcome
        Whatever happens, except for a full disk.
    trajectory : bytes or None
        The trajectory's file where it is kept and was not written.

    Raises
    ------
    StoreError
        If the trajectory cannot be written: others could not be either.
    """
    KEPT.file, KEPT.run = job.fmu_log, task.run_id
    try:
        outcome, trajectory = _simulated(job, task, pool, progress)
    except CongelationError as error:
        return Outcome(REFUSED, str(error)), None
    except (Exception, SystemExit) as error:  # whatever it is, the run is a row
        return Outcome(ERROR, f"{type(error).__name__}: {error}"), None
    if not job.trajectories:
        return outcome, None
    content = trajectory_bytes(trajectory)
    if job.folder is None or task.fraction < 1.0:
        return outcome, content
    Store(job.folder).write_trajectory(task.run_id, content)
    return outcome, None


def _simulated(
    job: Job, task: Task, pool: SlavePool, progress: Callable[[float], None]
) -> tuple[Outcome, Trajectory]:
    """What a run gave, and its trajectory."""
    scenario = job.scenario
    case = scenario.case(task.settings)
    # The workers may be on another machine: with other FMUs, or another congelation.
    descriptions = {c.name: describe(c.fmu) for c in case.system.components}
    found = {name: description.sha256 for name, description in descriptions.items()}
    if job.numerics != NUMERICS_VERSION or found != job.fmus:
        raise InvalidInput(
            "congelation or the FMUs are not those that planned the study; install the same "
            "version everywhere, leave both alone meanwhile, and --resume"
        )
    # An estimate does the first part of a run.
    experiment = job.recorded(case.experiment)
    length = experiment.stop_time - experiment.start_time
    if task.fraction < 1.0:
        experiment = replace(experiment, stop_time=experiment.start_time + task.fraction * length)
    expected = None
    if job.verify:
        # Here, as it brings CasADi and scipy, which workers of other studies start without.
        from congelation.verify.reference import compare, reference

        expected = reference(replace(case, experiment=experiment))
    # Metrics and step sizes are of every communication point, whatever rows are kept.
    output, points = experiment.output, Points(scenario.measured if scenario.metrics else ())
    apart = output is not None and bool(scenario.metrics or job.trajectories)
    outputs = [output, Output(sink=points)] if output is not None and apart else None
    how: dict[str, Any] = {"output": outputs, "progress": progress, "pool": pool}
    if job.trust is False:
        result = perform(case.system, experiment, **how)
    else:
        result = trusted(perform, case.system, experiment, job.trust, **how)
    CALLS.clear()  # what ends the process from here on is no FMU
    steps = Steps.between(points.times() if apart else result.time) if job.trajectories else None
    units = _units(descriptions, result.names)
    kept = Trajectory(result.time, result.names, result.values, units, steps)
    if not result.whole:  # a metric of half a run would pass for one of a whole run
        return _outcome(result), kept
    # What is measured of a whole run.
    measured_case = Case(case.system, experiment)
    measured = points.with_rows(kept) if apart else kept
    metrics, failed = measure(scenario.metrics, measured_case, measured)
    metrics, withheld = judged(scenario.metrics, measured_case, metrics)
    margins = [metrics[m.name] for m in scenario.metrics if m.metric == "lyapunov"]
    deviations = compare(expected, kept) if expected is not None else ()
    if margins and job.trajectories:
        from congelation.verify.along_run import CERTIFICATE, with_certificate  # as above

        if CERTIFICATE not in found:  # a component may have the name
            kept = with_certificate(measured_case, kept)
    outcome = _outcome(result)
    return replace(
        outcome,
        status=ERROR if failed else outcome.status,
        message=" ".join(
            [result.message, *unresolved(scenario.metrics, measured), *withheld, *failed]
        ),
        metrics=metrics,
        worst_margin=max((m for m in margins if m is not None), default=None),
        deviations={deviation.variable: deviation.relative for deviation in deviations},
    ), kept


def _outcome(result: Result) -> Outcome:
    cost, trust = result.statistics, result.trust
    return Outcome(
        result.status.name,
        result.message,
        steps=cost.macro_steps,
        rejected_steps=cost.rejected,
        iterations=cost.iterations,
        estimated_error=cost.estimated_error,
        wall_time=cost.wall_time,
        warnings=cost.warnings,
        coupling=result.coupling or None,
        coupling_why=result.choice or None,
        trust_error=trust.error if trust is not None else None,
        trust_verdict=trust.verdict if trust is not None else None,
        trust_line=trust.line if trust is not None else None,
    )


def _units(descriptions: Mapping[str, Description], columns: Sequence[str]) -> dict[str, str]:
    parts = {column: variable_of(column).partition(".") for column in columns}
    return {
        column: descriptions[name].variables[variable].unit
        for column, (name, _, variable) in parts.items()
    }
