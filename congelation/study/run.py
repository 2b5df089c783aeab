"""Runs: each variant of a scenario simulated, and kept as a row and a trajectory."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from congelation.cosim.description import Description, describe
from congelation.cosim.master import simulate
from congelation.cosim.pool import SlavePool
from congelation.cosim.result import Result, Status
from congelation.errors import InvalidInput
from congelation.study.interrupt import deferred_interrupts
from congelation.study.scenario import EXPERIMENT, Case, MetricSpec, Scenario, Variant
from congelation.study.start_values import Scalar
from congelation.study.store import Store, Trajectory, code_version, content_hash, file_hash
from congelation.study.verify import Reference, compare, reference

__all__ = ["Run", "about", "execute", "plan_runs", "run_scenario"]

Progress = Callable[[float], None]

_PACKAGES = ("fmpy", "pythonfmu", "numpy", "scipy", "pyarrow")


@dataclass(frozen=True)
class Run:
    """One simulation to do; equal content has an equal `run_id`."""

    run_id: str
    variant: str
    settings: Mapping[str, Scalar | None]
    case: Case


def plan_runs(scenario: Scenario) -> tuple[Run, ...]:
    """One run per variant, each with the value of every setting that any variant changes."""
    varied = tuple(dict.fromkeys(name for v in scenario.variants for name in v.settings))
    return tuple(_run(scenario, variant, varied) for variant in scenario.variants)


def _run(scenario: Scenario, variant: Variant, varied: Sequence[str]) -> Run:
    case = scenario.case(variant.settings)
    content = {
        "variant": variant.name,
        "components": [
            [c.name, describe(c.fmu).sha256, {k: _content(v) for k, v in c.start.items()}]
            for c in case.system.components
        ],
        "connections": [str(connection) for connection in case.system.connections],
        "experiment": asdict(case.experiment),
        "metrics": [[m.name, m.metric.name, m.of, dict(m.options)] for m in scenario.metrics],
        "code": code_version(),
    }
    settings = {name: _setting(case, name) for name in varied}
    return Run(content_hash(content), variant.name, settings, case)


def _content(value: object) -> object:
    """A start value as content; of a file that one names, what is in it."""
    if isinstance(value, str) and Path(value).is_file():
        return file_hash(Path(value))
    return value


def _setting(case: Case, name: str) -> Scalar | None:
    """The value of ``owner.key`` in a case; None for a start value left to the FMU."""
    owner, _, key = name.partition(".")
    if owner == EXPERIMENT:
        return cast(Scalar, getattr(case.experiment, key))
    component = next(c for c in case.system.components if c.name == owner)
    return cast(Scalar | None, component.start.get(key))  # a scenario's start values are flat


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
    result = simulate(
        run.case.system,
        start_time=experiment.start_time,
        stop_time=experiment.stop_time,
        step=experiment.step,
        tolerance=experiment.tolerance,
        coupling=experiment.coupling,
        options=experiment.options,
        record=experiment.record,
        slave_tolerance=experiment.slave_tolerance,
        progress=progress,
        pool=pool,
    )
    descriptions = {c.name: describe(c.fmu) for c in run.case.system.components}
    row = {
        "run_id": run.run_id,
        "variant": run.variant,
        **run.settings,
        "status": result.status.name,
        "message": result.message,
        **{spec.name: _measure(spec, result) for spec in scenario.metrics},
        "macro_steps": result.statistics.macro_steps,
        "wall_time": result.statistics.wall_time,
        **{f"{name}.sha256": found.sha256 for name, found in descriptions.items()},
        "seed": None,
        "code_version": code_version(),
    }
    units = {column: _unit(descriptions, column) for column in result.columns}
    return row, Trajectory(result.time, result.columns, result.values, units)


def _measure(spec: MetricSpec, result: Result) -> float | None:
    if not result.completed:
        return None  # a metric of half a run would pass for one of a whole run
    values = result.column(spec.of)
    return spec.metric.evaluate(result.time, values.reshape(len(values), -1), **spec.options)


def _unit(descriptions: Mapping[str, Description], column: str) -> str:
    component, _, variable = column.partition(".")
    return descriptions[component].variables[variable].unit


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
    runs = plan_runs(scenario)
    references = {run.run_id: _reference(scenario, run) for run in runs} if verify else {}
    verification: dict[str, list[dict[str, Any]]] = {}
    with SlavePool() as pool, deferred_interrupts() as check:
        for run in runs:
            report = partial(_report, check, progress, run.variant)
            row, trajectory = execute(run, scenario, pool, report)
            store.write(row, trajectory)
            if verify and row["status"] == Status.COMPLETED.name:
                deviations = compare(references[run.run_id], trajectory)
                verification[run.run_id] = [asdict(deviation) for deviation in deviations]
    described = {**about(scenario, runs), "verification": verification}
    store.compact([run.run_id for run in runs], described)
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
        raise InvalidInput(f"{scenario.file}: {run.variant}: {error}") from error


def about(scenario: Scenario, runs: Sequence[Run]) -> dict[str, Any]:
    """What is kept with the rows of a study: where they come from and how to read them."""
    descriptions = {c.name: describe(c.fmu) for c in scenario.system.components}
    return {
        "title": scenario.title,
        "scenario_file": scenario.file.name,
        "scenario": scenario.text,
        "varied": list(dict.fromkeys(name for run in runs for name in run.settings)),
        "metrics": {spec.name: _about_metric(spec, descriptions) for spec in scenario.metrics},
        "figures": [asdict(figure) for figure in scenario.figures],
        "fmus": {
            name: {"file": found.path.name, "sha256": found.sha256}
            for name, found in descriptions.items()
        },
        "versions": _versions(),
    }


def _about_metric(spec: MetricSpec, descriptions: Mapping[str, Description]) -> dict[str, Any]:
    component, _, name = spec.of.partition(".")
    variables = descriptions[component].variables.values()
    group = {v.unit for v in variables if v.name == name or v.name.startswith(f"{name}[")}
    return {
        "metric": spec.metric.name,
        "of": spec.of,
        "options": dict(spec.options),
        "definition": spec.metric.definition,
        "unit": spec.metric.unit(group.pop() if len(group) == 1 else ""),
    }


def _versions() -> dict[str, str]:
    versions = {"congelation": code_version(), "Python": platform.python_version()}
    for package in _PACKAGES:
        versions[package] = version(package)
    return {**versions, "platform": platform.platform()}
