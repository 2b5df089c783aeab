"""All variants of a scenario, run one after the other and stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from congelation.cosim.pool import SlavePool
from congelation.cosim.result import Status
from congelation.errors import InvalidInput
from congelation.results.provenance import about
from congelation.results.store import Store
from congelation.scenario.scenario import Scenario
from congelation.sweep.execute import execute
from congelation.sweep.interrupt import deferred_interrupts
from congelation.sweep.plan import Run, plan_runs, varied_settings
from congelation.verify.reference import Reference, compare, reference

__all__ = ["run_scenario"]


def run_scenario(
    scenario: Scenario,
    folder: Path,
    *,
    verify: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Store:
    """Run all variants of a scenario and store them in a folder.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        The result directory; runs of an earlier state of the scenario in it are replaced.
    verify : bool
        Whether each run that reached its stop time is compared with the monolithic solution.
    progress : callable, optional
        Called with a variant's name and the fraction of its run that is done.

    Raises
    ------
    InvalidInput
        If `verify` cannot be done, an FMU cannot be loaded, or the folder cannot be written.
    """
    store = Store(folder)
    store.create()
    earlier = store.replaceable()
    runs = tuple(plan_runs(scenario))
    references = {run.run_id: _reference(scenario, run) for run in runs} if verify else {}
    verification: dict[str, list[dict[str, Any]]] = {}
    with SlavePool() as pool, deferred_interrupts() as check:
        for run in runs:
            report = partial(_report, check, progress, run.variant)
            try:
                row, trajectory = execute(run, scenario, pool, report)
            except InvalidInput as error:
                raise _in_run(scenario, run, error) from error
            store.write(row, trajectory)
            if verify and row["status"] == Status.COMPLETED.name:
                deviations = compare(references[run.run_id], trajectory)
                verification[run.run_id] = [asdict(deviation) for deviation in deviations]
    described = about(scenario, varied_settings(scenario))
    run_ids = [run.run_id for run in runs]
    store.compact(run_ids, {**described, "verification": verification})
    store.remove(earlier.difference(run_ids))
    return store


def _report(
    check: Callable[[], None], progress: Callable[[str, float], None] | None, name: str, done: float
) -> None:
    check()
    if progress is not None:
        progress(name, done)


def _reference(scenario: Scenario, run: Run) -> Reference:
    try:
        return reference(run.case)
    except InvalidInput as error:
        raise _in_run(scenario, run, error) from error


def _in_run(scenario: Scenario, run: Run, error: InvalidInput) -> InvalidInput:
    """The error with the place that it belongs to."""
    return InvalidInput(f"{scenario.file}: {run.variant}: {error}")
