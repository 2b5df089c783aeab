"""One run: simulated, measured, and made into a row and a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from congelation.cosim.master import simulate
from congelation.cosim.output import Output
from congelation.cosim.pool import SlavePool
from congelation.fmi.description import describe
from congelation.results.identity import code_version
from congelation.results.records import Trajectory
from congelation.scenario.scenario import Scenario
from congelation.sweep.plan import Run
from congelation.verify.measure import Points, measure

__all__ = ["execute", "lost_row"]

Progress = Callable[[float], None]


def execute(
    run: Run, scenario: Scenario, pool: SlavePool, progress: Progress | None = None
) -> tuple[dict[str, Any], Trajectory]:
    """Simulate a run.

    Parameters
    ----------
    run : Run
    scenario : Scenario
        The one that `run` was planned from.
    pool : SlavePool
        Lends the FMU instances.
    progress : callable, optional
        Called now and then with the fraction done.

    Returns
    -------
    row : dict
        By column: identity, settings, status, metrics (None unless the run reached its stop
        time) and cost.
    trajectory : Trajectory
        Everything recorded up to the point where the run ended.
    """
    experiment = run.case.experiment
    output = experiment.output
    points = Points(scenario.measured)
    apart = output is not None and bool(scenario.metrics)
    result = simulate(
        run.case.system,
        start_time=experiment.start_time,
        stop_time=experiment.stop_time,
        step=experiment.step,
        tolerance=experiment.tolerance,
        coupling=experiment.coupling,
        options=experiment.options,
        record=experiment.record,
        output=[output, Output(sink=points)] if output is not None and apart else output,
        slave_tolerance=experiment.slave_tolerance,
        progress=progress,
        pool=pool,
    )
    kept = Trajectory(result.time, result.columns, result.values, _units(run, result.columns))
    metrics: Mapping[str, float | None] = dict.fromkeys(spec.name for spec in scenario.metrics)
    if result.completed:  # a metric of half a run would pass for one of a whole run
        measured = points.with_rows(kept) if apart else kept
        metrics = measure(scenario.metrics, run.case, measured)
    steps, wall_time = result.statistics.macro_steps, result.statistics.wall_time
    return _row(run, result.status.name, result.message, metrics, steps, wall_time), kept


def lost_row(run: Run, scenario: Scenario, status: str, message: str) -> dict[str, Any]:
    """The row of a run that has no result: refused, or lost with its process."""
    return _row(run, status, message, dict.fromkeys(m.name for m in scenario.metrics), None, None)


def _row(
    run: Run,
    status: str,
    message: str,
    metrics: Mapping[str, float | None],
    macro_steps: int | None,
    wall_time: float | None,
) -> dict[str, Any]:
    return {
        "run_id": run.run_id,
        "variant": run.variant,
        **({} if run.replicate is None else {"replicate": run.replicate}),
        **run.settings,
        "status": status,
        "message": message,
        **metrics,
        "macro_steps": macro_steps,
        "wall_time": wall_time,
        **{f"{c.name}.sha256": describe(c.fmu).sha256 for c in run.case.system.components},
        "seed": run.seed,
        "code_version": code_version(),
    }


def _units(run: Run, columns: Sequence[str]) -> dict[str, str]:
    descriptions = {c.name: describe(c.fmu) for c in run.case.system.components}
    parts = {column: column.partition(".") for column in columns}
    return {
        column: descriptions[name].variables[variable].unit
        for column, (name, _, variable) in parts.items()
    }
